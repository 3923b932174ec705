"""Rows as Parquet: types that are stated, or told by the values; what does not exist is null."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from svmdist.report.tables import PIECE, require_pyarrow, write_parquet

pyarrow = pytest.importorskip("pyarrow", reason="the extra parquet is not installed")


def read(path: Path) -> list[dict[str, object]]:
    from pyarrow.parquet import read_table

    return list(read_table(path).to_pylist())


def test_values_are_what_they_were(tmp_path: Path) -> None:
    """A number that is not finite does not exist, as in CSV and JSON."""
    rows = [
        {"name": "a", "count": 1, "value": 0.1 + 0.2, "none": None},
        {"name": None, "count": None, "value": math.nan},
        {"name": "\udcff", "count": 2**60 + 1, "value": 3},
    ]
    keys = ("name", "count", "value", "none")
    write_parquet(tmp_path / "a.parquet", keys, rows)
    expected = [
        {"name": "a", "count": 1, "value": 0.1 + 0.2, "none": None},
        {"name": None, "count": None, "value": None, "none": None},
        {"name": "?", "count": 2**60 + 1, "value": 3.0, "none": None},
    ]
    assert read(tmp_path / "a.parquet") == expected


def test_rows_are_written_in_pieces(tmp_path: Path) -> None:
    """Of a stream, which is never held whole; without a row there are columns all the same."""
    count = 2 * PIECE + 7
    write_parquet(tmp_path / "a.parquet", ("x",), ({"x": at} for at in range(count)), {"x": "int64"})
    from pyarrow.parquet import ParquetFile

    with ParquetFile(tmp_path / "a.parquet") as file:
        assert file.metadata.num_rows == count
        assert file.metadata.num_row_groups == 3
    write_parquet(tmp_path / "b.parquet", ("x",), iter(()), {"x": "int64"})
    assert read(tmp_path / "b.parquet") == []


def test_a_failure_leaves_the_earlier_file(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    write_parquet(path, ("x",), [{"x": 1}])

    def broken() -> object:
        yield {"x": 2}
        raise ValueError("no more")

    with pytest.raises(ValueError, match="no more"):
        write_parquet(path, ("x",), broken(), {"x": "int64"})  # type: ignore[arg-type]
    assert read(path) == [{"x": 1}]
    assert require_pyarrow() is pyarrow

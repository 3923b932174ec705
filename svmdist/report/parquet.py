"""Rows as Parquet, through pyarrow: a table for pandas, Polars, DuckDB and Arrow, written in pieces."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from svmdist.errors import OutputError
from svmdist.files import atomic_file
from svmdist.report.table import Row, json_value

PIECE = 1 << 14
"""Rows that are held at once."""


def require_pyarrow() -> Any:
    """pyarrow; raises OutputError where it is not installed."""
    try:
        import pyarrow
    except ImportError:
        raise OutputError(
            "Parquet needs the package pyarrow, which is not installed: pip install 'svmdist[parquet]'"
        ) from None
    return pyarrow


def write_parquet(
    path: Path, keys: Sequence[str], rows: Iterable[Row], types: Mapping[str, str] | None = None
) -> None:
    """Write rows atomically; a value that does not exist is null.

    `types` are those of the columns: string, int64 or float64. Without them all rows are held, and tell the types.
    """
    pyarrow = require_pyarrow()
    from pyarrow.parquet import ParquetWriter

    if types is None:
        rows = list(rows)
        types = {key: _type_of([row.get(key) for row in rows]) for key in keys}
    schema = pyarrow.schema([(key, types[key]) for key in keys])
    left = iter(rows)
    with atomic_file(path) as target, ParquetWriter(target, schema, compression="zstd") as writer:
        while piece := list(islice(left, PIECE)):
            columns = [
                pyarrow.array([_cell(row.get(key), types[key]) for row in piece], types[key]) for key in keys
            ]
            writer.write_table(pyarrow.Table.from_arrays(columns, schema=schema))


def _cell(value: Any, kind: str) -> Any:
    value = json_value(value)
    if value is None:
        return None
    match kind:
        case "string":
            return str(value).encode("utf-8", "replace").decode("utf-8")
        case "float64":
            return float(value)
    return int(value)


def _type_of(values: Sequence[Any]) -> str:
    known = [value for value in values if value is not None]
    if any(isinstance(value, str) for value in known):
        return "string"
    return "int64" if known and all(isinstance(value, int) for value in known) else "float64"

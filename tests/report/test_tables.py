"""Tables for a person and for machines: what is missing stays missing, text stays text."""

import csv
import io
import json
import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.errors import UsageError, printable
from svmdist.metrics import COUNT, LENGTH, TEXT, Unit
from svmdist.report import tables
from svmdist.report.writers import Holds, Results, choose_writer

COLUMNS = (tables.Column("name", TEXT, "name"), tables.Column("value", LENGTH, "value [mm]"))
LINES = (tables.csv_lines, tables.json_lines, tables.json_document)


def in_csv(*rows: tables.Row) -> list[list[str]]:
    """The cells of rows, as a reader of CSV gets them."""
    return list(csv.reader(io.StringIO("".join(tables.csv_lines(Results(COLUMNS, rows))))))


def shown(name: str, title: str = "") -> str:
    """One row for a person, as a table and as a plain one."""
    row = {"name": name, "value": 0.001}
    return tables.render(tables.Table.of(title, COLUMNS, [row])) + "".join(tables.text_lines(COLUMNS, [row]))


@pytest.mark.parametrize("name", ["[red]x", "[/nope]", "[link=http://x]y[/link]", ":warning:", "\\[x]", "a$b$_c"])
def test_markup_in_a_name_is_text(name):
    """Names that look like rich's markup come out as they are in rows and titles, and crash nothing."""
    assert shown(name, f"log {name}").count(name) == 3
    assert in_csv({"name": name, "value": 1})[1] == [name, "1"]
    assert json.loads("".join(tables.json_lines(Results(COLUMNS, [{"name": name}]))))["name"] == name


@pytest.mark.parametrize("code", ["\x1b[31m", "\x07", "\x9b", "\u202e", "\u2028", "\r", "\n", "\x00", "\ud800"])
def test_characters_that_drive_a_terminal_are_replaced(code):
    """ESC, bell, line breaks and bidirectional overrides never reach a terminal, the letters around them do."""
    name = f"a{code}b"
    for text in (
        shown(name, name),
        "".join(tables.csv_lines(Results(COLUMNS, [{"name": name}]))),
        printable(name),
    ):
        assert code[0] not in text.replace("\n", "" if code == "\n" else "\n")
        assert "a\N{REPLACEMENT CHARACTER}" in text


@settings(max_examples=100)
@given(st.text(max_size=30) | st.sampled_from(["=1+1", "+1", "-1", "@SUM(A1)", "=cmd|' /C calc'!A0", "\t=1", "\r=1"]))
def test_any_name_keeps_its_place_in_a_csv(name):
    """Two rows of two cells, and no spreadsheet takes the name for a formula; a negative number stays one."""
    header, (cell, value) = in_csv({"name": name, "value": -0.5})
    assert (header, value) == (["name", "value"], "-0.5")
    assert cell.lstrip("'").endswith(printable(name).lstrip("'"))
    assert cell[:1] not in tuple("=+-@\t\r")


@pytest.mark.parametrize("missing", [None, math.nan, math.inf, -math.inf])
def test_what_does_not_exist_is_empty(missing):
    """An empty cell in CSV, null in JSON, a dash for a person; never the text NaN."""
    row = {"name": "a", "value": missing}
    assert in_csv(row) == in_csv({"name": "a"}) == [["name", "value"], ["a", ""]]
    for lines in (tables.json_lines, tables.json_document):
        text = "".join(lines(Results(COLUMNS, [row])))
        assert "null" in text
        assert "NaN" not in text
        assert "Infinity" not in text
    assert COLUMNS[1].show(missing) == "–"


def test_what_rounds_to_zero_has_no_sign():
    assert COLUMNS[1].show(-1e-6) == "0.00"
    assert COLUMNS[1].show(-1e-5) == "-0.01"


@pytest.mark.parametrize("value", [0.1, 1 / 3, 1e-300, 123456789.123456789, np.float64(0.1), 7])
def test_numbers_survive_the_round_trip(value):
    """A number read back from CSV or JSON equals the one written, bit for bit, also where NumPy made it."""
    row = {"name": "a", "value": value}
    assert float(in_csv(row)[1][1]) == value
    assert json.loads("".join(tables.json_lines(Results(COLUMNS, [row]))))["value"] == value


@pytest.mark.parametrize("count", [0, 1, 2, 500])
def test_a_json_array_is_valid_for_any_number_of_rows(count):
    rows = [{"name": f"row {index}", "value": index / 7} for index in range(count)]
    text = "".join(tables.json_document(Results(COLUMNS, iter(rows))))
    assert json.loads(text) == rows
    assert text.count("\n") == (count + 2 if count else 1)
    assert [json.loads(line) for line in tables.json_lines(Results(COLUMNS, iter(rows)))] == rows


@pytest.mark.parametrize(("lines", "first"), [*zip(LINES, (2, 1, 1), strict=True)])
def test_rows_are_written_as_they_come(lines, first):
    """No form holds the rows: after the first row's line, only that row was read."""
    read = []

    def rows() -> Iterable[tables.Row]:
        for index in range(10**9):
            read.append(index)
            yield {"more": 2, "value": index, "name": "a"}

    made = lines(Results(COLUMNS, rows()))
    texts = [next(made) for _ in range(first)]
    assert len(read) == 1
    assert "more" not in texts[-1]


def test_a_narrow_terminal_gets_whole_cells_in_parts():
    """No cell is broken: columns under one heading stay together, and each part tells its rows apart."""
    unit = Unit("m", 1e3, 4)
    headings = ("group a\nRMSE", "\np95", "\np95")
    columns = (
        tables.Column("name", TEXT, "recording"),
        *(tables.Column(f"v{i}", unit, headings[i % 3]) for i in range(9)),
    )
    rows = [{"name": name, **{f"v{i}": 0.1 * i for i in range(9)}} for name in ("first", "second")]
    table = tables.Table.of("the title", columns, rows[:1], rows[1:])
    whole, parts = tables.render(table), tables.render(table, width=60)
    assert max(map(len, whole.splitlines())) > 60
    assert max(map(len, parts.splitlines())) <= 60
    assert parts.count("the title") == 1
    assert parts.count("second") == parts.count("recording") >= 2
    assert all(line.count("p95") == 2 * line.count("RMSE") for line in parts.splitlines())
    assert [parts.count(f"{100 * i}.0000") for i in range(1, 9)] == [2] * 8
    assert tables.render(table, width=200) == whole


MARKED = tables.Table.of(
    "R² & more",
    [tables.Column("name", TEXT, "name"), tables.Column("n", heading="n [%]")],
    [{"name": "a_b|c", "n": 3}],
)


def test_markup_is_escaped_and_aligned():
    """LaTeX and Markdown show every cell as it is."""
    text = "".join(tables.latex(Results((), (), tables=[MARKED], notes=["a note"])))
    caption, head = r"\caption{R\textsuperscript{2} \& more}", r"\begin{tabular}{lr}"
    assert all(part in text for part in (caption, head, r"name & n [\%] \\", r"a\_b|c & 3 \\"))
    assert text.endswith("% a note\n")
    table = ["| name | n [%] |", "|---|---:|", r"| a\_b\|c | 3 |", ""]
    assert "".join(tables.markdown(Results((), (), tables=[MARKED]))).splitlines()[2:] == table


def in_parquet(path: Path) -> list[dict[str, object]]:
    """The rows of a Parquet file."""
    table = pytest.importorskip("pyarrow.parquet", reason="the extra parquet is not installed")
    return list(table.read_table(path).to_pylist())


def test_parquet_has_the_values_in_pieces(tmp_path):
    """Of a stream that is never held whole; a number that is not finite does not exist; no row leaves the columns."""
    columns = (*COLUMNS, tables.Column("count", COUNT), tables.Column("shown", heading="x", stored=False))
    given = [("a", 0.1 + 0.2, True), (None, math.nan, None), ("\udcff", 3, None)]
    rows = [dict(zip(("name", "value", "count"), row, strict=True)) for row in given]
    path = tmp_path / "a.parquet"
    tables.write_parquet(Results(columns, (rows[at % 3] for at in range(2 * tables.PARQUET_ROWS + 1))), path)
    expected = [
        {"name": "a", "count": 1, "value": 0.1 + 0.2},
        {"name": None, "count": None, "value": None},
        {"name": "?", "count": None, "value": 3.0},
    ]
    found = in_parquet(path)
    assert (found[:3], len(found)) == (expected, 2 * tables.PARQUET_ROWS + 1)
    tables.write_parquet(Results(columns, []), path)
    assert in_parquet(path) == []
    with pytest.raises(ValueError, match="no more"):
        tables.write_parquet(Results(columns, _broken()), path)
    assert in_parquet(path) == []


def _broken() -> Iterator[tables.Row]:
    yield {"name": "a"}
    raise ValueError("no more")


@pytest.mark.parametrize(
    ("given", "output", "holds", "chosen", "refusal"),
    [
        (None, None, Holds.ROWS, "table", ""),
        (None, "a.JSONL", Holds.ROWS, "jsonl", ""),
        ("csv", "a.json", Holds.ROWS, "csv", ""),
        (None, "a.htm", Holds.ROWS | Holds.REPORT, "html", ""),
        (None, "a.log", Holds.FIGURES, "table", ""),
        (None, "a.tex", Holds.FIGURES, "latex", ""),
        (None, "/dev/stderr", Holds.FIGURES, "table", ""),
        (None, "a", Holds.POSES, "csv", ""),
        (None, "a.avi", Holds.FIGURES, "", "are .csv, .json, .md, .parquet, .tex, and .txt for a table"),
        (None, "a.html", Holds.FIGURES, "", "--report FILE.html"),
        (None, "a.txt.gz", Holds.POSES, "", ".csv, .json, .parquet, .tum, and .txt for CSV"),
        ("csv", "a.mp4", Holds.ROWS | Holds.FRAMES, "", "written as mp4; leave out one"),
        ("mp4", "a.mp4", Holds.ROWS | Holds.FRAMES, "mp4", ""),
        ("ply", "a.ply", Holds.CLOUD, "ply", ""),
        ("ply", "a.csv", Holds.CLOUD, "", "written as csv; leave out one"),
        ("stl", None, Holds.CLOUD, "", "the choices are: csv, json, npz, ply"),
        ("ply", None, Holds.CLOUD, "", "is no text: give a file with -o FILE.ply"),
        ("parquet", None, Holds.ROWS, "", "is no text: give a file with -o FILE.parquet"),
    ],
)
def test_the_format_follows_the_ending(given, output, holds, chosen, refusal):
    """Unless one is named; text is a table where the command has one. Others are refused with the choices."""
    path = Path(output) if output else None
    if chosen:
        assert choose_writer(given, path, holds).name == chosen
    else:
        with pytest.raises(UsageError, match=re.escape(refusal)):
            choose_writer(given, path, holds)

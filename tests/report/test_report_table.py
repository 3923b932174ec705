"""Tables for a person, CSV, JSON and JSON lines: what is missing stays missing, and text stays text."""

from __future__ import annotations

import csv
import io
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.report.rows import (
    ALARM_COLUMNS,
    ESTIMATE_COLUMNS,
    ESTIMATE_KEYS,
    INSTRUMENT_COLUMNS,
    columns_within,
    estimate_row,
)
from svmdist.report.tables import (
    Column,
    csv_lines,
    csv_text,
    json_array_lines,
    json_lines,
    number,
    percent,
    printable,
    render,
    rich_table,
    text_lines,
    text_width,
)
from svmdist.results import Distance, Distances, FrameResult, ImageFindings
from svmdist.samples import Status

KEYS = ("name", "value")
COLUMNS = (Column("name", "name", is_text=True), Column("value", "value [mm]", number(2, 1e3)))
MARKUP = ["[red]x", "[/nope]", "[link=http://x]y[/link]", "[b]", ":warning:", "\\[x]", "a$b$_c"]


def read_csv(lines: object) -> list[list[str]]:
    """Parse CSV with the standard library, as a reader would."""
    return list(csv.reader(io.StringIO("".join(lines))))  # type: ignore[call-overload]


@pytest.mark.parametrize("name", MARKUP)
def test_markup_in_a_name_is_text(name):
    """Names that look like rich markup come out as they are in rows and titles, and crash nothing."""
    shown = render(rich_table(f"log {name}", COLUMNS, [{"name": name, "value": 0.001}]))
    assert shown.count(name) == 2
    assert name in "".join(text_lines(COLUMNS, [{"name": name, "value": 0.001}]))
    assert read_csv(csv_lines(KEYS, [{"name": name, "value": 1}]))[1] == [name, "1"]
    assert json.loads("".join(json_lines(KEYS, [{"name": name}])))["name"] == name


@pytest.mark.parametrize(
    "code",
    ["\x1b[31m", "\x07", "\x9b", "\u202e", "\u2028", "\r", "\n", "\x00", "\ud800"],
    ids=["ESC", "BEL", "CSI", "RLO", "LS", "CR", "LF", "NUL", "surrogate"],
)
def test_characters_that_drive_a_terminal_are_replaced(code):
    """ESC, bell, line breaks and bidirectional overrides never reach a terminal, the letters around them do."""
    name = f"a{code}b"
    for shown in (
        render(rich_table(name, COLUMNS, [{"name": name}])),
        "".join(text_lines(COLUMNS, [{"name": name}])),
        "".join(csv_lines(KEYS, [{"name": name}])),
        printable(name),
    ):
        assert code[0] not in shown.replace("\n", "" if code == "\n" else "\n")
        assert "a\N{REPLACEMENT CHARACTER}" in shown
        assert "b" in shown


@settings(deadline=None, max_examples=100)
@given(st.text(max_size=30))
def test_any_name_keeps_its_place_in_a_csv(name):
    """Whatever a name holds, the CSV has two rows of two cells, and the name's letters are in the first."""
    rows = read_csv(csv_lines(KEYS, [{"name": name, "value": 2.5}]))
    assert rows == [["name", "value"], [csv_text(name), "2.5"]]
    assert csv_text(name).lstrip("'").endswith(printable(name).lstrip("'"))


@pytest.mark.parametrize(
    "name",
    ["=1+1", "+1", "-1", "@SUM(A1)", "=cmd|' /C calc'!A0", "\t=1", "\r=1"],
    ids=["equals", "plus", "minus", "at", "command", "tab", "CR"],
)
def test_formulas_are_defused_in_csv(name):
    """Text that a spreadsheet would run begins with an apostrophe or a harmless character instead."""
    cell = read_csv(csv_lines(KEYS, [{"name": name}]))[1][0]
    assert cell[0] not in "=+-@\t\r"
    assert cell.endswith(name.lstrip("\t\r"))


def test_negative_numbers_are_no_formulas():
    """Only text is defused: a negative number stays a number."""
    assert read_csv(csv_lines(KEYS, [{"name": "a", "value": -0.5}]))[1] == ["a", "-0.5"]


@pytest.mark.parametrize("missing", [None, math.nan, math.inf, -math.inf])
def test_what_does_not_exist_is_empty(missing):
    """None and numbers that are not finite are an empty cell in CSV and null in JSON, never the text NaN."""
    row = {"name": "a", "value": missing}
    assert "".join(csv_lines(KEYS, [row])) == "name,value\na,\n"
    for text in ("".join(json_lines(KEYS, [row])), "".join(json_array_lines(KEYS, [row]))):
        assert "null" in text
        assert "NaN" not in text
        assert "Infinity" not in text
    assert "".join(csv_lines(KEYS, [{"name": "a"}])) == "name,value\na,\n"


@pytest.mark.parametrize("value", [0.1, 1 / 3, 1e-300, 123456789.123456789, np.float64(0.1), 7])
def test_numbers_survive_the_round_trip(value):
    """A number read back from CSV or JSON equals the one written, bit for bit, also where NumPy made it."""
    row = {"name": "a", "value": value}
    assert float(read_csv(csv_lines(KEYS, [row]))[1][1]) == value
    assert json.loads("".join(json_lines(KEYS, [row])))["value"] == value


@pytest.mark.parametrize("count", [0, 1, 2, 500])
def test_a_json_array_is_valid_for_any_number_of_rows(count):
    """No row, one row and many make a valid array, one object a line, with the keys in order."""
    rows = [{"name": f"row {index}", "value": index / 7} for index in range(count)]
    text = "".join(json_array_lines(KEYS, iter(rows)))
    assert json.loads(text) == rows
    assert text.endswith("]\n")
    assert text.count("\n") == (count + 2 if count else 1)
    lines = list(json_lines(KEYS, iter(rows)))
    assert [json.loads(line) for line in lines] == rows


def test_rows_are_written_as_they_come():
    """No form holds the rows: after asking for a line, only as many rows as needed were read."""
    for writer, first in ((csv_lines, 2), (json_lines, 1), (json_array_lines, 1)):
        read = []

        def rows(read: list[int] = read) -> object:
            for index in range(10**9):
                read.append(index)
                yield {"name": "a", "value": index}

        lines = writer(KEYS, rows())  # type: ignore[arg-type]
        for _ in range(first):
            next(lines)
        assert len(read) == 1


def test_keys_stand_in_their_order_whatever_a_row_holds():
    """Columns follow the keys: additional entries of a row are left out."""
    row = {"value": 1, "more": 2, "name": "a"}
    assert "".join(csv_lines(KEYS, [row])) == "name,value\na,1\n"
    assert "".join(json_lines(KEYS, [row])) == '{"name": "a", "value": 1}\n'


def test_units_in_headings_are_shown():
    """A heading such as "value [mm]" keeps its unit in every form: brackets are no markup there either."""
    assert "value [mm]" in render(rich_table("title", COLUMNS, []))
    assert "value [mm]" in "".join(text_lines(COLUMNS, []))


def test_figures_are_shown_in_their_unit():
    """Metres are shown as millimetres and fractions as percent, with the digits asked for, and – for nothing."""
    assert number(2, 1e3)(0.01234) == "12.34"
    assert percent(1)(0.9876) == "98.8"
    assert number(2)(None) == "–"


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_person_is_shown_no_nan(value):
    """A number that is not finite does not exist for a person either."""
    assert number(2)(value) == "–"


def test_a_plain_table_has_a_line_a_row_under_its_heading():
    """Columns line up: every line of short values is as wide as the rule under the heading allows."""
    lines = list(text_lines(COLUMNS, [{"name": "a", "value": 0.0015}, {"name": "b" * 30, "value": None}]))
    assert lines[0].split() == ["name", "value", "[mm]"]
    assert set(lines[1].strip()) <= {"─", " "}
    assert lines[2].index("1.50") + 4 == len(lines[1]) - 1
    assert lines[3].startswith("b" * 30)


MEASURED = FrameResult(
    stamp_ns=1_700_000_000_500_000_000,
    status=Status.OK,
    image=ImageFindings(
        tool_px=(1.5, 2.5),
        tissue_px=(3.5, 4.5),
        tool_area_px=200,
        tissue_area_px=5000,
        keypoint_count=900,
        match_count=120,
        inlier_count=100,
    ),
    distances=Distances(planar=Distance(0.0123)),
)


def test_an_estimate_row_has_every_column_of_the_contract():
    """The first thirteen columns are those of the contract, in order; stamps keep their nanoseconds."""
    assert ",".join(ESTIMATE_KEYS[:13]) == (
        "recording,stamp_ns,status,distance_m,tool_x_px,tool_y_px,tissue_x_px,tissue_y_px,"
        "tool_area_px,tissue_area_px,keypoint_count,match_count,inlier_count"
    )
    row = estimate_row("a.mcap", MEASURED, "overlay", "corrected", MEASURED.stamp_ns - 500_000_000)
    cells = dict(zip(*read_csv(csv_lines(ESTIMATE_KEYS, [row])), strict=True))
    assert cells["recording"] == "a.mcap"
    assert cells["stamp_ns"] == "1700000000500000000"
    assert cells["status"] == "ok"
    assert float(cells["distance_m"]) == 0.0123
    assert cells["inlier_count"] == "100"
    assert (cells["method"], cells["equations"]) == ("overlay", "corrected")
    assert row["time_s"] == 0.5
    assert all(cells[key] for key in ESTIMATE_KEYS[:15])


def test_a_rejected_frame_has_empty_cells():
    """A frame without tissue has a status and its stamp; every cell that does not exist is empty."""
    row = estimate_row("a.mcap", FrameResult(5, Status.NO_TISSUE), "overlay", "corrected", 5)
    cells = dict(zip(*read_csv(csv_lines(ESTIMATE_KEYS, [row])), strict=True))
    filled = {key: value for key, value in cells.items() if value}
    assert filled == {
        "recording": "a.mcap",
        "stamp_ns": "5",
        "status": "no_tissue",
        "method": "overlay",
        "equations": "corrected",
    }


def test_a_person_sees_the_distance_in_millimetres():
    """The table for a person shows 0.0123 m as 12.30 and what does not exist as a dash."""
    rows = [
        estimate_row("a.mcap", estimate, "overlay", "corrected", MEASURED.stamp_ns)
        for estimate in (MEASURED, FrameResult(MEASURED.stamp_ns, Status.NO_INSTRUMENT))
    ]
    lines = list(text_lines(ESTIMATE_COLUMNS, rows))
    assert lines[2].split()[:4] == ["a.mcap", "0.000", "ok", "12.30"]
    assert lines[3].split()[:4] == ["a.mcap", "0.000", "no_instrument", "–"]


def test_a_narrow_terminal_gets_whole_cells_in_parts() -> None:
    """No cell is broken: columns under one heading stay together, and each part tells its rows apart."""
    columns = (
        Column("name", "recording", is_text=True),
        *(Column(f"value_{i}", "group a\nRMSE" if i % 3 == 0 else "\np95", number(4, 1e3)) for i in range(9)),
    )
    rows = [{"name": name, **{f"value_{i}": 0.1 * i for i in range(9)}} for name in ("first", "second")]
    whole = render(rich_table("the title", columns, rows))
    parts = render(rich_table("the title", columns, rows), width=60)
    assert max(map(len, whole.splitlines())) > 60
    assert max(map(len, parts.splitlines())) <= 60
    assert parts.count("the title") == 1
    assert parts.count("second") == parts.count("recording") >= 2
    for line in parts.splitlines():
        assert line.count("p95") == 2 * line.count("RMSE")
    assert [parts.count(f"{100 * i}.0000") for i in range(1, 9)] == [2] * 8
    assert render(rich_table("the title", columns, rows), width=200) == whole


def test_a_narrow_terminal_goes_without_pixels() -> None:
    """What does not fit is left out by rank; distances and their deviation stay."""
    assert columns_within(ESTIMATE_COLUMNS, None) == ESTIMATE_COLUMNS
    kept = [column.key for column in columns_within(ESTIMATE_COLUMNS, 80)]
    assert kept == ["time_s", "status", "distance_m", "spatial_m", "clearance_m", "clearance_std_m"]
    everything = ESTIMATE_COLUMNS + INSTRUMENT_COLUMNS + ALARM_COLUMNS
    for columns, planar, essential in (
        (everything, False, {"status", "clearance_m", "instrument", "alarm", "time_to_contact_s"}),
        (ESTIMATE_COLUMNS + INSTRUMENT_COLUMNS, False, {"clearance_m", "clearance_std_m", "instrument"}),
        (ESTIMATE_COLUMNS + INSTRUMENT_COLUMNS, True, {"status", "distance_m", "instrument"}),
    ):
        narrow = columns_within(columns, 80, planar)
        assert text_width(narrow) <= 80
        assert essential <= {column.key for column in narrow}
    wide = columns_within(ESTIMATE_COLUMNS, 150)
    assert text_width(wide) <= 150
    assert wide[0].key == "recording"

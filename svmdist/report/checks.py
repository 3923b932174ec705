"""Comparisons of a log with its profile, as rows and as lines."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from svmdist.errors import printable
from svmdist.estimation.comparison import Checks, readable
from svmdist.metrics import COUNT, RATIO, TEXT, Unit
from svmdist.report.tables import Column, Row, Table, counted, render, row_of
from svmdist.report.writers import Results

COLUMNS = (
    Column("recording", TEXT, of="0"),
    Column("instrument", TEXT, "instrument", of="1"),
    Column("what", TEXT, "what", of="2.usual.what"),
    Column("against", TEXT, "compared", of="2.against"),
    Column("difference", RATIO, of="2.usual.value"),
    Column("unit", TEXT, of="2.usual.unit"),
    Column("std", RATIO, of="2.usual.std"),
    Column("shown", TEXT, "difference", of=lambda one: readable(one[2].usual), stored=False),
    Column("deviations", Unit("", "", digits=1), "deviations", of="2.usual.deviations"),
    Column("frames", COUNT, of="2.frames"),
    Column("contradicting", COUNT, of="2.contradicting"),
    Column(
        "beyond", TEXT, "frames", of=lambda one: f"{one[2].contradicting} of {one[2].frames}", stored=False
    ),
    Column("verdict", TEXT, "verdict", of="2.verdict"),
    Column("could_be", TEXT, of=lambda one: "; ".join(one[2].could_be)),
)


def check_rows(recording: str, found: Mapping[str, Checks]) -> Iterator[Row]:
    """A row for each comparison of each instrument of a recording."""
    for instrument, checks in found.items():
        for one in checks.comparisons:
            yield row_of(COLUMNS, (recording, instrument, one))


def check_results(rows: Sequence[Row]) -> Results:
    """The rows; as text a table for each log, and below it what could be wrong where something contradicts."""
    results = Results(COLUMNS, rows, lambda width: _lines(rows, width))
    kept = [{key: row[key] for key in results.keys} for row in rows]
    return Results(COLUMNS, kept, results.text, document=kept)


def _lines(rows: Sequence[Row], width: int | None) -> Iterator[str]:
    for recording in dict.fromkeys(row["recording"] for row in rows):
        ours = [row for row in rows if row["recording"] == recording]
        wrong = [row for row in ours if row["verdict"] == "contradicts"]
        several = len({row["instrument"] for row in ours}) > 1
        shown = [one for one in COLUMNS if one.heading and (several or one.key != "instrument")]
        yield render(Table.of(str(recording), shown, ours), width=width)
        for row in wrong:
            yield printable(f"{row['what']} contradicts; it could be: {row['could_be']}") + "\n"
        if not wrong:
            yield f"{counted(len(ours), 'comparison')}: nothing contradicts\n"

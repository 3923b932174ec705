"""The comparison of methods: rows for machines, and a table a group of frames for a person."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

from rich.table import Table as RichTable

from svmdist.report.figures import FIGURE_COLUMNS, FIGURE_KEYS, figure_cells
from svmdist.report.table import Cell, Column, rich_table
from svmdist.report.text import counted
from svmdist.workflows.compare import MethodScore

COMPARE_KEYS = ("group", "method", *FIGURE_KEYS, "scenario", "degradation", "instrument")

COMPARE_COLUMNS = (Column("method", "method", is_text=True), *FIGURE_COLUMNS)


def compare_row(score: MethodScore) -> dict[str, Cell]:
    """One score in SI, flat, with the keys of `COMPARE_KEYS`."""
    return {
        "group": str(score.group),
        "method": score.method,
        **figure_cells(score.figures),
        "scenario": score.group.scenario,
        "degradation": score.group.degradation,
        "instrument": score.instrument,
    }


def compare_tables(scores: Sequence[MethodScore]) -> list[RichTable]:
    """A table a group, in the order of the scores: one table of all would be too wide for a terminal."""
    tables = []
    for group, members in groupby(scores, lambda score: score.group):
        of = list(members)
        frames = counted(of[0].figures.frame_count, "frame")
        title = f"{group}: {counted(len(of), 'method')} on {frames}"
        tables.append(rich_table(title, COMPARE_COLUMNS, [compare_row(score) for score in of]))
    return tables

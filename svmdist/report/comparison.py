"""The comparison of methods: rows for machines, and one table per group of frames for a person."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

from rich.table import Table as RichTable

from svmdist.report.figures import figure_cells, figure_columns, figure_keys
from svmdist.report.table import Cell, Column, rich_table
from svmdist.report.text import counted
from svmdist.workflows.compare import MethodScore


def compare_keys() -> tuple[str, ...]:
    """The columns of a row, in order."""
    return figure_keys(("group", "method"), ("scenario", "degradation", "instrument"))


def compare_row(score: MethodScore) -> dict[str, Cell]:
    """One score in SI, flat, with the keys of `compare_keys()`."""
    return {
        "group": str(score.group),
        "method": score.method,
        **figure_cells(score.figures),
        "scenario": score.group.scenario,
        "degradation": score.group.degradation,
        "instrument": score.instrument,
    }


def compare_tables(scores: Sequence[MethodScore]) -> list[RichTable]:
    """One table per group, in the order of the scores: one table of all would be too wide for a terminal."""
    columns = [Column("method", "method", is_text=True), *figure_columns()]
    tables = []
    for group, members in groupby(scores, lambda score: score.group):
        of = list(members)
        frames = counted(of[0].figures.frame_count, "frame")
        title = f"{group}: {counted(len(of), 'method')} on {frames}"
        tables.append(rich_table(title, columns, [compare_row(score) for score in of]))
    return tables

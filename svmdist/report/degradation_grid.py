"""The degradation grid as rows: a method by degradation and severity."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table as RichTable

from svmdist.recording.reader import Recording
from svmdist.report.figures import FIGURE_COLUMNS, FIGURE_KEYS, figure_cells
from svmdist.report.table import Cell, Column, rich_table
from svmdist.workflows.degradation_grid import GridCell

CLEAN_NAME = "none"

GRID_KEYS = ("method", "degradation", "severity", *FIGURE_KEYS)

GRID_COLUMNS = (
    Column("condition", "images", is_text=True),
    *FIGURE_COLUMNS,
)


def grid_row(cell: GridCell) -> dict[str, Cell]:
    """One cell in SI, flat, with the keys of `GRID_KEYS`; the log as recorded is `none` of severity 0."""
    return {
        "method": cell.method,
        "degradation": str(cell.condition.name or CLEAN_NAME),
        "severity": cell.condition.severity,
        **figure_cells(cell.figures),
    }


def grid_table(title: str, cells: Sequence[GridCell]) -> RichTable:
    """The table for a person."""
    rows = [grid_row(cell) | {"condition": str(cell.condition) or "as recorded"} for cell in cells]
    return rich_table(title, GRID_COLUMNS, rows)


def recorded_notes(recordings: Sequence[Recording]) -> list[str]:
    """Remarks on logs that were degraded when they were recorded."""
    return [
        f"{recording.name} was recorded with {recording.metadata['degrade']}; the grid's come on top."
        for recording in recordings
        if "degrade" in recording.metadata
    ]

"""The degradation grid as rows: one method, a row for each degradation and severity."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from rich.table import Table as RichTable

from svmdist.report.figures import figure_cells, figure_columns, figure_keys
from svmdist.report.table import Cell, Column, rich_table
from svmdist.workflows.degradation_grid import GridCell

CLEAN_NAME = "none"


def grid_keys() -> tuple[str, ...]:
    """The columns of a row, in order."""
    return figure_keys(("method", "degradation", "severity"))


def grid_row(cell: GridCell) -> dict[str, Cell]:
    """One cell in SI, flat, with the keys of `grid_keys()`; the log as recorded is `none` of severity 0."""
    return {
        "method": cell.method,
        "degradation": str(cell.condition.name or CLEAN_NAME),
        "severity": cell.condition.severity,
        **figure_cells(cell.figures),
    }


def grid_table(title: str, cells: Sequence[GridCell]) -> RichTable:
    """The table for a person."""
    rows = [grid_row(cell) | {"condition": str(cell.condition) or "as recorded"} for cell in cells]
    return rich_table(title, [Column("condition", "images", is_text=True), *figure_columns()], rows)


def recorded_notes(logs: Iterable[tuple[str, Mapping[str, str]]]) -> list[str]:
    """Remarks on logs, by name and metadata, that were degraded when they were recorded."""
    return [
        f"{name} was recorded with {metadata['degrade']}; the grid's degradations come on top."
        for name, metadata in logs
        if "degrade" in metadata
    ]

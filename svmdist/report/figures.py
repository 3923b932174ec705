"""The figures of a replay as cells and columns, shared by the comparison and the degradation grid."""

from __future__ import annotations

from itertools import groupby

from svmdist.report.table import Cell, Column, metric_column
from svmdist.workflows.runs import Figures
from svmdist.workflows.scoring.metric_table import Output, cells, figure_metrics, row_keys, within

GROUP_TITLES = {"": "", "planar": "planar", "spatial": "spatial", "clearance": "clear."}

FIGURE_NOTE = (
    "Errors in mm against the simulator's truth. ∈95 %: share in % of truths inside the stated 95 % interval."
    " ms: processor time of the method per frame, with its detections, without reading, decoding and degrading."
    " –: the method does not estimate it."
)


def figure_keys(before: tuple[str, ...], after: tuple[str, ...] = ()) -> tuple[str, ...]:
    """The columns of a row of figures, with the labels before and after them."""
    return row_keys(before, within(figure_metrics(), Output.FIGURES), after)


def figure_cells(figures: Figures) -> dict[str, Cell]:
    """The figures in SI, flat."""
    return cells(within(figure_metrics(), Output.FIGURES), figures)


def figure_columns() -> list[Column]:
    """The columns for a person: those of a distance stand below its name, and the time is the last one."""
    columns = []
    metrics = sorted(
        within(figure_metrics(), Output.FIGURE_TABLE), key=lambda metric: metric.key == "ms_per_frame"
    )
    for group, members in groupby(metrics, lambda metric: metric.group):
        for index, metric in enumerate(members):
            title = metric.narrow_title or metric.title
            heading = (
                f"{GROUP_TITLES[group] if index == 0 else ''}\n{title}" if group else title.replace(" ", "\n")
            )
            columns.append(metric_column(metric, heading))
    return columns

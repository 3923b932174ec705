"""docs/metrics.md: the page that explains every column of rows and scores, made from their tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from svmdist.report.rows import ESTIMATE_COLUMNS
from svmdist.workflows.metric_table import Output, Tolerance, figure_metrics, score_metrics

COLUMNS_PAGE = """# Columns and metrics

The columns of rows and scores in CSV, JSON and Parquet, in SI units. An undefined value is an empty cell or `null`.
Columns may be added at the end; none is renamed or removed.

## Rows of `svmdist estimate`

"""
METRICS_PAGE = """
## Metrics of `svmdist validate` and `svmdist compare`

Without a prefix a metric is about the planar distance; `spatial_` and `clearance_` are about the other two. A
baseline stores the metrics that have a tolerance: an amount, or a share of the stored value where that is more. 95 %
intervals are moving-block bootstrap (Künsch 1989).

"""


def columns_page() -> str:
    """The documentation of all columns, in Markdown; columns with the same meaning stand in one line."""
    by_meaning: dict[tuple[str, ...], list[str]] = {}
    for column in ESTIMATE_COLUMNS:
        if column.stored:
            by_meaning.setdefault((column.given_by, column.meaning), []).append(column.key)
    rows = _page_table(("columns", "given by", "meaning"), by_meaning)
    by_meaning = {}
    for metric in {metric.key: metric for metric in (*score_metrics(), *figure_metrics())}.values():
        if metric.outputs & (Output.SCORES | Output.FIGURES):
            tolerance = _tolerance(metric.tolerance, metric.unit.name)
            same = (tolerance, metric.meaning)
            by_meaning.setdefault(same, []).append(metric.key)
    metrics = _page_table(("columns", "tolerance", "meaning"), by_meaning)
    return COLUMNS_PAGE + rows + METRICS_PAGE + metrics


def _page_table(headings: Sequence[str], keys_by_cells: Mapping[tuple[str, ...], Sequence[str]]) -> str:
    lines = [f"| {' | '.join(headings)} |\n", f"|{'---|' * len(headings)}\n"]
    for same, keys in keys_by_cells.items():
        lines.append(f"| {', '.join(f'`{key}`' for key in keys)} | {' | '.join(same)} |\n")
    return "".join(lines)


def _tolerance(tolerance: Tolerance | None, unit: str) -> str:
    if tolerance is None:
        return ""
    absolute = f"{tolerance.absolute:g}{'' if unit == '1' else f' {unit}'}"
    return f"{absolute} or {100 * tolerance.relative:g} %" if tolerance.relative else absolute

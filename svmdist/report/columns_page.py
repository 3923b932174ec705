"""docs/metrics.md: the page that explains every column of rows and scores, made from their tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from svmdist.report.rows import ESTIMATE_COLUMNS
from svmdist.workflows.scoring.metric_table import Output, Tolerance, figure_metrics, score_metrics

COLUMNS_PAGE = """# Columns and metrics

The columns of rows and scores in CSV, JSON and Parquet, in SI units. An undefined value is an empty cell or `null`.
Columns may be added at the end; none is renamed or removed. This page is generated from the tables of columns in
`svmdist/report/rows.py` and `svmdist/workflows/scoring/metric_table.py`.

## Rows of `svmdist estimate`

"""
METRICS_PAGE = """
## Scores of `svmdist validate` and `svmdist compare`

A column without a prefix is about the planar distance; `spatial_` and `clearance_` are about the distance in 3D and the
clearance. A baseline (`validate --write-baseline`) stores the metrics that have a tolerance here. A later run is worse
where one of them lost more than the tolerance: an amount, or a share of the stored value where that is more.

"""
COMMANDS = {Output.SCORES: "`validate`", Output.FIGURES: "`compare`"}


def columns_page() -> str:
    """The documentation of all columns, in Markdown; columns with the same meaning stand in one line."""
    by_meaning: dict[tuple[str, ...], list[str]] = {}
    for column in ESTIMATE_COLUMNS:
        if column.stored:
            by_meaning.setdefault((column.unit.name, column.given_by, column.meaning), []).append(column.key)
    rows = _page_table(("columns", "unit", "given by", "meaning"), by_meaning)
    by_meaning = {}
    for metric in {metric.key: metric for metric in (*score_metrics(), *figure_metrics())}.values():
        if commands := [name for output, name in COMMANDS.items() if output & metric.outputs]:
            tolerance = _tolerance(metric.tolerance, metric.unit.name)
            meaning = f"{metric.meaning}{f' Source: {metric.source}.' if metric.source else ''}"
            same = (metric.unit.name, str(metric.better or ""), tolerance, ", ".join(commands), meaning)
            by_meaning.setdefault(same, []).append(metric.key)
    metrics = _page_table(("columns", "unit", "better", "tolerance", "given by", "meaning"), by_meaning)
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

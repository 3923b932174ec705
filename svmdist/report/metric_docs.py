"""docs/metrics.md: the page that explains every metric, made from their declarations."""

from __future__ import annotations

from typing import Any

from svmdist.workflows.scoring.metric_table import Metric, Output, Tolerance, figure_metrics, score_metrics

INTRODUCTION = """# Metrics

What `svmdist validate`, `svmdist compare` and `svmdist blur-bench --grid` tell about estimates, by the columns of their
CSV and JSON. Values are in SI units. A column without a prefix is about the planar distance; `spatial_` and
`clearance_` are about the distance in 3D and the clearance. A value that is undefined is an empty cell or `null`.

A baseline (`svmdist validate --write-baseline`) stores the metrics that have a tolerance here. A later run is worse
where one of them lost more than the tolerance: an amount, or a share of the stored value where that is more.

This page is generated from `svmdist/workflows/scoring/metric_table.py` by `uv run python -m tools.make_metrics_page`.
"""
HEADER = "| columns | unit | better | tolerance | told by | meaning |\n|---|---|---|---|---|---|\n"
COMMANDS = {Output.SCORES: "`validate`", Output.FIGURES: "`compare`, `blur-bench --grid`"}


def metrics_page() -> str:
    """The whole page, in Markdown."""
    return f"{INTRODUCTION}\n{metrics_table()}"


def metrics_table() -> str:
    """One row per metric and what differs between its columns: where it stands, and its tolerance."""
    metrics: list[Metric[Any]] = [*score_metrics(), *figure_metrics()]
    by_key = {metric.key: metric for metric in metrics}
    rows: dict[tuple[object, ...], list[Metric[Any]]] = {}
    for metric in by_key.values():
        if commands := [name for output, name in COMMANDS.items() if output & metric.outputs]:
            same = (metric.meaning, metric.unit, metric.tolerance, *commands)
            rows.setdefault(same, []).append(metric)
    return HEADER + "".join(_row(metrics) for metrics in rows.values())


def _row(metrics: list[Metric[Any]]) -> str:
    first = metrics[0]
    commands = (name for output, name in COMMANDS.items() if output & first.outputs)
    cells = (
        ", ".join(f"`{metric.key}`" for metric in metrics),
        first.unit.name,
        str(first.better or ""),
        _tolerance(first.tolerance, first.unit.name),
        ", ".join(commands),
        f"{first.meaning}{f' Source: {first.source}.' if first.source else ''}",
    )
    return f"| {' | '.join(cells)} |\n"


def _tolerance(tolerance: Tolerance | None, unit: str) -> str:
    if tolerance is None:
        return ""
    absolute = f"{tolerance.absolute:g}{'' if unit == '1' else f' {unit}'}"
    return f"{absolute} or {100 * tolerance.relative:g} %" if tolerance.relative else absolute

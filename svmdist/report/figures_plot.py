"""Plots of figures for print: methods side by side, and one method under blur and other degradations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from svmdist.errors import OutputError
from svmdist.report.plot_style import (
    DASHES,
    GREYS,
    MARKERS,
    PAGE_IN,
    PANEL_IN,
    plain_name,
    plot_format,
    print_looks,
    write_figure,
)
from svmdist.report.text import counted
from svmdist.workflows.compare import ALL, Group, MethodScore
from svmdist.workflows.degradation_grid import GridCell
from svmdist.workflows.runs import Figures
from svmdist.workflows.scoring.distances import DistanceScore

OF: dict[str, Callable[[Figures], DistanceScore | None]] = {
    "planar": lambda figures: figures.planar,
    "spatial": lambda figures: figures.spatial,
    "clearance": lambda figures: figures.clearance,
}
NAMES = {"planar": "planar distance", "spatial": "spatial distance", "clearance": "clearance"}
LINE_IN, HEAD_IN = 0.19, 0.75
"""Height of a method's line, and of what a row of panels needs besides, in inches."""
WIDE = 20.0
"""Errors that differ by more than this factor are drawn on a logarithmic axis."""
NOMINAL = 95.0


def save_compare_plot(scores: Sequence[MethodScore], path: Path) -> None:
    """Draw methods side by side and write the figure; raises OutputError for a wrong ending or a failed write."""
    plot_format(path)
    with print_looks():
        write_figure(draw_compare(scores), path)


def save_blur_plot(cells: Sequence[GridCell], path: Path) -> None:
    """Draw error and coverage over severity and write the figure.

    Raises OutputError for a wrong ending, for nothing to draw, and where writing fails.
    """
    plot_format(path)
    with print_looks():
        write_figure(draw_blur(cells, path), path)


def draw_compare(scores: Sequence[MethodScore]) -> Figure:
    """A line per method. Above: frames measured, and RMSE of each distance; below: time, and truths in the interval.

    Groups of frames differ by marker; the one over all frames is black and filled. A method without a distance, or
    without an interval, has no marker in its panel.
    """
    groups = list(dict.fromkeys(score.group for score in scores))
    methods = list(dict.fromkeys(score.method for score in scores))
    told = [name for name, of in OF.items() if any(of(score.figures) for score in scores)]
    looks = _group_looks(groups)
    legend_rows = -(-len(groups) // 4) if len(groups) > 1 else 0
    height_in = 2 * (LINE_IN * len(methods) + HEAD_IN) + 0.17 * legend_rows + 0.25
    figure = Figure(figsize=(PAGE_IN, height_in), layout="constrained")
    axes = figure.subplots(2, 1 + len(told), squeeze=False, sharey=True)
    frame_count = max(score.figures.frame_count for score in scores)
    figure.suptitle(
        f"{', '.join(map(plain_name, methods))}: {counted(frame_count, 'frame')}",
        fontsize=8,
        x=0.01,
        ha="left",
    )

    def dots(panel: Axes, value: Callable[[Figures], float | None]) -> list[float]:
        shown = []
        for score in scores:
            found = value(score.figures)
            if found is None or not np.isfinite(found):
                continue
            colour, marker, size = looks[score.group]
            panel.plot([found], [methods.index(score.method)], linestyle="none", marker=marker, color=colour,
                       markersize=size, markerfacecolor=colour if size > 4 else "none", markeredgewidth=0.8,
                       clip_on=False, zorder=4 - 0.2 * size, label=_group_name(score.group))  # fmt: skip
            shown.append(found)
        return shown

    dots(axes[0, 0], lambda figures: 100.0 * figures.coverage)
    axes[0, 0].set(xlabel="frames measured [%]", xlim=(0, 100))
    _decades(axes[1, 0], dots(axes[1, 0], lambda figures: figures.ms_per_frame))
    axes[1, 0].set_xlabel("time per frame [ms]")
    for column, name in enumerate(told, 1):
        of, above, below = OF[name], axes[0, column], axes[1, column]
        _decades(above, dots(above, lambda figures, of=of: _rmse_mm(of(figures))))  # type: ignore[misc]
        above.set_xlabel(f"RMSE [mm]\n{NAMES[name]}")
        if not dots(below, lambda figures, of=of: _held(of(figures))):  # type: ignore[misc]
            below.set_visible(False)  # planar methods state no interval
            continue
        below.axvline(NOMINAL, color="0.0", linewidth=0.8, linestyle="--")
        below.set(xlabel=f"truths in 95 % interval [%]\n{NAMES[name]}", xlim=(0, 100))
    for panel in axes.flat:
        panel.set_ylim(len(methods) - 0.5, -0.5)
        panel.set_yticks(range(len(methods)), [plain_name(method) for method in methods])
        panel.tick_params(labelsize=7)
    for row in axes:
        for panel in row[1:]:
            panel.tick_params(labelleft=False)
    if len(groups) > 1:
        known = dict(zip(*reversed(axes[0, 0].get_legend_handles_labels()), strict=True))
        figure.legend(known.values(), known.keys(), loc="outside lower left", ncols=4)
    return figure


def draw_blur(cells: Sequence[GridCell], path: Path = Path("figure")) -> Figure:
    """Frames measured, RMSE and truths in the interval over severity, a line per degradation; 0 is as recorded.

    The error is that of the clearance, else of the spatial distance, else of the planar one.
    """
    clean = next((cell.figures for cell in cells if cell.condition.name is None), None)
    names = list(dict.fromkeys(str(cell.condition.name) for cell in cells if cell.condition.name is not None))
    distance = next((name for name in reversed(OF) if any(OF[name](cell.figures) for cell in cells)), None)
    if not names or distance is None:
        lacking = "no image is degraded" if not names else "no frame was measured where there is a truth"
        raise OutputError(f"{path}: nothing to draw: {lacking}")
    of = OF[distance]
    panels: list[tuple[str, Callable[[Figures], float | None]]] = [
        ("frames measured [%]", lambda figures: 100.0 * figures.coverage),
        (f"RMSE of the {NAMES[distance]} [mm]", lambda figures: _rmse_mm(of(figures))),
    ]
    if any(_held(of(cell.figures)) is not None for cell in cells):
        panels.append(("truths in 95 % interval [%]", lambda figures: _held(of(figures))))
    legend_rows = -(-len(names) // 4)
    figure = Figure(figsize=(PAGE_IN, PANEL_IN + 0.17 * legend_rows + 0.2), layout="constrained")
    axes = figure.subplots(1, len(panels))
    shown: list[float] = []
    for (title, value), panel in zip(panels, axes, strict=True):
        for at, name in enumerate(names):
            points = [(0, value(clean))] if clean else []
            points += [
                (cell.condition.severity, value(cell.figures))
                for cell in sorted(cells, key=lambda one: one.condition.severity)
                if str(cell.condition.name) == name
            ]
            numbers = [np.nan if found is None else found for _, found in points]
            panel.plot([severity for severity, _ in points], numbers, label=name.replace("_", " "), linewidth=0.9,
                       marker=MARKERS[at % len(MARKERS)], markersize=3.5, markerfacecolor="none",
                       linestyle=DASHES[at % len(DASHES)], color=GREYS[at % len(GREYS)])  # fmt: skip
            if title.startswith("RMSE"):
                shown += numbers
        panel.set(xlabel="severity", ylabel=title)
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        if not title.startswith("RMSE"):
            panel.set_ylim(-3, 103)
    _decades(axes[1], shown, vertical=True)
    if len(panels) > 2:
        axes[2].axhline(NOMINAL, color="0.0", linewidth=0.8, linestyle="--")
    frames = counted(cells[0].figures.frame_count, "frame")
    figure.suptitle(
        f"{plain_name(cells[0].method)}: {frames}, severity 0 as recorded", fontsize=8, x=0.01, ha="left"
    )
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower left", ncols=4)
    return figure


def _group_looks(groups: Sequence[Group]) -> dict[Group, tuple[str, str, float]]:
    """Colour, marker and size of each group: all differ in one of the first two."""
    others = [group for group in groups if not _is_all(group)]
    pairs = product(("0.35", "0.6", "0.0"), MARKERS[1:])
    looks = {group: (grey, marker, 4.0) for group, (grey, marker) in zip(others, pairs, strict=False)}
    return {group: looks.get(group, ("0.0", MARKERS[0], 5.5)) for group in groups}


def _is_all(group: Group) -> bool:
    return group.scenario == ALL and group.degradation == ALL and not group.other_instrument


def _group_name(group: Group) -> str:
    return plain_name(str(group)) or ALL


def _rmse_mm(score: DistanceScore | None) -> float | None:
    return None if score is None else score.statistics.rmse * 1e3


def _held(score: DistanceScore | None) -> float | None:
    return None if score is None or score.interval_coverage is None else 100.0 * score.interval_coverage


def _decades(panel: Axes, shown: Sequence[float], *, vertical: bool = False) -> None:
    """Begin an axis at zero, or make it logarithmic where its values differ much."""
    positive = [value for value in shown if value > 0]
    if positive and max(positive) > WIDE * min(positive):
        (panel.set_yscale if vertical else panel.set_xscale)("log")
        axis = panel.yaxis if vertical else panel.xaxis
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    elif vertical:
        panel.set_ylim(bottom=0.0)
    else:
        panel.set_xlim(left=0.0)

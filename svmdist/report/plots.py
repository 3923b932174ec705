"""Plots for print: the paper's Fig. 6, series over time, errors, intervals, and methods side by side."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from itertools import product
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from svmdist.errors import OutputError
from svmdist.estimation.alarms import AlarmRules
from svmdist.files import atomic_file
from svmdist.metrics import deviations_at, interval_coverage
from svmdist.report.tables import counted, printable
from svmdist.report.writers import plot_format
from svmdist.transforms import Array
from svmdist.workflows.compare import ALL, Figures, Group, MethodScore
from svmdist.workflows.scoring.score import DistanceScore, Pairs, Score
from svmdist.workflows.scoring.truth import Reference
from svmdist.workflows.series import Series
from svmdist.workflows.validate import Validation

COLUMN_IN, PAGE_IN, PANEL_IN = 3.5, 7.16, 2.2
"""Widths of a column and of a page in print, and the height of a panel, in inches."""
DPI = 300
MARKERS = "osD^v<>Ph*Xd"
"""Markers that differ at a size of 4 points, in the order in which they are taken."""
GREYS = ("0.0", "0.35", "0.6")
DASHES: tuple[Any, ...] = ("-", "--", ":", "-.", (0, (6, 1, 1, 1, 1, 1)), (0, (2, 1)), (0, (8, 3)))
LOOKS: Any = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.fontsize": 7,
    "svg.hashsalt": "svmdist",  # ids would differ between two runs on the same data
}


@contextmanager
def print_looks() -> Iterator[None]:
    """Within this, figures are made and drawn with the looks of print; settings outside stay as they are."""
    with mpl.rc_context(LOOKS), warnings.catch_warnings():
        # A name may hold letters that the font lacks: a box is drawn, which is no news to the user.
        warnings.filterwarnings("ignore", r"Glyph \d+ .*missing from font", UserWarning)
        yield


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure in the format of the path's ending; raises OutputError where that cannot be."""
    suffix = plot_format(path)
    metadata = {"Date": None} if suffix == "svg" else None
    with print_looks(), atomic_file(path) as target:
        figure.savefig(target, dpi=DPI, format=suffix, metadata=metadata)


def plain_name(text: str) -> str:
    """A name out of a file as matplotlib may print it: a dollar sign must not start a formula."""
    return printable(text).replace("$", r"\$").strip()


LEVELS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
"""Levels of intervals whose honesty is shown."""
MAX_GAP_IN_STEPS = 3.0
"""A curve is broken where frames are missing for longer than this many frame periods."""


def distance_name(series: Series) -> str:
    """The series' distance in words."""
    return series.distance if series.distance == "clearance" else f"{series.distance} distance"


def rejected_spans(series: Series) -> list[tuple[float, float]]:
    """Beginning and end in s of each run of frames without the distance, half a frame wider on both sides."""
    if len(series) == 0:
        return []
    lost = ~series.measured
    step_s = float(np.median(np.diff(series.seconds))) if len(series) > 1 else 0.1
    edges = np.flatnonzero(np.diff(np.concatenate([[False], lost, [False]]).astype(int)))
    return [
        (
            round(float(series.seconds[begin]) - 0.5 * step_s, 3),
            round(float(series.seconds[end - 1]) + 0.5 * step_s, 3),
        )
        for begin, end in zip(edges[::2], edges[1::2], strict=True)
    ]


def pooled(series: Sequence[Series]) -> tuple[Array, Array, Array]:
    """Truth, error and deviation in mm of all frames that have an error."""
    truth_m, error_m, std_m = (
        np.concatenate([getattr(one, key) for one in series]) for key in ("truth_m", "error_m", "std_m")
    )
    kept = np.isfinite(error_m)
    return truth_m[kept] * 1e3, error_m[kept] * 1e3, std_m[kept] * 1e3


def held_shares(series: Sequence[Series]) -> tuple[list[float], int]:
    """Shares in % of truths inside the intervals of `LEVELS`, and of how many frames that state a deviation."""
    truth_mm, error_mm, std_mm = pooled(series)
    stated = np.isfinite(std_mm)
    estimate_mm, truth_mm, std_mm = (truth_mm + error_mm)[stated], truth_mm[stated], std_mm[stated]
    held = [100.0 * (interval_coverage(estimate_mm, truth_mm, std_mm, level) or 0.0) for level in LEVELS]
    return held, int(stated.sum())


def with_breaks(seconds: Array, *curves: Array) -> tuple[Array, ...]:
    """Put a NaN between frames that are far apart, so that no line spans what was not measured."""
    if len(seconds) < 3:
        return seconds, *curves
    steps = np.diff(seconds)
    at = np.flatnonzero(steps > MAX_GAP_IN_STEPS * np.median(steps)) + 1
    return tuple(np.insert(values, at, np.nan) for values in (seconds, *curves))


TRUTH_COLOUR, ESTIMATE_COLOUR = "#c1272d", "#1f5fa8"  # red and blue, as in the paper
INTERVAL_COLOUR, ALARM_COLOUR = "#b9cfe8", "#e08a1e"
REFERENCE_NAMES = {
    Reference.GROUND_TRUTH: "simulator",
    Reference.TF: "transforms of the log",
    Reference.POSE: "pose topic",
    Reference.KINEMATICS: "DH kinematics",
}
PANELS_IN = 2.8
"""Height of a recording's two panels, in inches."""


def save_plot(validation: Validation, path: Path, reference: Reference | None = None) -> None:
    """Draw one panel a recording and write the figure in the format of the path's suffix.

    Drawn is the clearance where method and reference tell one, else the spatial distance, else the planar one.
    Raises OutputError for another suffix than png, svg or pdf, for a reference that no recording has, and
    where writing fails.
    """
    scores = _scores_to_draw(validation, reference)
    if not scores:
        raise OutputError(f"{path}: nothing to draw: no recording was compared with {reference}")
    plot_format(path)
    with print_looks():
        write_figure(draw(scores, validation.alarm_rules), path)


def draw(scores: Sequence[Score], alarms: AlarmRules | None = None) -> Figure:
    """Draw the panels, two columns wide where there are several, with the alarms' threshold where there is one."""
    columns = 1 if len(scores) == 1 else 2
    rows = -(-len(scores) // columns)
    width_in = COLUMN_IN if columns == 1 else PAGE_IN
    figure = Figure(figsize=(width_in, PANELS_IN * rows), layout="constrained")
    grid = figure.add_gridspec(rows, columns)
    for index, score in enumerate(scores):
        cell = grid[index // columns, index % columns].subgridspec(2, 1, height_ratios=(3, 1), hspace=0.04)
        upper = figure.add_subplot(cell[0])
        lower = figure.add_subplot(cell[1], sharex=upper)
        curves = _curves(score)
        if alarms is not None and curves.distance == "clearance":
            below_mm = alarms.below_m * 1e3
            upper.axhline(
                below_mm,
                color=ALARM_COLOUR,
                linewidth=0.9,
                linestyle=":",
                label=f"alarm below {below_mm:g} mm",
            )
        _draw_panel(upper, lower, curves)
        if index == 0:
            handles, labels = upper.get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def _scores_to_draw(validation: Validation, reference: Reference | None) -> list[Score]:
    if reference is None:
        primary = validation.primary
        reference = primary.reference if primary else validation.scores[0].reference
    return [score for score in validation.scores if score.reference is reference]


@dataclass(frozen=True, slots=True)
class _Curves:
    """What a panel shows: which distance, its pairs, and the line above it."""

    distance: str
    pairs: Pairs
    title: str
    truth_label: str
    start_ns: int


def _curves(score: Score) -> _Curves:
    """The distance that says most of what was asked: the clearance, the spatial distance, or the planar one."""
    label = _reference_label(score.reference)
    for distance, in_3d in (("clearance", score.clearance), ("spatial distance", score.spatial)):
        if in_3d is not None:
            return _Curves(distance, in_3d.pairs, _title_3d(score, distance, in_3d), label, score.start_ns)
    return _Curves("distance", score.pairs, _title(score), label, score.start_ns)


def _draw_panel(upper: Axes, lower: Axes, curves: _Curves) -> None:
    pairs = curves.pairs
    seconds = (pairs.stamps_ns - curves.start_ns) / 1e9
    time, truth, estimate, half = with_breaks(
        seconds, pairs.truth_m * 1e3, pairs.estimate_m * 1e3, deviations_at(0.95) * pairs.std_m * 1e3
    )
    upper.plot(time, truth, color=TRUTH_COLOUR, linewidth=1.4, linestyle="--", label=curves.truth_label)
    upper.plot(
        time, estimate, color=ESTIMATE_COLOUR, linewidth=1.0, marker=".", markersize=3, label="estimate"
    )
    if np.isfinite(half).any():
        lower.fill_between(time, -half, half, color=INTERVAL_COLOUR, linewidth=0.0)
        upper.fill_between(
            time,
            estimate - half,
            estimate + half,
            color=INTERVAL_COLOUR,
            linewidth=0.0,
            label="95 % interval",
        )
    lower.axhline(0.0, color="0.6", linewidth=0.8)
    lower.plot(time, estimate - truth, color="0.25", linewidth=0.9, marker=".", markersize=2)
    upper.set_title(curves.title, loc="left")
    upper.set_ylabel(f"{curves.distance} [mm]")
    lower.set_ylabel("error [mm]")
    lower.set_xlabel("time [s]")
    for axes in (upper, lower):
        axes.tick_params(labelsize=7)
    upper.tick_params(labelbottom=False)


def _title(score: Score) -> str:
    statistics = score.statistics
    if statistics is None:
        return f"{_name(score)}\nnothing measured"
    r2 = "–" if statistics.r_squared is None else f"{statistics.r_squared:.4f}"
    fitted = ", fitted on" if score.fitted_on else ""
    return (
        f"{_name(score)}\nR² {r2}, RMSE {statistics.rmse * 1e3:.2f} mm, σ {statistics.truth_std * 1e3:.1f} mm,"
        f" n {statistics.count}{fitted}"
    )


def _title_3d(score: Score, distance: str, of: DistanceScore) -> str:
    rmse_mm, held = of.statistics.rmse * 1e3, of.interval_coverage
    interval = "" if held is None else f", {held * 100:.0f} % in the 95 % interval"
    return f"{_name(score)}, {distance}\nRMSE {rmse_mm:.2f} mm{interval}, n {of.statistics.count}"


def _name(score: Score) -> str:
    return f"{plain_name(score.recording)}: {plain_name(score.method)}"


def _reference_label(reference: Reference) -> str:
    return f"truth ({REFERENCE_NAMES[reference]})"


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


INK, ESTIMATE, TRUTH, BAND, LOST = "0.0", "#1f5fa8", "#c1272d", "#b9cfe8", "0.88"


class SeriesPlot(StrEnum):
    """What is plotted of series."""

    TIME = "time"
    RESIDUALS = "residuals"
    BLAND_ALTMAN = "bland-altman"
    CALIBRATION = "calibration"


def save_series_plot(
    series: Sequence[Series], kind: SeriesPlot, path: Path, alarm_below_m: float | None = None
) -> None:
    """Draw series and write the figure in the format of the path's ending.

    Raises OutputError for another ending than matplotlib can write, for nothing to draw, and where writing fails.
    """
    plot_format(path)
    with print_looks():
        write_figure(draw_series(series, kind, path, alarm_below_m), path)


def draw_series(
    series: Sequence[Series], kind: SeriesPlot, path: Path, alarm_below_m: float | None = None
) -> Figure:
    """The figure: a panel for each series over time, else one for all of each distance."""
    if kind is SeriesPlot.TIME:
        figure = Figure(figsize=(PAGE_IN, PANEL_IN * len(series)), layout="constrained")
        for at, one in enumerate(series):
            _draw_time(figure.add_subplot(len(series), 1, at + 1), one, alarm_below_m)
        return figure
    groups = [
        [one for one in series if one.distance == distance and np.isfinite(one.error_m).any()]
        for distance in dict.fromkeys(one.distance for one in series)
    ]
    groups = [group for group in groups if group]
    if kind is SeriesPlot.CALIBRATION:
        groups = [group for group in groups if any(np.isfinite(one.std_m).any() for one in group)]
    if not groups:
        lacking = "an interval" if kind is SeriesPlot.CALIBRATION else "a truth"
        raise OutputError(f"{path}: nothing to draw: no frame has {lacking}")
    across = 2 if kind is SeriesPlot.RESIDUALS else 1
    figure = Figure(
        figsize=(PAGE_IN if across > 1 else COLUMN_IN, 1.3 * PANEL_IN * len(groups)), layout="constrained"
    )
    draw: dict[SeriesPlot, Callable[[Sequence[Axes], Sequence[Series]], None]] = {
        SeriesPlot.RESIDUALS: _draw_residuals,
        SeriesPlot.BLAND_ALTMAN: _draw_agreement,
        SeriesPlot.CALIBRATION: _draw_calibration,
    }
    for at, group in enumerate(groups):
        axes = [figure.add_subplot(len(groups), across, at * across + part + 1) for part in range(across)]
        draw[kind](axes, group)
    return figure


def _draw_time(axes: Axes, series: Series, alarm_below_m: float | None) -> None:
    seconds, estimate, half, truth = with_breaks(
        series.seconds, series.estimate_m * 1e3, series.half_m * 1e3, series.truth_m * 1e3
    )
    for at, (low, high) in enumerate(rejected_spans(series)):
        axes.axvspan(low, high, color=LOST, linewidth=0.0, label="not measured" if at == 0 else None)
    if np.isfinite(half).any():
        axes.fill_between(
            seconds, estimate - half, estimate + half, color=BAND, linewidth=0, label="95 % interval"
        )
    if np.isfinite(truth).any():
        axes.plot(seconds, truth, color=TRUTH, linewidth=1.2, linestyle="--", label="truth")
    axes.plot(seconds, estimate, color=ESTIMATE, linewidth=1.0, marker=".", markersize=2.5, label="estimate")
    if alarm_below_m is not None and series.distance == "clearance":
        label = f"alarm below {alarm_below_m * 1e3:g} mm"
        axes.axhline(alarm_below_m * 1e3, color=INK, linewidth=0.8, linestyle=":", label=label)
    axes.set_title(
        f"{_name_series_plot(series)}: {series.method}, {int(series.measured.sum())} of {len(series)} frames",
        loc="left",
    )
    axes.set(xlabel="time [s]", ylabel=f"{distance_name(series)} [mm]")
    axes.legend(loc="best", ncols=2)


def _draw_residuals(axes: Sequence[Axes], group: Sequence[Series]) -> None:
    over_time, over_distance = axes
    for at, one in enumerate(group):
        error_mm = one.error_m * 1e3
        marker, colour = "ox^sdv"[at % 6], str(0.15 + 0.5 * (at % 3) / 2)
        style: dict[str, Any] = {"s": 6.0, "marker": marker, "color": colour, "linewidths": 0.6}
        over_time.scatter(one.seconds, error_mm, label=_name_series_plot(one), **style)
        over_distance.scatter(one.truth_m * 1e3, error_mm, **style)
    for one_axes in axes:
        one_axes.axhline(0.0, color=INK, linewidth=0.6)
    over_time.set(xlabel="time [s]", ylabel="error [mm]")
    over_distance.set(xlabel=f"true {distance_name(group[0])} [mm]", ylabel="error [mm]")
    over_time.set_title(f"{group[0].method}: errors over time", loc="left")
    over_distance.set_title("over distance", loc="left")
    over_time.legend(loc="best")


def _draw_agreement(axes: Sequence[Axes], group: Sequence[Series]) -> None:
    """Bland & Altman 1986: difference over mean, bias and limits of agreement."""
    truth_mm, error_mm, _ = pooled(group)
    bias = float(error_mm.mean())
    deviation = float(error_mm.std(ddof=1)) if len(error_mm) > 1 else 0.0
    (only,) = axes
    only.scatter(truth_mm + 0.5 * error_mm, error_mm, s=6.0, color="0.35", linewidths=0)
    only.axhline(bias, color=INK, linewidth=1.0, label=f"bias {bias:+.2f} mm")
    label = f"limits {bias - 1.96 * deviation:+.2f}, {bias + 1.96 * deviation:+.2f} mm"
    for sign in (-1.0, 1.0):
        only.axhline(
            bias + sign * 1.96 * deviation,
            color=INK,
            linewidth=0.8,
            linestyle="--",
            label=label if sign < 0 else None,
        )
    only.set_title(f"{group[0].method}: {distance_name(group[0])}, n {len(error_mm)}", loc="left")
    only.set(xlabel="mean of estimate and truth [mm]", ylabel="estimate − truth [mm]")
    only.legend(loc="best")


def _draw_calibration(axes: Sequence[Axes], group: Sequence[Series]) -> None:
    held, count = held_shares(group)
    (only,) = axes
    only.plot([50, 100], [50, 100], color=INK, linewidth=0.8, linestyle="--", label="honest")
    only.plot(100.0 * np.array(LEVELS), held, color=ESTIMATE, marker="o", markersize=3, label="truths inside")
    only.set_title(f"{group[0].method}: interval of the {distance_name(group[0])}, n {count}", loc="left")
    only.set(xlabel="stated level [%]", ylabel="truths inside [%]")
    only.legend(loc="best")


def _name_series_plot(series: Series) -> str:
    return plain_name(f"{series.recording} {series.instrument}")

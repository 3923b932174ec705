"""Plots for print: the paper's Fig. 6, charts of series, and methods side by side; they differ in greyscale too."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from svmdist.errors import OutputError, printable
from svmdist.estimation.alarms import AlarmRules
from svmdist.files import atomic_file
from svmdist.metrics import SHARE
from svmdist.report import charts
from svmdist.report.charts import Chart, Curve, Role
from svmdist.report.tables import counted
from svmdist.report.writers import plot_format
from svmdist.results import Z_95
from svmdist.workflows.compare import ALL, Group, MethodScore
from svmdist.workflows.estimate import Series
from svmdist.workflows.scoring.metric_table import figure_metrics
from svmdist.workflows.scoring.references import Reference
from svmdist.workflows.scoring.scores import Pairs, Score
from svmdist.workflows.validate import Validation

COLUMN_IN, PAGE_IN, PANEL_IN, SCORE_IN = 3.5, 7.16, 2.2, 2.8
"""Widths of a column and of a page in print, and heights of a panel and of a recording's two panels, in inches."""
DPI = 300
HANDLE_IN, LETTER_IN = 0.5, 0.058  # of a legend, with the room between two entries
MARKERS = "osD^v<>Ph*Xd"  # markers that differ at a size of 4 points, in the order in which they are taken
STYLES: dict[Role, dict[str, Any]] = {
    "estimate": {"linewidth": 1.0, "marker": ".", "markersize": 3},
    "error": {"linewidth": 0.9, "marker": ".", "markersize": 2},
    "truth": {"linewidth": 1.4, "linestyle": "--"},
    "interval": {"linewidth": 0.8, "alpha": 0.3},  # of a frame that stands alone, all is outline
    "lost": {"linewidth": 0.0, "alpha": 0.35},
    "alarm": {"facecolor": "none", "hatch": "////", "linewidth": 0.0, "alpha": 0.4},
    "threshold": {"linewidth": 0.9, "linestyle": ":"},
    "model": {"linewidth": 1.0},
    "limit": {"linewidth": 0.8, "linestyle": "--"},
}
"""How curves of the charts' colours are drawn."""
REFERENCE_NAMES = {
    Reference.GROUND_TRUTH: "simulator",
    Reference.TF: "transforms of the log",
    Reference.SURFACE: "poses and surface",
    Reference.PLANE: "poses and plane",
    Reference.POSE: "pose topic",
    Reference.KINEMATICS: "DH kinematics",
}
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
    "hatch.linewidth": 0.4,
    "svg.hashsalt": "svmdist",  # ids would differ between two runs on the same data
}


def save_figure(path: Path, draw: Callable[..., Figure], *given: Any) -> None:
    """Draw a figure with the looks of print and write it; raises OutputError where that cannot be done."""
    suffix = plot_format(path)
    with mpl.rc_context(LOOKS), warnings.catch_warnings(), atomic_file(path) as file:
        # A name may hold letters that the font lacks: a box is drawn, which is no news to the user.
        warnings.filterwarnings("ignore", r"Glyph \d+ .*missing from font", UserWarning)
        draw(*given).savefig(file, dpi=DPI, format=suffix, metadata={"Date": None} if suffix == "svg" else None)


def plain_name(text: str) -> str:
    """A name out of a file as matplotlib may print it: a dollar sign must not start a formula."""
    return printable(text).replace("$", r"\$").strip()


def _draw_curves(axes: Axes, curves: Sequence[Curve]) -> None:
    """Draw curves with their labels; dots of several series differ by marker and depth."""
    for at, curve in enumerate(curves):
        colour, label = tuple(level / 255.0 for level in charts.COLOURS[curve.role]), plain_name(curve.name)
        style = {"edgecolor" if curve.role == "alarm" else "color": colour, **STYLES[curve.role]}
        if curve.form == "line":
            axes.plot(curve.x, curve.y, label=label, **style)
        elif curve.form == "band":
            axes.fill_between(curve.x, curve.low, curve.y, label=label, **style)  # type: ignore[arg-type]
        elif curve.form == "spans":
            for begin, end in zip(curve.x, curve.y, strict=True):
                axes.axvspan(begin, end, label=label if begin == curve.x[0] else None, **style)
        else:
            look: Any = {"marker": "ox^sdv"[at % 6], "color": colour, "alpha": 1.0 - 0.25 * (at % 3)}
            axes.scatter(curve.x, curve.y, s=6.0, linewidths=0.6, label=label, **look)


SeriesPlot = Literal["time", "residuals", "bland-altman", "calibration"]


def draw_series(series: Sequence[Series], kind: SeriesPlot) -> Figure:
    """A panel for each series over time, else one for all of each distance; raises OutputError without any."""
    panels: list[tuple[Chart, str]] = []
    for group in ([one] for one in series) if kind == "time" else charts.with_errors(series):
        one, of = group[0], f"{group[0].method}: {charts.distance_name(group[0])}"
        if kind == "time":
            name = plain_name(f"{one.recording} {one.instrument}")
            title = f"{name}: {one.method}, {int(one.measured.sum())} of {len(one)} frames"
            panels.append((charts.distance_over_time(one), title))
        elif kind == "residuals":
            panels.append((charts.errors_over(group, "time"), f"{of}, errors over time"))
            panels.append((charts.errors_over(group, "distance"), "over distance"))
        elif kind == "bland-altman":
            panels.append((charts.agreement(group), of))
        elif np.isfinite(charts.pooled(group)[2]).any():
            panels.append((charts.calibration(group), f"{of}, interval"))
    if not panels:
        lacking = "an interval" if kind == "calibration" else "a truth"
        raise OutputError(f"--plot {kind}: nothing to draw: no measured frame has {lacking}")
    across = 2 if kind == "residuals" else 1
    rows, height_in = len(panels) // across, PANEL_IN if kind == "time" else 1.3 * PANEL_IN
    width_in = COLUMN_IN if kind in ("bland-altman", "calibration") else PAGE_IN
    figure = Figure(figsize=(width_in, height_in * rows), layout="constrained")
    first: dict[str, Axes] = {}  # over time, panels of one log share their axis
    for at, (chart, title) in enumerate(panels):
        log = series[at].recording if kind == "time" else str(at)
        axes = figure.add_subplot(rows, across, at + 1, sharex=first.get(log))
        first.setdefault(log, axes)
        _draw_curves(axes, chart.curves)
        if chart.y_title == "error [mm]":
            axes.axhline(0.0, color="0.0", linewidth=0.6)
        axes.set(xlabel=chart.x_title, ylabel=chart.y_title)
        axes.set_title(title, loc="left")
        if kind == "time" and not series[at].measured.any():
            _say_nothing(axes, Counter(series[at].status))
        if len(chart.curves) > 1 and width_in == COLUMN_IN:  # each panel has curves of its own
            axes.legend(loc="upper left", bbox_to_anchor=(0.0, 0.0), borderaxespad=4.5, ncols=2)
    if width_in != COLUMN_IN:
        _legend(figure, figure.axes)
    return figure


def _say_nothing(axes: Axes, rejected: Mapping[str, int]) -> None:
    reasons = ", ".join(f"{count} {status}" for status, count in Counter(rejected).most_common())
    axes.text(0.5, 0.5, f"nothing measured\n{reasons}", transform=axes.transAxes, ha="center", va="center")
    if not any(np.isfinite(line.get_ydata()).any() for line in axes.get_lines()):  # nothing has a scale
        axes.set(ylabel="distance [mm]", yticks=[])


def _legend(figure: Figure, panels: Iterable[Axes]) -> None:
    """A legend of what some panels show, below all of them, as wide as the figure at most."""
    handles: dict[str, Any] = {}
    for axes in panels:
        handles |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    columns = _columns(handles, figure.get_figwidth())
    figure.legend(handles.values(), handles.keys(), loc="outside lower left", ncols=columns)


def _columns(labels: Iterable[str], width_in: float) -> int:
    """How many columns of a legend's labels stand side by side."""
    wide_in = [HANDLE_IN + LETTER_IN * len(label) for label in labels]
    for columns in range(len(wide_in), 1, -1):  # filled one after the other
        rows = -(-len(wide_in) // columns)
        if sum(max(wide_in[at : at + rows]) for at in range(0, len(wide_in), rows)) <= width_in:
            return columns
    return 1


def draw(validation: Validation) -> Figure:
    """Fig. 6 of the paper, in two columns for several logs: truth and estimate of a distance, and the error."""
    scores = [score for score in validation.scores if score.reference is validation.reference]
    columns, width_in = (1, COLUMN_IN) if len(scores) == 1 else (2, PAGE_IN)
    rows = -(-len(scores) // columns)
    figure = Figure(figsize=(width_in, SCORE_IN * rows), layout="constrained")
    grid = figure.add_gridspec(2 * rows, columns, height_ratios=(3, 1) * rows, hspace=0.04)
    first: dict[str, Axes] = {}  # panels of one log share their axis
    for index, score in enumerate(scores):
        log = score.recording.removesuffix(f" {score.instrument}")
        row, column = 2 * (index // columns), index % columns
        upper = figure.add_subplot(grid[row, column], sharex=first.get(log))
        first.setdefault(log, upper)
        lower = figure.add_subplot(grid[row + 1, column], sharex=upper)
        _draw_score(upper, lower, score, validation.alarm_rules)
    figure.align_ylabels()
    _legend(figure, figure.axes[::2])
    return figure


def _draw_score(upper: Axes, lower: Axes, score: Score, alarms: AlarmRules | None) -> None:
    distance, pairs = ("spatial distance", score.spatial) if score.spatial else ("distance", score.pairs)
    if score.clearance:
        distance, pairs = "clearance", score.clearance
    seconds = (pairs.stamps_ns - score.start_ns) / 1e9
    truth_mm, estimate_mm, half_mm = pairs.truth_m * 1e3, pairs.estimate_m * 1e3, Z_95 * pairs.std_m * 1e3
    if alarms is not None and distance == "clearance":
        _draw_curves(upper, charts.alarm_curves(score.alarm_events, alarms.below_m, seconds))
    truth_name = f"truth ({REFERENCE_NAMES[score.reference]})"
    _draw_curves(upper, charts.distance_curves(seconds, estimate_mm, half_mm, truth_mm, truth_name))
    lower.axhline(0.0, color="0.6", linewidth=0.8)
    _draw_curves(lower, charts.error_curves(seconds, estimate_mm - truth_mm, half_mm))
    upper.set_title(_title(score, distance, pairs), loc="left")
    upper.set_ylabel(f"{distance} [mm]")
    lower.set(xlabel="time [s]", ylabel="error [mm]")
    if not score.measured_count:
        _say_nothing(upper, score.rejected)
        lower.set_yticks([])
    upper.tick_params(labelsize=7, labelbottom=False)
    lower.tick_params(labelsize=7)


def _title(score: Score, distance: str, pairs: Pairs) -> str:
    name = f"{plain_name(score.recording)}: {plain_name(score.method)}"
    if (found := pairs.statistics) is None:
        return f"{name}\n{'no distance to compare with' if score.measured_count else 'nothing measured'}"
    if distance != "distance":
        held = pairs.interval_coverage
        interval = "" if held is None else f", {held * 100:.0f} % in the 95 % interval"
        return f"{name}, {distance}\nRMSE {found.rmse * 1e3:.2f} mm{interval}, n {found.count}"
    r2 = "–" if found.r_squared is None else f"{found.r_squared:.4f}"
    fitted = ", fitted on" if score.fitted_on else ""
    return f"{name}\nR² {r2}, RMSE {found.rmse * 1e3:.2f} mm, σ {found.truth_std * 1e3:.1f} mm, n {found.count}{fitted}"


NAMES = {"": "planar distance", "spatial_": "spatial distance", "clearance_": "clearance"}
"""The distances, by what the keys of their metrics begin with."""
LINE_IN, HEAD_IN = 0.19, 0.75  # height of a method's line, and of what a row of panels needs besides, in inches
WIDE = 20.0  # errors that differ by more than this factor are drawn on a logarithmic axis


def draw_compare(scores: Sequence[MethodScore]) -> Figure:
    """A line per method; groups of frames differ by marker, and the one over all frames is black and filled."""
    groups = list(dict.fromkeys(score.group for score in scores))
    methods = list(dict.fromkeys(score.method for score in scores))
    metrics = {metric.key: metric for metric in figure_metrics()}
    others = (one for one in groups if one != Group(ALL, ALL))
    kinds = product(("0.35", "0.6", "0.0"), MARKERS[1:])
    looks = {group: (grey, marker, 4.0) for group, (grey, marker) in zip(others, kinds, strict=False)}
    known = [key for key in NAMES if any(metrics[f"{key}rmse_m"].value(score.figures) for score in scores)]
    legend_rows = -(-len(groups) // _columns(map(str, groups), PAGE_IN)) if len(groups) > 1 else 0
    height_in = 2 * (LINE_IN * len(methods) + HEAD_IN) + 0.17 * legend_rows + 0.25
    figure = Figure(figsize=(PAGE_IN, height_in), layout="constrained")
    axes = figure.subplots(2, 1 + len(known), squeeze=False, sharey=True)
    frame_count = max(score.figures.frame_count for score in scores)
    title = f"{', '.join(map(plain_name, methods))}: {counted(frame_count, 'frame')}"
    figure.suptitle(title, fontsize=8, x=0.01, ha="left")
    labels = {"coverage": "frames measured [%]", "ms_per_frame": "time per frame [ms]"}
    for key in known:
        labels[f"{key}rmse_m"] = f"RMSE [mm]\n{NAMES[key]}"
        labels[f"{key}interval_coverage"] = f"truths in 95 % interval [%]\n{NAMES[key]}"
    for panel, (key, label) in zip(axes.T.flat, labels.items(), strict=True):
        metric, shown = metrics[key], []
        for score in scores:
            value = metric.value(score.figures)
            colour, marker, size = looks.get(score.group, ("0.0", MARKERS[0], 5.5))
            if isinstance(value, float) and np.isfinite(value):
                shown.append(value * metric.unit.factor)
                panel.plot(shown[-1:], [methods.index(score.method)], linestyle="none", marker=marker, color=colour,
                           markersize=size, markerfacecolor=colour if size > 4 else "none", markeredgewidth=0.8,
                           clip_on=False, zorder=4 - 0.2 * size, label=plain_name(str(score.group)) or ALL)  # fmt: skip
        panel.set_xlabel(label)
        if metric.unit is SHARE:
            panel.set_xlim(0, 100)
        else:
            _decades(panel, shown)
        if key.endswith("interval_coverage"):
            panel.set_visible(bool(shown))  # planar methods state no interval
            panel.axvline(95.0, color="0.0", linewidth=0.8, linestyle="--")
        panel.set_ylim(len(methods) - 0.5, -0.5)
        panel.set_yticks(range(len(methods)), [plain_name(method) for method in methods])
        panel.tick_params(labelsize=7, labelleft=panel in axes[:, 0])
    if len(groups) > 1:
        _legend(figure, axes[:1, 0])
    return figure


def _decades(panel: Axes, shown: Sequence[float]) -> None:
    """Begin the x axis at zero, or make it logarithmic where its values differ much."""
    positive = [value for value in shown if value > 0]
    if not positive or max(positive) <= WIDE * min(positive):
        panel.set_xlim(left=0.0)
        return
    panel.set_xscale("log")
    is_short = max(positive) < 100.0 * min(positive)  # two decades
    panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if is_short else (1.0,)))
    panel.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panel.xaxis.set_minor_formatter(NullFormatter())

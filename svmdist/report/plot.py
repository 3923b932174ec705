"""The paper's Fig. 6: truth and estimate over time, the residual and its stated 95 % interval below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from svmdist.errors import OutputError
from svmdist.estimation.alarms import AlarmRules
from svmdist.metrics import deviations_at
from svmdist.report.plot_style import COLUMN_IN, PAGE_IN, plain_name, plot_format, print_looks, write_figure
from svmdist.report.series_values import with_breaks
from svmdist.workflows.scoring.distances import DistanceScore, Pairs
from svmdist.workflows.scoring.score import Score
from svmdist.workflows.scoring.truth import Reference
from svmdist.workflows.validate import Validation

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


def _curves(score: Score) -> _Curves:
    """The distance that says most of what was asked: the clearance, the spatial distance, or the planar one."""
    label = _reference_label(score.reference)
    for distance, in_3d in (("clearance", score.clearance), ("spatial distance", score.spatial)):
        if in_3d is not None:
            return _Curves(distance, in_3d.pairs, _title_3d(score, distance, in_3d), label)
    return _Curves("distance", score.pairs, _title(score), label)


def _draw_panel(upper: Axes, lower: Axes, curves: _Curves) -> None:
    pairs = curves.pairs
    seconds = (pairs.stamps_ns - (pairs.stamps_ns[0] if len(pairs.stamps_ns) else 0)) / 1e9
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

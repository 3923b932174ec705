"""The paper's Fig. 6: truth and estimate over time, with the residual below."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from svmdist.errors import OutputError
from svmdist.output_file import whole_file
from svmdist.report.text import printable
from svmdist.workflows.scoring.score import Score
from svmdist.workflows.scoring.truth import Reference
from svmdist.workflows.validate import Validation

TRUTH_COLOUR, ESTIMATE_COLOUR = "#c1272d", "#1f5fa8"  # red and blue, as in the paper
MAX_GAP_IN_STEPS = 3.0
"""A curve is broken where frames are missing for longer than this many frame periods."""


def save_plot(validation: Validation, path: Path, reference: Reference | None = None) -> None:
    """Draw one panel a recording and write the figure in the format of the path's suffix.

    Raises OutputError for a suffix matplotlib cannot write, for a reference that no recording has, and
    where writing fails.
    """
    scores = _scores_to_draw(validation, reference)
    if not scores:
        raise OutputError(f"{path}: nothing to draw: no recording was compared with {reference}")
    suffix = plot_format(path)
    figure = draw(scores)
    metadata = {"Date": None} if suffix == "svg" else None
    # SVG ids and dates would differ between two runs on the same data.
    with whole_file(path) as target, mpl.rc_context({"svg.hashsalt": "svmdist"}), warnings.catch_warnings():
        # A name may hold letters that the font lacks: a box is drawn, which is no news to the user.
        warnings.filterwarnings("ignore", r"Glyph \d+ .*missing from font", UserWarning)
        figure.savefig(target, dpi=150, format=suffix, metadata=metadata)


def plot_format(path: Path) -> str:
    """The format of a path's suffix; raises OutputError, which lists the choices, for one matplotlib cannot write."""
    formats = set(Figure().canvas.get_supported_filetypes()) - {"pgf"}  # which needs a TeX installation
    suffix = path.suffix.lstrip(".").lower()
    if suffix not in formats:
        raise OutputError(f"{path}: cannot draw a .{suffix}: the choices are {', '.join(sorted(formats))}")
    return suffix


def draw(scores: Sequence[Score]) -> Figure:
    """Draw the panels, two columns wide where there are several."""
    columns = 1 if len(scores) == 1 else 2
    rows = -(-len(scores) // columns)
    figure = Figure(figsize=(5.6 * columns, 3.3 * rows), layout="constrained")
    grid = figure.add_gridspec(rows, columns)
    for index, score in enumerate(scores):
        cell = grid[index // columns, index % columns].subgridspec(2, 1, height_ratios=(3, 1), hspace=0.04)
        upper = figure.add_subplot(cell[0])
        lower = figure.add_subplot(cell[1], sharex=upper)
        _draw_panel(upper, lower, score, with_legend=index == 0)
    return figure


def _scores_to_draw(validation: Validation, reference: Reference | None) -> list[Score]:
    if reference is None:
        primary = validation.primary
        reference = primary.reference if primary else validation.scores[0].reference
    return [score for score in validation.scores if score.reference is reference]


def _draw_panel(upper: Axes, lower: Axes, score: Score, *, with_legend: bool) -> None:
    pairs = score.pairs
    seconds = (pairs.stamps_ns - (pairs.stamps_ns[0] if len(pairs.stamps_ns) else 0)) / 1e9
    truth_mm, estimate_mm = pairs.truth_m * 1e3, pairs.estimate_m * 1e3
    time, truth, estimate = _with_breaks(seconds, truth_mm, estimate_mm)
    upper.plot(time, truth, color=TRUTH_COLOUR, linewidth=1.6, label=_reference_label(score.reference))
    upper.plot(
        time, estimate, color=ESTIMATE_COLOUR, linewidth=1.0, marker=".", markersize=3, label="estimate"
    )
    lower.axhline(0.0, color="0.6", linewidth=0.8)
    lower.plot(time, estimate - truth, color="0.25", linewidth=0.9, marker=".", markersize=2)
    upper.set_title(_title(score), fontsize=9, loc="left")
    upper.set_ylabel("distance [mm]", fontsize=8)
    lower.set_ylabel("error [mm]", fontsize=8)
    lower.set_xlabel("time [s]", fontsize=8)
    for axes in (upper, lower):
        axes.tick_params(labelsize=7)
        axes.grid(color="0.92", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    upper.tick_params(labelbottom=False)
    if with_legend:
        upper.legend(fontsize=7, frameon=False, loc="best")


def _title(score: Score) -> str:
    # A dollar sign in a file's name must not start a formula.
    name = printable(score.recording).replace("$", r"\$")
    statistics = score.statistics
    if statistics is None:
        return f"{name}: nothing measured"
    r2 = "–" if statistics.r_squared is None else f"{statistics.r_squared:.4f}"
    fitted = ", fitted on" if score.fitted_on else ""
    return (
        f"{name}: R² {r2}, RMSE {statistics.rmse * 1e3:.2f} mm, σ {statistics.truth_std * 1e3:.1f} mm,"
        f" n {statistics.count}{fitted}"
    )


def _reference_label(reference: Reference) -> str:
    return "truth (simulator)" if reference is Reference.GROUND_TRUTH else "truth (DH kinematics)"


def _with_breaks(
    seconds: np.ndarray, truth: np.ndarray, estimate: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Put a NaN between frames that are far apart, so that no line spans what was not measured."""
    if len(seconds) < 3:
        return seconds, truth, estimate
    steps = np.diff(seconds)
    at = np.flatnonzero(steps > MAX_GAP_IN_STEPS * np.median(steps)) + 1
    return (np.insert(seconds, at, np.nan), np.insert(truth, at, np.nan), np.insert(estimate, at, np.nan))

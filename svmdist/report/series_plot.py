"""Plots of series for print: column width, told apart in greyscale by line and marker, the method in the title."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from svmdist.errors import OutputError
from svmdist.report.plot_style import (
    COLUMN_IN,
    PAGE_IN,
    PANEL_IN,
    plain_name,
    plot_format,
    print_looks,
    write_figure,
)
from svmdist.report.series_values import (
    LEVELS,
    distance_name,
    held_shares,
    pooled,
    rejected_spans,
    with_breaks,
)
from svmdist.workflows.series import Series

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
        f"{_name(series)}: {series.method}, {int(series.measured.sum())} of {len(series)} frames", loc="left"
    )
    axes.set(xlabel="time [s]", ylabel=f"{distance_name(series)} [mm]")
    axes.legend(loc="best", ncols=2)


def _draw_residuals(axes: Sequence[Axes], group: Sequence[Series]) -> None:
    over_time, over_distance = axes
    for at, one in enumerate(group):
        error_mm = one.error_m * 1e3
        marker, colour = "ox^sdv"[at % 6], str(0.15 + 0.5 * (at % 3) / 2)
        style: dict[str, Any] = {"s": 6.0, "marker": marker, "color": colour, "linewidths": 0.6}
        over_time.scatter(one.seconds, error_mm, label=_name(one), **style)
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


def _name(series: Series) -> str:
    return plain_name(f"{series.recording} {series.instrument}")

"""The figures of a report as plotly's JSON, each with a text that says what it shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from svmdist.report.series_values import LEVELS, distance_name, held_shares, pooled, rejected_spans
from svmdist.transforms import Array
from svmdist.workflows.series import Series

BLUE, VERMILION, GREEN, ORANGE, SKY, PINK = "#3a86c8", "#d55e00", "#009e73", "#e69f00", "#56b4e9", "#cc79a7"
"""Told apart with any colour vision, and seen on white and on black (after Okabe & Ito 2008)."""
BAND, REJECTED = "rgba(86,180,233,0.30)", "rgba(213,94,0,0.18)"
MAX_MARKERS = 2000
"""More points than these are drawn as a line, or thinned out evenly where they are no line."""


MAX_SHAPES = 200
"""More spans than these are drawn as one area."""


@dataclass(frozen=True)
class HtmlFigure:
    """A figure: its name, heading, plotly's data and layout, and a text in place of it."""

    name: str
    title: str
    text: str
    data: list[dict[str, Any]]
    layout: dict[str, Any] = field(default_factory=dict)
    linked: bool = False
    """Whether it is over time, and zooms with the others that are."""
    square: bool = False


def numbers(values: Array, digits: int = 4) -> list[float | None]:
    """Numbers as JSON has them, rounded: what is not finite does not exist."""
    return [round(float(value), digits) if np.isfinite(value) else None for value in values]


def distance_over_time(series: Series, name: str, alarm_below_m: float | None = None) -> HtmlFigure:
    """Estimate with its interval, truth, the alarm's threshold, and the spans that were not measured."""
    time = numbers(series.seconds, 3)
    half_m = series.half_m
    data: list[dict[str, Any]] = []
    if np.isfinite(half_m).any():
        low_mm, high_mm = ((series.estimate_m + sign * half_m) * 1e3 for sign in (-1.0, 1.0))
        data.append(_band(series.seconds, low_mm, high_mm))
    if np.isfinite(series.truth_m).any():
        data.append(_line(time, numbers(series.truth_m * 1e3), "truth", VERMILION, dash="dash"))
    estimate = _line(time, numbers(series.estimate_m * 1e3), "estimate", BLUE)
    estimate["mode"] = "lines" if len(series) > MAX_MARKERS else "lines+markers"
    estimate["marker"] = {"size": 4}
    estimate["customdata"] = series.number.tolist()
    estimate["hovertemplate"] = "frame %{customdata}<br>%{x:.2f} s: %{y:.2f} mm<extra></extra>"
    data.append(estimate)
    if estimate["mode"] == "lines":
        data += _singles(series.seconds, series.estimate_m * 1e3)
    spans = rejected_spans(series)
    shapes = [
        {
            **{"type": "rect", "xref": "x", "yref": "paper", "x0": low, "x1": high, "y0": 0, "y1": 1},
            **{"fillcolor": REJECTED, "line": {"width": 0}, "layer": "below"},
        }
        for low, high in spans
    ]
    if len(spans) > MAX_SHAPES:
        shapes = []
        data.append(_shaded(spans))
    elif spans:
        data.append({"type": "scatter", "x": [None], "y": [None], "mode": "markers", "name": "not measured",
                     "marker": {"symbol": "square", "size": 12, "color": REJECTED}})  # fmt: skip
    if alarm_below_m is not None and series.distance == "clearance":
        ends = [time[0], time[-1]] if time else []
        below = [alarm_below_m * 1e3] * len(ends)
        data.append(_line(ends, below, f"alarm below {alarm_below_m * 1e3:g} mm", ORANGE, dash="dot"))
    measured = series.measured
    text = f"{int(measured.sum())} of {len(series)} frames measured."
    if measured.any():
        least, most = np.nanmin(series.estimate_m) * 1e3, np.nanmax(series.estimate_m) * 1e3
        text += f" The estimated {distance_name(series)} runs from {least:.1f} to {most:.1f} mm."
    if spans:
        text += f" {len(spans)} spans were not measured; they are shaded."
    title = f"{distance_name(series)} over time"
    layout = _over_time(series, f"{distance_name(series)} [mm]", shapes)
    if len(spans) > MAX_SHAPES:
        layout["yaxis2"] = {"overlaying": "y", "range": [0, 1], "fixedrange": True, "visible": False}
    return HtmlFigure(name, title, text, data, layout, linked=True)


def _band(seconds: Array, low: Array, high: Array) -> dict[str, Any]:
    """The area between two curves, an outline for each run of frames that have both.

    As a fill between two traces it would reach across what was not measured. Frames that stand alone have a width.
    """
    known = np.isfinite(low) & np.isfinite(high)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(int)))
    reach_s, gap = _reach_s(seconds), [np.nan]
    x: list[Any] = []
    y: list[Any] = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        run = slice(begin, end)
        times, lows, highs = seconds[run], low[run], high[run]
        if end - begin == 1:
            times = np.array([times[0] - reach_s, times[0] + reach_s])
            lows, highs = np.repeat(lows, 2), np.repeat(highs, 2)
        x += [times, times[::-1], gap]
        y += [lows, highs[::-1], gap]
    return {
        "type": "scatter",
        "mode": "lines",
        "x": numbers(np.concatenate(x), 3),
        "y": numbers(np.concatenate(y)),
        "line": {"width": 0},
        "fill": "toself",
        "fillcolor": BAND,
        "hoverinfo": "skip",
        "name": "95 % interval",
    }


def _singles(seconds: Array, values: Array) -> list[dict[str, Any]]:
    """Frames that stand alone between others without a value, which a line does not show, as short dashes."""
    known = np.concatenate([[False], np.isfinite(values), [False]])
    alone = np.flatnonzero(known[1:-1] & ~known[:-2] & ~known[2:])
    if len(alone) == 0:
        return []
    reach_s, gap = _reach_s(seconds), np.full(len(alone), np.nan)
    x = np.stack([seconds[alone] - reach_s, seconds[alone] + reach_s, gap], 1).ravel()
    y = np.stack([values[alone], values[alone], gap], 1).ravel()
    dashes = _line(numbers(x, 3), numbers(y), "single frames", BLUE)
    return [{**dashes, "hoverinfo": "skip", "showlegend": False, "line": {"color": BLUE, "width": 3}}]


def _reach_s(seconds: Array) -> float:
    """How far what stands for one frame reaches to either side: less than half of the way to the next one."""
    return 0.3 * float(np.median(np.diff(seconds))) if len(seconds) > 1 else 0.05


def _shaded(spans: Sequence[tuple[float, float]]) -> dict[str, Any]:
    """Spans as one area from the bottom to the top: a browser takes seconds for thousands of shapes."""
    x = [second for low, high in spans for second in (low, low, high, high)]
    return {
        "type": "scatter",
        "mode": "lines",
        "x": x,
        "y": [0, 1, 1, 0] * len(spans),
        "yaxis": "y2",
        "fill": "tozeroy",
        "fillcolor": REJECTED,
        "line": {"width": 0},
        "hoverinfo": "skip",
        "name": "not measured",
    }


def error_over_time(series: Series, name: str) -> HtmlFigure:
    """Estimate less truth, with the stated interval about zero."""
    time, half_mm = numbers(series.seconds, 3), series.half_m * 1e3
    data: list[dict[str, Any]] = []
    if np.isfinite(half_mm).any():
        data.append(_band(series.seconds, -half_mm, half_mm))
    error = _line(time, numbers(series.error_m * 1e3), "error", BLUE)
    error["customdata"] = series.number.tolist()
    error["hovertemplate"] = "frame %{customdata}<br>%{x:.2f} s: %{y:+.2f} mm<extra></extra>"
    data += [error, *_singles(series.seconds, series.error_m * 1e3)]
    known = series.error_m[np.isfinite(series.error_m)] * 1e3
    text = f"RMSE {np.sqrt(np.mean(known**2)):.2f} mm, largest error {np.abs(known).max():.2f} mm."
    return HtmlFigure(name, "error over time", text, data, _over_time(series, "error [mm]"), linked=True)


def consistency_over_time(series: Series, name: str) -> HtmlFigure:
    """How far measurements and predictions agree; 1 is as expected."""
    data = [_line(numbers(series.seconds, 3), numbers(series.consistency, 3), "consistency", PINK)]
    known = series.consistency[np.isfinite(series.consistency)]
    text = f"Innovations over what is expected of them: median {np.median(known):.2f}, largest {known.max():.2f}."
    layout = _over_time(series, "consistency (1: as expected)")
    layout["yaxis"]["rangemode"] = "tozero"
    return HtmlFigure(name, "consistency over time", text, data, layout, linked=True)


def error_over_distance(series: Sequence[Series], name: str) -> HtmlFigure:
    """Errors over the true distance."""
    truth_mm, error_mm, _ = pooled(series)
    data = [_dots(truth_mm, error_mm, "true %{x:.2f} mm<br>error %{y:+.2f} mm<extra></extra>")]
    text = _thinned(len(truth_mm), _trend(truth_mm, error_mm))
    return HtmlFigure(name, "error over distance", text, data, _plain("true distance [mm]", "error [mm]"))


def error_over_image(series: Sequence[Series], name: str) -> HtmlFigure:
    """Where in the image the tool was, coloured by the size of the error; y runs down, as in the image."""
    places = np.concatenate([one.tool_px for one in series])
    error_mm = np.abs(np.concatenate([one.error_m for one in series])) * 1e3
    kept = np.isfinite(error_mm) & np.isfinite(places).all(1)
    places, error_mm = places[kept], error_mm[kept]
    chosen = _chosen(len(error_mm))
    dots = _dots(
        places[:, 0], places[:, 1], "(%{x:.0f}, %{y:.0f}) px<br>|error| %{marker.color:.2f} mm<extra></extra>"
    )
    dots["marker"] |= {
        "color": numbers(error_mm[chosen], 3),
        "colorscale": "Cividis",
        "showscale": True,
        "colorbar": {"title": {"text": "|error| [mm]"}, "thickness": 12},
        "opacity": 0.9,
    }
    layout = _plain("tool x [px]", "tool y [px]")
    layout["yaxis"]["autorange"] = "reversed"
    text = _thinned(len(error_mm), "Where the tool was in the image, coloured by the size of the error.")
    return HtmlFigure(name, "error over image position", text, [dots], layout, square=True)


def bland_altman(series: Sequence[Series], name: str) -> HtmlFigure:
    """Difference over mean of estimate and truth, with bias and limits of agreement (Bland & Altman 1986)."""
    truth_mm, error_mm, _ = pooled(series)
    mean_mm = truth_mm + 0.5 * error_mm
    bias, deviation = float(error_mm.mean()), float(error_mm.std(ddof=1)) if len(error_mm) > 1 else 0.0
    low, high = bias - 1.96 * deviation, bias + 1.96 * deviation
    ends = [float(mean_mm.min()), float(mean_mm.max())]
    data = [_dots(mean_mm, error_mm, "mean %{x:.2f} mm<br>difference %{y:+.2f} mm<extra></extra>")]
    data.append(_line(ends, [bias, bias], f"bias {bias:+.2f} mm", VERMILION))
    data += [
        _line(ends, [limit, limit], f"limit {limit:+.2f} mm", VERMILION, dash="dash") for limit in (low, high)
    ]
    text = f"Bias {bias:+.2f} mm; 95 % limits of agreement {low:+.2f} to {high:+.2f} mm."
    layout = _plain("mean of estimate and truth [mm]", "estimate − truth [mm]")
    return HtmlFigure(name, "Bland–Altman", _thinned(len(mean_mm), text), data, layout)


def error_distribution(series: Sequence[Series], name: str) -> HtmlFigure:
    """A histogram of the errors."""
    _, error_mm, _ = pooled(series)
    counts, edges = np.histogram(error_mm, bins=min(60, max(10, int(np.sqrt(len(error_mm))))))
    data = [
        {
            "type": "bar",
            "x": numbers(0.5 * (edges[1:] + edges[:-1])),
            "y": counts.tolist(),
            "width": numbers(np.diff(edges)),
            "marker": {"color": BLUE},
            "name": "frames",
            "hovertemplate": "%{x:+.2f} mm: %{y} frames<extra></extra>",
        }
    ]
    low, middle, high = np.percentile(error_mm, [2.5, 50.0, 97.5])
    text = f"Median error {middle:+.2f} mm; 95 % of the errors are between {low:+.2f} and {high:+.2f} mm."
    layout = _plain("error [mm]", "frames")
    layout["bargap"] = 0.02
    return HtmlFigure(name, "distribution of errors", text, data, layout)


def interval_calibration(series: Sequence[Series], name: str) -> HtmlFigure:
    """Share of truths inside intervals of several levels; on the diagonal, intervals are honest."""
    held, _ = held_shares(series)
    levels = [100.0 * level for level in LEVELS]
    data = [
        _line([50.0, 100.0], [50.0, 100.0], "honest", VERMILION, dash="dash"),
        {
            **_line(levels, [round(share, 2) for share in held], "truths inside", BLUE),
            "mode": "lines+markers",
            "hovertemplate": "stated %{x:g} %: %{y:.1f} % inside<extra></extra>",
        },
    ]
    at_95 = held[LEVELS.index(0.95)]
    text = (
        f"{at_95:.1f} % of the truths are inside the stated 95 % interval."
        " Below the diagonal, intervals are too narrow."
    )
    layout = _plain("stated level [%]", "truths inside [%]")
    return HtmlFigure(name, "calibration of the interval", text, data, layout)


def _chosen(count: int) -> Array:
    """Indices of what is drawn of so many points, evenly over them."""
    return np.unique(np.linspace(0, max(count - 1, 0), min(count, MAX_MARKERS)).round().astype(int))


def _thinned(count: int, text: str) -> str:
    return text if count <= MAX_MARKERS else f"{text} {MAX_MARKERS} of {count} points are drawn."


def _trend(x: Array, y: Array) -> str:
    if len(x) < 3 or np.ptp(x) == 0.0:
        return "Too few points for a trend."
    slope = float(np.polyfit(x, y, 1)[0])
    return f"The error changes by {slope * 10:+.2f} mm for each 10 mm of distance."


def _line(x: Sequence[Any], y: Sequence[Any], name: str, colour: str, dash: str = "solid") -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "lines",
        "x": list(x),
        "y": list(y),
        "name": name,
        "line": {"color": colour, "width": 1.8, "dash": dash},
        "connectgaps": False,
    }


def _dots(x: Array, y: Array, hover: str) -> dict[str, Any]:
    chosen = _chosen(len(x))
    return {
        "type": "scatter",
        "mode": "markers",
        "x": numbers(x[chosen]),
        "y": numbers(y[chosen]),
        "marker": {"color": BLUE, "size": 5, "opacity": 0.6},
        "hovertemplate": hover,
        "showlegend": False,
        "name": "frames",
    }


def _plain(x_title: str, y_title: str) -> dict[str, Any]:
    return {
        "margin": {"l": 60, "r": 15, "t": 10, "b": 45},
        "xaxis": {"title": {"text": x_title}},
        "yaxis": {"title": {"text": y_title}},
        "legend": {"orientation": "h", "y": 1.12, "x": 0},
        "hovermode": "closest",
    }


def _over_time(series: Series, y_title: str, shapes: Sequence[dict[str, Any]] = ()) -> dict[str, Any]:
    layout = {**_plain("time [s]", y_title), "shapes": list(shapes), "dragmode": "zoom"}
    if len(series) > 1:  # all plots over time begin and end alike
        layout["xaxis"] |= {
            "range": [round(float(series.seconds[at]), 3) for at in (0, -1)],
            "autorange": False,
        }
    return layout

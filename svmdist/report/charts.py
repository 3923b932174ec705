"""Charts as data, in mm: what is drawn of series, for plots in print and for a report's page alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from svmdist.drawing import ALARM_COLOUR, Rgb
from svmdist.metrics import interval_coverage, runs
from svmdist.report.tables import counted
from svmdist.results import AlarmEvent
from svmdist.transforms import Array
from svmdist.workflows.estimate import Series

LEVELS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)  # levels of intervals whose calibration is shown
MAX_GAP_IN_STEPS = 3.0  # a curve is broken where frames are missing for longer than this many frame periods

Form = Literal["line", "dots", "bars", "band", "spans"]
"""How a curve's points are drawn; a band is between `low` and `y`, spans have the full height from `x` to `y`."""
Role = Literal["estimate", "error", "truth", "interval", "lost", "threshold", "model", "limit", "consistency", "alarm"]
"""What a curve shows: it decides on the colour, and on the dash of a line."""
COLOURS: dict[Role, Rgb] = {
    **dict.fromkeys(("estimate", "error", "interval", "consistency"), (45, 120, 190)),
    **dict.fromkeys(("truth", "model", "limit"), (120, 120, 120)),
    **dict.fromkeys(("alarm", "threshold"), ALARM_COLOUR),
    "lost": (150, 150, 150),
}
"""The same in print and on pages, on white and on black; of alarms the same as in pictures."""


@dataclass(frozen=True)
class Curve:
    """Points of a curve, shape (n,); NaN is a gap. `number` has the frames; `hover` is plotly's template."""

    form: Form
    role: Role
    name: str
    x: Array
    y: Array
    low: Array | None = None
    number: Array | None = None
    colour_by: Array | None = None
    hover: str = ""


@dataclass(frozen=True)
class Chart:
    """A chart with its heading, and a text in place of it."""

    title: str
    text: str
    x_title: str
    y_title: str
    curves: Sequence[Curve]
    over_time: bool = False
    is_image: bool = False  # x and y are pixels: y runs down


def with_errors(series: Sequence[Series]) -> list[list[Series]]:
    """The series that have an error, by their distance."""
    known = [one for one in series if np.isfinite(one.error_m).any()]
    return [[one for one in known if one.distance == of] for of in dict.fromkeys(one.distance for one in known)]


def distance_name(series: Series) -> str:
    """The series' distance in words."""
    return series.distance if series.distance == "clearance" else f"{series.distance} distance"


def distance_curves(
    seconds: Array, estimate_mm: Array, half_mm: Array, truth_mm: Array, truth_name: str = "truth"
) -> list[Curve]:
    """Interval, truth and estimate over time, shape (n,) each, as far as there are any."""
    seconds, estimate_mm, half_mm, truth_mm = with_breaks(seconds, estimate_mm, half_mm, truth_mm)
    curves = _interval(seconds, estimate_mm, half_mm)
    if np.isfinite(truth_mm).any():
        curves.append(Curve("line", "truth", truth_name, seconds, truth_mm))
    return [*curves, Curve("line", "estimate", "estimate", seconds, estimate_mm)]


def error_curves(seconds: Array, error_mm: Array, half_mm: Array) -> list[Curve]:
    """The reported interval about zero, and errors over time, shape (n,) each."""
    seconds, error_mm, half_mm = with_breaks(seconds, error_mm, half_mm)
    return [*_interval(seconds, np.zeros(len(seconds)), half_mm), Curve("line", "error", "error", seconds, error_mm)]


def _interval(seconds: Array, middle_mm: Array, half_mm: Array) -> list[Curve]:
    if not np.isfinite(half_mm).any():
        return []
    high, low = middle_mm + half_mm, middle_mm - half_mm
    return [Curve("band", "interval", "95 % interval", seconds, high, low)]


def alarm_curves(events: Sequence[AlarmEvent], below_m: float, seconds: Array) -> list[Curve]:
    """The spans of alarms, half a frame wider on both sides, where there are any; last their threshold."""
    below_mm, half_s = below_m * 1e3, frame_reach_s(seconds, 0.5)
    x = seconds[[0, -1]] if len(seconds) else seconds
    curves = [Curve("line", "threshold", f"alarm below {below_mm:g} mm", x, np.full(len(x), below_mm))]
    if events:
        begins, ends = np.array([(one.start_s - half_s, one.end_s + half_s) for one in events]).T
        curves.insert(0, Curve("spans", "alarm", "alarm", begins, ends))
    return curves


def distance_over_time(series: Series) -> Chart:
    """Estimate with its interval, truth, the alarms and their threshold, and the spans that were not measured."""
    seconds, estimate_mm, name = series.seconds, series.estimate_m * 1e3, distance_name(series)
    text = f"{int(series.measured.sum())} of {len(series)} frames measured."
    if series.measured.any():
        least, most = np.nanmin(estimate_mm), np.nanmax(estimate_mm)
        text += f" The estimated {name} runs from {least:.1f} to {most:.1f} mm."
    curves = distance_curves(seconds, estimate_mm, series.half_m * 1e3, series.truth_m * 1e3)
    spans = []
    if lost := runs(~series.measured):
        text += f" Not measured: {counted(len(lost), 'span')}, shaded."
        half_s = frame_reach_s(seconds, 0.5)  # a span is half a frame wider on both sides
        ends_s = [(round(seconds[at] - half_s, 3), round(seconds[end - 1] + half_s, 3)) for at, end in lost]
        spans.append(Curve("spans", "lost", "not measured", *np.array(ends_s).T))
    if series.alarm_below_m is not None and series.distance == "clearance":
        text += f" {counted(len(series.events), 'alarm')}."
        *alarms, threshold = alarm_curves(series.events, series.alarm_below_m, seconds)
        spans += alarms
        curves.append(threshold)
    return _over_time(series, f"{name} over time", text, f"{name} [mm]", spans + curves)


def error_over_time(series: Series) -> Chart:
    """Estimate less truth, with the reported interval about zero."""
    error_mm = series.error_m * 1e3
    text = f"RMSE {np.sqrt(np.nanmean(error_mm**2)):.2f} mm, largest error {np.nanmax(np.abs(error_mm)):.2f} mm."
    curves = error_curves(series.seconds, error_mm, series.half_m * 1e3)
    return _over_time(series, "error over time", text, "error [mm]", curves)


def consistency_over_time(series: Series) -> Chart:
    """Normalised innovations squared; 1 is as expected."""
    known = series.consistency[np.isfinite(series.consistency)]
    text = f"Normalised innovations squared: median {np.median(known):.2f}, largest {known.max():.2f}."
    curve = Curve("line", "consistency", "consistency", series.seconds, series.consistency)
    return _over_time(series, "consistency over time", text, "consistency (1: as expected)", [curve])


def _over_time(series: Series, title: str, text: str, y_title: str, curves: list[Curve]) -> Chart:
    number = with_breaks(series.seconds, series.number.astype(np.float64))[1]
    hover = "frame %{customdata}<br>%{x:.2f} s: %{y:.2f}<extra></extra>"
    shown = [replace(one, number=number, hover=hover) if one.role in ("estimate", "error") else one for one in curves]
    return Chart(title, text, "time [s]", y_title, shown, over_time=True)


def errors_over(group: Sequence[Series], what: str) -> Chart:
    """Errors of each series over `time`, or over the true `distance`."""
    curves = []
    for one in group:
        kept = np.isfinite(one.error_m)
        x = one.seconds if what == "time" else one.truth_m * 1e3
        hover = f"{one.recording}<br>%{{x:.2f}}: error %{{y:+.2f}} mm<extra></extra>"
        name = f"{one.recording} {one.instrument}"
        curves.append(Curve("dots", "error", name, x[kept], one.error_m[kept] * 1e3, hover=hover))
    truth_mm, error_mm, _ = pooled(group)
    text = "Too few points for a trend."
    if len(truth_mm) > 2 and np.ptp(truth_mm) > 0.0:
        slope = float(np.polyfit(truth_mm, error_mm, 1)[0])
        text = f"The error changes by {slope * 10:+z.2f} mm for each 10 mm of distance."
    x_title = "time [s]" if what == "time" else f"true {distance_name(group[0])} [mm]"
    return Chart(f"error over {what}", text, x_title, "error [mm]", curves)


def error_over_image(group: Sequence[Series]) -> Chart:
    """Where in the image the tool was, coloured by the size of the error."""
    places = np.concatenate([one.tool_px for one in group])
    error_mm = np.abs(np.concatenate([one.error_m for one in group])) * 1e3
    kept = np.isfinite(error_mm) & np.isfinite(places).all(1)
    hover = "(%{x:.0f}, %{y:.0f}) px<br>|error| %{marker.color:.2f} mm<extra></extra>"
    x, y = places[kept].T
    dots = Curve("dots", "error", "|error| [mm]", x, y, colour_by=error_mm[kept], hover=hover)
    text = "Where the tool was in the image, coloured by the size of the error."
    return Chart("error over image position", text, "tool x [px]", "tool y [px]", [dots], is_image=True)


def agreement(group: Sequence[Series]) -> Chart:
    """Difference over mean of estimate and truth, with bias and limits of agreement (Bland & Altman 1986)."""
    truth_mm, error_mm, _ = pooled(group)
    mean_mm = truth_mm + 0.5 * error_mm
    bias, deviation = float(error_mm.mean()), float(error_mm.std(ddof=1)) if len(error_mm) > 1 else 0.0
    low, high = bias - 1.96 * deviation, bias + 1.96 * deviation
    hover = "mean %{x:.2f} mm<br>difference %{y:+.2f} mm<extra></extra>"
    ends = np.array([mean_mm.min(), mean_mm.max()])
    curves = [
        Curve("dots", "error", "frames", mean_mm, error_mm, hover=hover),
        Curve("line", "model", f"bias {bias:+z.2f} mm", ends, np.full(2, bias)),
        Curve("line", "limit", f"limit {low:+z.2f} mm", ends, np.full(2, low)),
        Curve("line", "limit", f"limit {high:+z.2f} mm", ends, np.full(2, high)),
    ]
    text = f"Bias {bias:+z.2f} mm; 95 % limits of agreement {low:+z.2f} to {high:+z.2f} mm."
    return Chart("Bland–Altman", text, "mean of estimate and truth [mm]", "estimate − truth [mm]", curves)


def distribution(group: Sequence[Series]) -> Chart:
    """A histogram of the errors."""
    _, error_mm, _ = pooled(group)
    counts, edges = np.histogram(error_mm, bins=min(60, max(10, int(np.sqrt(len(error_mm))))))
    hover = "%{x:+.2f} mm: %{y} frames<extra></extra>"
    bars = Curve("bars", "error", "frames", 0.5 * (edges[1:] + edges[:-1]), counts, hover=hover)
    low, middle, high = np.percentile(error_mm, [2.5, 50.0, 97.5])
    text = f"Median error {middle:+z.2f} mm; 95 % of the errors are between {low:+z.2f} and {high:+z.2f} mm."
    return Chart("distribution of errors", text, "error [mm]", "frames", [bars])


def calibration(group: Sequence[Series]) -> Chart:
    """Share of truths inside intervals of several levels; on the diagonal, intervals are as wide as stated."""
    truth_mm, error_mm, std_mm = pooled(group)
    kept = np.isfinite(std_mm)
    estimate_mm, truth_mm, std_mm = (truth_mm + error_mm)[kept], truth_mm[kept], std_mm[kept]
    held = [100.0 * (interval_coverage(estimate_mm, truth_mm, std_mm, level) or 0.0) for level in LEVELS]
    hover = "stated %{x:g} %: %{y:.1f} % inside<extra></extra>"
    ends = np.array([50.0, 100.0])
    inside = Curve("line", "estimate", "truths inside", 100.0 * np.array(LEVELS), np.array(held), hover=hover)
    curves = [Curve("line", "limit", "ideal", ends, ends), inside]
    text = f"{held[LEVELS.index(0.95)]:.1f} % of {len(truth_mm)} truths are inside the stated 95 % interval."
    text += " Below the diagonal, intervals are too narrow."
    return Chart("calibration of the interval", text, "stated level [%]", "truths inside [%]", curves)


def frame_reach_s(seconds: Array, share: float) -> float:
    """How far one frame's mark reaches to either side: a share of the way to the next one."""
    return share * float(np.nanmedian(np.diff(seconds))) if len(seconds) > 1 else 0.05


def pooled(series: Sequence[Series]) -> tuple[Array, Array, Array]:
    """Truth, error and deviation in mm of all frames that have an error."""
    found_mm = 1e3 * np.hstack([(one.truth_m, one.error_m, one.std_m) for one in series])
    truth_mm, error_mm, std_mm = found_mm[:, np.isfinite(found_mm[1])]
    return truth_mm, error_mm, std_mm


def with_breaks(seconds: Array, *curves: Array) -> tuple[Array, ...]:
    """Put a NaN between frames that are far apart, so that no line spans what was not measured."""
    if len(seconds) < 3:
        return seconds, *curves
    steps = np.diff(seconds)
    at = np.flatnonzero(steps > MAX_GAP_IN_STEPS * np.median(steps)) + 1
    return tuple(np.insert(values, at, np.nan) for values in (seconds, *curves))

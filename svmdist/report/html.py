"""The report of a validation or of estimates: one page that needs no network."""

from __future__ import annotations

import base64
import hashlib
import json
import platform
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from html import escape
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from svmdist.errors import printable
from svmdist.estimation.alarms import AlarmRules
from svmdist.files import write_atomically
from svmdist.recording.log import Recording
from svmdist.report.panels import draw_on
from svmdist.report.plots import LEVELS, distance_name, held_shares, pooled, rejected_spans
from svmdist.report.scores import remarks, validation_tables
from svmdist.report.tables import Table
from svmdist.report.writers import Results, require_report
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.workflows.frame_drawing import drawn_frames
from svmdist.workflows.parallel import Progress, Steps
from svmdist.workflows.request import Setup
from svmdist.workflows.scoring.truth import TruthRules
from svmdist.workflows.series import Series, WorstFrame, make_series, worst_frames
from svmdist.workflows.validate import Measured, Validation

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


JPEG_QUALITY = 80
MAX_WIDTH_PX = 960


@dataclass(frozen=True)
class ReportTable:
    """A table of texts."""

    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


@dataclass(frozen=True)
class ReportFrame:
    """One of the worst frames: its picture, shape (h, w, 3) in BGR, and what is bad about it."""

    caption: str
    picture: Image


@dataclass(frozen=True)
class Report:
    """All that a report shows. `facts` are names and values of where it comes from."""

    title: str
    series: Sequence[Series]
    tables: Sequence[ReportTable]
    frames: Sequence[ReportFrame]
    facts: Sequence[tuple[str, str]]
    notes: Sequence[str] = ()
    alarm_below_m: float | None = None


def write_report(report: Report, path: Path) -> None:
    """Write the page; raises OutputError where plotly is missing or the file cannot be written."""
    write_atomically(path, page(report))


def page(report: Report) -> Iterable[str]:
    """The page in pieces."""
    sections = _sections(report)
    figures = {
        figure.name: {"data": figure.data, "layout": figure.layout, "linked": figure.linked}
        for _, group in sections
        for figure in group
    }
    yield '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
    yield f"<title>{_text(report.title)}</title>\n"
    yield '<link rel="icon" href="data:,">\n'  # a browser asks for one by itself, which would need a network
    yield f"<style>{_asset('report.css')}</style>\n</head>\n<body>\n"
    yield f"<header><h1>{_text(report.title)}</h1>\n"
    yield '<nav aria-label="Sections"><a href="#summary">Summary</a> <a href="#figures">Figures</a> '
    yield '<a href="#frames">Worst frames</a> <a href="#provenance">Provenance</a></nav></header>\n<main>\n'
    yield '<section id="summary"><h2>Summary</h2>\n'
    for table in report.tables:
        yield from _table(table)
    for note in report.notes:
        yield f"<p>{_text(note)}</p>\n"
    yield '</section>\n<section id="figures"><h2>Figures</h2>\n'
    yield "<noscript><p>The figures need JavaScript; their texts and the tables do not.</p></noscript>\n"
    for heading, group in sections:
        yield from _figures(heading, group)
    yield '</section>\n<section id="frames"><h2>Worst frames</h2>\n<div class="frames">\n'
    for frame in report.frames:
        yield _frame(frame)
    yield "</div>\n"
    if not report.frames:
        yield "<p>No frame was drawn.</p>\n"
    yield '</section>\n<section id="provenance"><h2>Provenance</h2>\n<div class="scroll"><table class="facts"><tbody>\n'
    for name, value in report.facts:
        yield f'<tr><th scope="row">{_text(name)}</th><td>{_text(value)}</td></tr>\n'
    yield "</tbody></table></div></section>\n</main>\n"
    yield f'<script type="application/json" id="figures-data">{_json(figures)}</script>\n'
    yield f"<script>{_plotly()}</script>\n<script>{_asset('report.js')}</script>\n</body>\n</html>\n"


def _sections(report: Report) -> list[tuple[str, list[HtmlFigure]]]:
    """Figures over time, log by log, then those of all logs together."""
    sections = []
    for at, one in enumerate(report.series):
        group = [distance_over_time(one, f"distance-{at}", report.alarm_below_m)]
        if np.isfinite(one.error_m).any():
            group.append(error_over_time(one, f"error-{at}"))
        if np.isfinite(one.consistency).any():
            group.append(consistency_over_time(one, f"consistency-{at}"))
        sections.append((f"{one.recording}, {one.instrument}: {one.method}", group))
    for distance in dict.fromkeys(one.distance for one in report.series):
        known = [one for one in report.series if one.distance == distance and np.isfinite(one.error_m).any()]
        if not known:
            continue
        group = [
            error_over_distance(known, f"by-distance-{distance}"),
            error_over_image(known, f"by-place-{distance}"),
            bland_altman(known, f"bland-altman-{distance}"),
            error_distribution(known, f"distribution-{distance}"),
        ]
        if any(np.isfinite(one.std_m).any() for one in known):
            group.append(interval_calibration(known, f"calibration-{distance}"))
        sections.append((f"Errors of the {distance} distance, all logs" if distance != "clearance"
                         else "Errors of the clearance, all logs", group))  # fmt: skip
    return sections


def _figures(heading: str, group: Sequence[HtmlFigure]) -> Iterable[str]:
    yield f"<h3>{_text(heading)}</h3>\n"
    for figure in (one for one in group if one.linked):
        yield _figure(figure)
    side_by_side = [one for one in group if not one.linked]
    if side_by_side:
        yield '<div class="pair">\n'
        for figure in side_by_side:
            yield _figure(figure)
        yield "</div>\n"


def _figure(figure: HtmlFigure) -> str:
    kind = "plot square" if figure.square else "plot"
    label = escape(f"{figure.title}. {figure.text}", quote=True)
    return (
        f'<figure><div class="{kind}" id="{escape(figure.name, quote=True)}" role="img" aria-label="{label}"></div>'
        f"<figcaption><strong>{_text(figure.title)}.</strong> {_text(figure.text)}</figcaption></figure>\n"
    )


def _frame(frame: ReportFrame) -> str:
    data = base64.b64encode(_jpeg(frame.picture)).decode("ascii")
    caption = _text(frame.caption)
    return (
        f'<figure><img decoding="async" alt="{escape(printable(frame.caption), quote=True)}"'
        f' src="data:image/jpeg;base64,{data}"><figcaption>{caption}</figcaption></figure>\n'
    )


def _jpeg(picture: Image) -> bytes:
    if picture.shape[1] > MAX_WIDTH_PX:
        scale = MAX_WIDTH_PX / picture.shape[1]
        picture = np.asarray(
            cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8
        )
    return bytes(cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))[1].tobytes())


def _table(table: ReportTable) -> Iterable[str]:
    yield f'<h3>{_text(table.title)}</h3>\n<div class="scroll" tabindex="0"><table><thead><tr>'
    yield "".join(f'<th scope="col">{_text(heading)}</th>' for heading in table.headings)
    yield "</tr></thead><tbody>\n"
    for row in table.rows:
        yield "<tr>" + "".join(f"<td>{_text(cell)}</td>" for cell in row) + "</tr>\n"
    yield "</tbody></table></div>\n"
    if table.note:
        yield f'<p class="dim">{_text(table.note)}</p>\n'


def _text(text: str) -> str:
    """Text of a log or a user, made safe for a page."""
    return escape(printable(text), quote=True)


def _json(value: object) -> str:
    """JSON that cannot end the element it stands in."""
    text = json.dumps(value, ensure_ascii=True, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


@cache
def _asset(name: str) -> str:
    return files("svmdist.report").joinpath(name).read_text("utf-8")


def _plotly() -> str:
    require_report()
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs()).replace("</script", "<\\/script")


WORST_COUNT = 10
PACKAGES = ("svmdist", "numpy", "opencv-python-headless", "mcap", "protobuf", "plotly")


def validation_report(
    validation: Validation,
    measured: Sequence[Measured],
    setup: Setup,
    rules: TruthRules,
    command: str,
    jobs: int | None = None,
    logs: Results | None = None,
    on_progress: Progress | None = None,
) -> Report:
    """The report of a validation. The worst frames are measured once more, to draw them.

    `logs` is a table of all logs, of which `measured` are some.
    """
    primary = validation.primary
    reference = primary.reference if primary else validation.scores[0].reference
    series = [
        (one, made)
        for one in measured
        for made in make_series(one.rows, one.recording, setup, rules, reference, one.lag)
    ]
    tables = [_of_table(table) for table in validation_tables(validation)]
    lags = _lag_table(validation)
    below_m = validation.alarm_rules.below_m if validation.alarm_rules else None
    return Report(
        title=f"svmdist validate: {setup.method}",
        series=[made for _, made in series],
        tables=[*([_of_table(logs.tables[0])] if logs else []), *tables, *([lags] if lags else [])],
        frames=_worst(
            [(one.read, made) for one, made in series], setup, validation.alarm_rules, jobs, on_progress
        ),
        facts=facts(setup, [one.recording for one in measured], command),
        notes=[*validation.notes, *remarks(validation), f"Errors are against {reference}."],
        alarm_below_m=below_m,
    )


def estimate_report(
    measured: Sequence[Measured],
    setup: Setup,
    command: str,
    alarms: AlarmRules | None = None,
    jobs: int | None = None,
    logs: Results | None = None,
    on_progress: Progress | None = None,
) -> Report:
    """The report of estimates, for logs with or without a truth; where there is ground truth, it is shown.

    `logs` is a table of all logs, of which `measured` are some.
    """
    series = [
        (one, made) for one in measured for made in make_series(one.rows, one.recording, setup, lag=one.lag)
    ]
    return Report(
        title=f"svmdist estimate: {setup.method}",
        series=[made for _, made in series],
        tables=[*([_of_table(logs.tables[0])] if logs else []), _counts(series)],
        frames=_worst([(one.read, made) for one, made in series], setup, alarms, jobs, on_progress),
        facts=facts(setup, [one.recording for one in measured], command),
        alarm_below_m=alarms.below_m if alarms else None,
    )


def facts(setup: Setup, recordings: Sequence[Recording], command: str) -> list[tuple[str, str]]:
    """Where figures come from: command, versions, method, profile, calibration, and hashes of the recordings."""
    profile = setup.profile.model_dump_json(by_alias=True)
    found = [
        ("command", command),
        ("method", f"{setup.method}, {setup.equations} equations"),
        (
            "profile",
            f"{setup.profile.name}, SHA-256 of its values {hashlib.sha256(profile.encode()).hexdigest()}",
        ),
    ]
    if setup.calibration is not None:
        sources = ", ".join(f"{source.name} ({source.sha256})" for source in setup.calibration.sources)
        found.append(("calibration", f"by {setup.calibration.created_by}, fitted on {sources}"))
    found += [
        (str(one.path), f"SHA-256 {one.sha256()}, {one.size_bytes() / 1e6:.2f} MB") for one in recordings
    ]
    found.append(("Python", f"{platform.python_version()} on {platform.system()} {platform.machine()}"))
    return found + [(name, _version(name)) for name in PACKAGES]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _worst(
    series: Sequence[tuple[Recording, Series]],
    setup: Setup,
    alarms: AlarmRules | None,
    jobs: int | None,
    on_progress: Progress | None,
) -> list[ReportFrame]:
    """The worst frames of all logs, drawn, the worst first."""
    found: list[tuple[Recording, WorstFrame]] = []
    logs: dict[int, tuple[Recording, list[Series]]] = {}
    for recording, one in series:
        logs.setdefault(id(recording), (recording, []))[1].append(one)
    for recording, own in logs.values():
        found += [(recording, frame) for frame in worst_frames(own, WORST_COUNT)]
    found.sort(key=lambda pair: -pair[1].badness_m)
    chosen = found[:WORST_COUNT]
    wanted = defaultdict[int, set[int]](set)
    for recording, frame in chosen:
        wanted[id(recording)].add(frame.number)
    pictures = {}
    steps = Steps(on_progress, sum(max(numbers) + 1 for numbers in wanted.values()))
    for key, numbers in wanted.items():
        for drawn in drawn_frames(
            logs[key][0], setup, alarms, jobs=jobs, numbers=numbers, on_image=steps.advance
        ):
            image = drawn.replayed.image_bgr
            if image is not None:
                pictures[key, drawn.number] = draw_on(image, drawn.drawing)
    return [
        ReportFrame(f"{recording.name}, {frame.in_words}", pictures[id(recording), frame.number])
        for recording, frame in chosen
        if (id(recording), frame.number) in pictures
    ]


def _counts(series: Sequence[tuple[Measured, Series]]) -> ReportTable:
    rows = []
    for _, one in series:
        lost = Counter(status for status, seen in zip(one.status, one.measured, strict=True) if not seen)
        reasons = ", ".join(f"{count} {status}" for status, count in lost.most_common()) or "–"
        known_m = one.estimate_m[one.measured]
        span = f"{known_m.min() * 1e3:.2f} to {known_m.max() * 1e3:.2f}" if len(known_m) else "–"
        halves_m = one.half_m[np.isfinite(one.half_m)]
        half = f"{np.median(halves_m) * 1e3:.2f}" if len(halves_m) else "–"
        share = f"{one.measured.mean():.1%}" if len(one) else "–"
        rows.append((one.recording, one.instrument, str(len(one)), share, reasons, one.distance, span, half))
    headings = (
        *("recording", "instrument", "frames", "measured", "not measured", "distance"),
        *("range [mm]", "median half interval [mm]"),
    )
    return ReportTable("Frames", headings, rows)


def _lag_table(validation: Validation) -> ReportTable | None:
    """Errors before and after the lag was taken off, where one was."""
    rows = []
    for score in validation.scores:
        if (
            score.lag is None
            or score.lag.lag_s == 0.0
            or score.uncorrected is None
            or score.statistics is None
        ):
            continue
        rows.append(
            (
                score.recording,
                str(score.reference),
                f"{score.lag.lag_s * 1e3:+.1f}",
                f"{score.lag.confidence:.2f}",
                f"{score.uncorrected.rmse * 1e3:.2f}",
                f"{score.statistics.rmse * 1e3:.2f}",
            )
        )
    if not rows:
        return None
    headings = ("recording", "against", "lag [ms]", "confidence", "RMSE before [mm]", "RMSE after [mm]")
    return ReportTable("Lag before and after: planar distance", headings, rows)


def _of_table(table: Table) -> ReportTable:
    """A table for the terminal as one for the page."""
    return ReportTable(
        table.title, [heading.strip() for heading in table.headings], (*table.rows, *table.overall)
    )

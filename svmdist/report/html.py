"""The report of a validation or of estimates: one page with tables, plots and worst frames that needs no network."""

from __future__ import annotations

import base64
import hashlib
import platform
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import distributions
from importlib.resources import files
from typing import Any

import cv2
import numpy as np
import plotly.graph_objects as go
from jinja2 import Environment
from plotly.offline import get_plotlyjs

from svmdist.errors import printable
from svmdist.metrics import COUNT, LENGTH, SECONDS, SHARE, TEXT, Column, Unit, row_of, runs
from svmdist.recording.log import Recording
from svmdist.report import charts
from svmdist.report.charts import Chart, Curve, Role, frame_reach_s
from svmdist.report.on_image import draw_on
from svmdist.report.scores import remarks, validation_tables
from svmdist.report.tables import Table, counted
from svmdist.report.writers import Results
from svmdist.transforms import Array
from svmdist.workflows.estimate import Measured, Series, worst_frames
from svmdist.workflows.frame_drawing import drawn_frames
from svmdist.workflows.request import Request, Setup
from svmdist.workflows.validate import Validation

WORST_COUNT = 10
JPEG_QUALITY, MIN_WIDTH_PX, MAX_WIDTH_PX = 80, 480, 960
PACKAGES = ("svmdist", "numpy", "opencv-python-headless", "mcap", "protobuf", "plotly")
MAX_MARKERS = 2000  # more points than these are drawn as a line, or thinned out evenly where they are no line
DASHES: dict[Role, str] = {"truth": "dash", "limit": "dash", "threshold": "dot"}
THUMBNAIL: Any = {"lines": False, "least_px": MIN_WIDTH_PX, "letters": 1 / 26}  # pictures of frames are shown small
DASH_REACH = 0.3  # of one frame's mark, to either side, over the way to the next one


@dataclass(frozen=True)
class Report:
    """All that a report shows: `frames` are captions and JPEG pictures, `facts` names and values of its provenance."""

    title: str
    series: Sequence[Series]
    tables: Sequence[Table]
    frames: Sequence[tuple[str, bytes]]
    facts: Sequence[tuple[str, str]]
    notes: Sequence[str] = ()


def make_report(
    series: Sequence[Series],
    measured: Sequence[Measured],
    request: Request,
    command: str,
    validation: Validation | None = None,
    jobs: int | None = None,
    logs: Results | None = None,
) -> Report:
    """The report of estimates or of their validation; `logs` has a table of all logs, of which `measured` are some."""
    tables, notes = [*(logs.tables if logs else ())], []
    if validation is None:
        tables.append(Table.of("Frames", SERIES_COLUMNS, [row_of(SERIES_COLUMNS, one) for one in series]))
    else:
        notes = [*validation.notes, *remarks(validation), f"Errors are against {validation.reference}."]
        tables += validation_tables(validation)
        known = [one for one in validation.scores if one.uncorrected and one.statistics]
        if rows := [row_of(LAG_COLUMNS, one) for one in known if one.lag and one.lag.lag_s]:
            tables.append(Table.of("Lag before and after: planar distance", LAG_COLUMNS, rows))
    if request.alarms:
        events = [row_of(EVENT_COLUMNS, (one, event)) for one in series for event in one.events]
        tables.append(Table.of(f"{counted(len(events), 'alarm')}: {request.alarms.in_words}", EVENT_COLUMNS, events))
    title = f"svmdist {'validate' if validation else 'estimate'}: {request.setup.method}"
    provenance = _facts(request.setup, [one.recording for one in measured], command)
    return Report(title, series, tables, _worst(measured, series, request, jobs), provenance, notes)


def _facts(setup: Setup, recordings: Sequence[Recording], command: str) -> list[tuple[str, str]]:
    values = hashlib.sha256(setup.profile.model_dump_json(by_alias=True).encode()).hexdigest()
    found = [("command", command), ("method", f"{setup.method}, {setup.equations} equations")]
    found.append(("profile", f"{setup.profile.name}, SHA-256 of its values {values}"))
    if setup.calibration is not None:
        sources = ", ".join(f"{source.name} ({source.sha256})" for source in setup.calibration.sources)
        found.append(("calibration", f"by {setup.calibration.created_by}, fitted on {sources}"))
    found += [(str(a.path), f"SHA-256 {a.sha256()}, {a.size_bytes() / 1e6:.2f} MB") for a in recordings]
    found.append(("Python", f"{platform.python_version()} on {platform.system()} {platform.machine()}"))
    versions = {one.name: one.version for one in distributions()}
    return found + [(name, versions.get(name, "not installed")) for name in PACKAGES]


def _worst(
    measured: Sequence[Measured], series: Sequence[Series], request: Request, jobs: int | None
) -> list[tuple[str, bytes]]:
    """The worst frames of all logs with their captions, worst first; they are measured once more, to draw them."""
    chosen = {(one.series.recording, one.number): one.in_words for one in worst_frames(series, WORST_COUNT)}
    jpegs = {}
    for name, log in ((one.recording.name, one.read) for one in measured):
        numbers = {number for recording, number in chosen if recording == name}
        for drawn in drawn_frames(log, request.setup, jobs, numbers, request.alarms) if numbers else ():
            if (image := drawn.replayed.image_bgr) is not None:
                picture = draw_on(image, drawn.drawing, **THUMBNAIL)
                if (times := MAX_WIDTH_PX / picture.shape[1]) < 1.0:
                    small = cv2.resize(picture, None, fx=times, fy=times, interpolation=cv2.INTER_AREA)
                    picture = small.astype(np.uint8)
                jpeg = cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))[1]
                jpegs[name, drawn.number] = jpeg.tobytes()
    return [(f"{key[0]}, {said}", jpegs[key]) for key, said in chosen.items() if key in jpegs]


def _lost(series: Series) -> str:
    lost = Counter(status for status, seen in zip(series.status, series.measured, strict=True) if not seen)
    return ", ".join(f"{count} {status}" for status, count in lost.most_common()) or "–"


def _span(series: Series) -> str:
    known_mm = series.estimate_m[series.measured] * 1e3
    return f"{known_mm.min():.2f} to {known_mm.max():.2f}" if len(known_mm) else "–"


# fmt: off
SERIES_COLUMNS = (
    Column("recording", TEXT, "recording"),
    Column("instrument", TEXT, "instrument"),
    Column("frames", COUNT, "frames", len),
    Column("measured", SHARE, "measured [%]", lambda one: float(one.measured.mean()) if len(one) else None),
    Column("lost", TEXT, "not measured", _lost),
    Column("distance", TEXT, "distance"),
    Column("span", TEXT, "range [mm]", _span),
    Column("half_m", LENGTH, "median half interval [mm]",
           lambda one: float(np.nanmedian(one.half_m)) if np.isfinite(one.half_m).any() else None),
)
EVENT_COLUMNS = (
    Column("recording", TEXT, "recording", "0.recording"),
    Column("instrument", TEXT, "instrument", "0.instrument"),
    Column("start_number", COUNT, "first frame", "1.start_number"),
    Column("start_s", SECONDS, "from [s]", "1.start_s"),
    Column("end_s", SECONDS, "to [s]", "1.end_s"),
    Column("duration_s", SECONDS, "duration [s]", "1.duration_s"),
    Column("least_m", LENGTH, "smallest clearance [mm]", "1.least.value_m"),
    Column("least_half_m", LENGTH, "± [mm]", "1.least.half_m"),
    Column("least_number", COUNT, "in frame", "1.least_number"),
)
LAG_COLUMNS = (
    Column("recording", TEXT, "recording"),
    Column("reference", TEXT, "against"),
    Column("lag_s", Unit("s", 1e3, 1), "lag [ms]", "lag.lag_s"),
    Column("confidence", Unit("1", digits=2), "confidence", "lag.confidence"),
    Column("before_m", LENGTH, "RMSE before [mm]", "uncorrected.rmse"),
    Column("after_m", LENGTH, "RMSE after [mm]", "statistics.rmse"),
)
# fmt: on


def page(report: Report) -> str:
    """The page, made from its template."""
    # Texts of a log or a user come without control characters.
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.finalize = lambda value: printable(value) if type(value) is str else value
    environment.policies["json.dumps_kwargs"] = {}  # names stay in their order
    environment.filters |= {"base64": lambda data: base64.b64encode(data).decode("ascii"), "zip": zip}
    template = environment.from_string(files("svmdist.report").joinpath("page.html.j2").read_text("utf-8"))
    sections = _sections(report)
    every = [one for _, named in sections for one in named]
    figures = {name: {"overTime": one.over_time, "figure": plotly_figure(one).to_dict()} for name, one in every}
    plotly = get_plotlyjs().replace("</script", "<\\/script")
    return template.render(report=report, sections=sections, figures=figures, plotly=plotly)


def _sections(report: Report) -> list[tuple[str, list[tuple[str, Chart]]]]:
    """Named charts over time, log by log, then those of all logs together, under their headings."""
    sections = []
    for at, one in enumerate(report.series):
        named = [(f"distance-{at}", charts.distance_over_time(one))]
        if np.isfinite(one.error_m).any():
            named.append((f"error-{at}", charts.error_over_time(one)))
        if np.isfinite(one.consistency).any():
            named.append((f"consistency-{at}", charts.consistency_over_time(one)))
        sections.append((f"{one.recording}, {one.instrument}: {one.method}", named))
    for known in charts.with_errors(report.series):
        distance = known[0].distance
        named = [
            (f"by-distance-{distance}", charts.errors_over(known, "distance")),
            (f"by-place-{distance}", charts.error_over_image(known)),
            (f"bland-altman-{distance}", charts.agreement(known)),
            (f"distribution-{distance}", charts.distribution(known)),
        ]
        if any(np.isfinite(one.std_m).any() for one in known):
            named.append((f"calibration-{distance}", charts.calibration(known)))
        sections.append((f"Errors of the {charts.distance_name(known[0])}, all logs", named))
    return sections


def plotly_figure(chart: Chart) -> go.Figure:
    """A chart for plotly, in single precision: more than a screen shows, in half of the bytes."""
    dots = sum(curve.form == "dots" for curve in chart.curves)
    traces: list[dict[str, Any]] = []
    for curve in chart.curves:
        named = {"type": "scatter", "name": printable(curve.name), "hovertemplate": curve.hover or None}
        traces += [named | {"x": np.float32(x), "y": np.float32(y)} | look for x, y, look in _traces(curve, dots)]
    layout: dict[str, Any] = {
        "template": None,
        "xaxis": {"title": {"text": chart.x_title}},
        "yaxis": {"title": {"text": chart.y_title}, "autorange": "reversed" if chart.is_image else None},
    }
    if any(curve.form == "spans" for curve in chart.curves):
        layout["yaxis2"] = {"overlaying": "y", "range": [0, 1], "fixedrange": True, "visible": False}
    if chart.over_time:  # all plots over time begin and end alike
        seconds = np.concatenate([curve.x for curve in chart.curves if curve.form == "line"])
        begin, end = (round(float(one), 3) for one in (np.nanmin(seconds), np.nanmax(seconds)))
        if begin < end:
            layout["xaxis"] |= {"range": [begin, end], "autorange": False}
    return go.Figure(traces, layout)


def _traces(curve: Curve, sharing: int) -> Iterator[tuple[Array, Array, dict[str, Any]]]:
    """The traces of a curve: x, y, and how they look; `sharing` curves of dots share the room."""
    rgb, dash = ",".join(map(str, charts.COLOURS[curve.role])), DASHES.get(curve.role, "solid")
    colour = f"rgb({rgb})"
    area = {"mode": "lines", "line": {"width": 0}, "fillcolor": f"rgba({rgb},0.3)", "hoverinfo": "skip"}
    if curve.form == "line":
        yield from _line(curve, colour, dash)
    elif curve.form == "band":
        yield *_outlines(curve), area | {"fill": "toself"}
    elif curve.form == "spans":  # as one area from the bottom to the top: thousands of shapes take seconds
        x = np.stack([curve.x, curve.x, curve.y, curve.y], 1).ravel()
        yield x, np.tile([0, 1, 1, 0], len(curve.x)), area | {"fill": "tozeroy", "yaxis": "y2"}
    elif curve.form == "bars":
        yield curve.x, curve.y, {"type": "bar", "marker": {"color": colour}}
    else:  # dots, thinned out evenly where there are many
        count = len(curve.x)
        chosen = np.unique(np.linspace(0, max(count - 1, 0), min(count, MAX_MARKERS // sharing)).round().astype(int))
        marker: dict[str, Any] = {"color": colour, "size": 5, "opacity": 0.6}
        if curve.colour_by is not None:
            bar = {"title": {"text": curve.name}, "thickness": 12}
            marker |= {"color": curve.colour_by[chosen].astype(np.float32), "colorscale": "Cividis",
                       "showscale": True, "colorbar": bar, "opacity": 0.9}  # fmt: skip
        yield curve.x[chosen], curve.y[chosen], {"mode": "markers", "marker": marker, "showlegend": False}


def _line(curve: Curve, colour: str, dash: str) -> Iterator[tuple[Array, Array, dict[str, Any]]]:
    """A line with gaps; frames that stand alone, which a line without markers does not show, as short dashes."""
    few = len(curve.x) <= MAX_MARKERS
    numbers = {} if curve.number is None else {"customdata": np.nan_to_num(curve.number).astype(np.int32)}
    mode = "lines+markers" if few and curve.role in ("estimate", "error") else "lines"
    look = {"line": {"color": colour, "width": 1.8, "dash": dash}, "marker": {"size": 4}}
    yield curve.x, curve.y, {"mode": mode, **look, **numbers}
    alone = [begin for begin, end in runs(np.isfinite(curve.y)) if end - begin == 1]
    if alone and not few:
        reach_s, gap = frame_reach_s(curve.x, DASH_REACH), np.full(len(alone), np.nan)
        x = np.stack([curve.x[alone] - reach_s, curve.x[alone] + reach_s, gap], 1).ravel()
        y = np.stack([curve.y[alone], curve.y[alone], gap], 1).ravel()
        dashes = {"name": "single frames", "hovertemplate": None, "hoverinfo": "skip", "showlegend": False}
        yield x, y, {"mode": "lines", "line": {"color": colour, "width": 3}, **dashes}


def _outlines(curve: Curve) -> tuple[Array, Array]:
    """A band's outline for each run of frames, not across what was not measured; lone frames have a width."""
    assert curve.low is not None
    x, y = list[Array](), list[Array]()
    reach_s, gap = frame_reach_s(curve.x, DASH_REACH), np.array([np.nan])
    for begin, end in runs(np.isfinite(curve.low) & np.isfinite(curve.y)):
        times, lows, highs = (values[begin:end] for values in (curve.x, curve.low, curve.y))
        if end - begin == 1:
            times, lows, highs = times + np.array([-reach_s, reach_s]), lows.repeat(2), highs.repeat(2)
        x += [times, times[::-1], gap]
        y += [lows, highs[::-1], gap]
    return np.concatenate(x), np.concatenate(y)

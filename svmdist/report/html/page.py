"""The page of a report: summary, figures, worst frames and provenance, in one file that needs no network."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np

from svmdist.errors import OutputError
from svmdist.files import write_atomically
from svmdist.report.html.figures import (
    HtmlFigure,
    bland_altman,
    consistency_over_time,
    distance_over_time,
    error_distribution,
    error_over_distance,
    error_over_image,
    error_over_time,
    interval_calibration,
)
from svmdist.report.text import printable
from svmdist.samples import Image
from svmdist.workflows.series import Series

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
    return files("svmdist.report.html").joinpath(name).read_text("utf-8")


def require_plotly() -> None:
    """Raise OutputError where plotly is not installed, which carries the code that draws the figures."""
    try:
        import plotly  # noqa: F401
    except ImportError:
        raise OutputError(
            "a report needs the package plotly, which is not installed: pip install 'svmdist[report]'"
        ) from None


def _plotly() -> str:
    require_plotly()
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs()).replace("</script", "<\\/script")

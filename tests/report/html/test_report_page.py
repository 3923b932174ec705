"""Reports: what they say, that they stand alone, and how they look and work in a browser."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from svmdist.report import html as build
from svmdist.report import html as figures
from svmdist.report.html import Report, ReportFrame, ReportTable, page, write_report
from svmdist.report.plots import rejected_spans
from svmdist.workflows.scoring.truth import Reference
from svmdist.workflows.series import Series
from tests.cli.conftest import Cli, cli

__all__ = ["cli"]

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


def make_series(count: int, name: str = "log") -> Series:
    """A clearance that swings, with errors of a third of what is stated, and a span that is not measured."""
    rng = np.random.default_rng(1)
    seconds = np.arange(count) * 0.1
    truth_m = 0.02 + 0.01 * np.sin(seconds)
    estimate_m = truth_m + rng.normal(0.0, 0.0003, count)
    status = ["ok"] * count
    for at in range(10, 15):
        status[at], estimate_m[at] = "no_tissue", np.nan
    return Series(
        name, "PSM1", "fused", "clearance", np.arange(count), (seconds * 1e9).astype(np.int64), seconds,
        tuple(status), ("",) * count, estimate_m, np.where(np.isfinite(estimate_m), 0.001, np.nan), truth_m,
        rng.uniform(0, 480, (count, 2)), np.full(count, 0.9), Reference.GROUND_TRUTH,
    )  # fmt: skip


def make_report(*series: Series) -> Report:
    picture = np.full((48, 64, 3), 90, np.uint8)
    return Report(
        "A report of <svmdist>",
        series,
        [ReportTable("Counts", ("log", "frames"), [("</script><b>log", "100")])],
        [ReportFrame("log, frame 3: clearance error +1.00 mm", picture)],
        [("profile", "psm13")],
        alarm_below_m=0.005,
    )


def figures_of(text: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="figures-data">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    loaded: dict[str, Any] = json.loads(found[1])
    return loaded


def test_the_page_needs_no_network_and_takes_no_text_for_markup() -> None:
    text = "".join(page(make_report(make_series(100))))
    own = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)  # plotly itself names hosts of maps
    assert not re.search(r"(?:src|href)=[\"']?(?:https?:)?//", own)
    assert "<b>log" not in own
    assert "&lt;/script&gt;&lt;b&gt;log" in own
    assert "A report of &lt;svmdist&gt;" in own


def test_figures_hold_the_numbers_of_the_series() -> None:
    series = make_series(100)
    found = figures_of("".join(page(make_report(series))))
    curves = {curve["name"]: curve for curve in found["distance-0"]["data"]}
    np.testing.assert_allclose(
        [np.nan if value is None else value for value in curves["estimate"]["y"]],
        series.estimate_m * 1e3,
        atol=1e-4,
    )
    np.testing.assert_allclose(curves["truth"]["y"], series.truth_m * 1e3, atol=1e-4)
    assert curves["alarm below 5 mm"]["y"] == [5.0, 5.0]
    (span,) = found["distance-0"]["layout"]["shapes"]
    assert (span["x0"], span["x1"]) == (0.95, 1.45)
    assert set(found) == {
        "distance-0",
        "error-0",
        "consistency-0",
        "by-distance-clearance",
        "by-place-clearance",
        "bland-altman-clearance",
        "distribution-clearance",
        "calibration-clearance",
    }


def flickering(count: int, every: int) -> Series:
    """A series of which every so-many-th frame is not measured."""
    series = make_series(count)
    estimate_m = series.estimate_m.copy()
    estimate_m[::every] = np.nan
    status = ["no_tissue" if np.isnan(value) else "ok" for value in estimate_m]
    std_m = np.where(np.isfinite(estimate_m), 0.001, np.nan)
    return replace(series, estimate_m=estimate_m, std_m=std_m, status=tuple(status))


def polygons(curve: dict[str, Any]) -> list[list[tuple[float, float]]]:
    """The closed outlines of an area."""
    found: list[list[tuple[float, float]]] = [[]]
    for x, y in zip(curve["x"], curve["y"], strict=True):
        if x is None:
            found.append([])
        else:
            found[-1].append((x, y))
    return [one for one in found if one]


def test_the_interval_is_an_area_for_each_run_of_measured_frames() -> None:
    """It spans nothing that was not measured; a frame that stands alone has a width, and a dash for its value."""
    series = make_series(30)
    std_m = series.std_m.copy()
    estimate_m = series.estimate_m.copy()
    estimate_m[[20, 22]] = std_m[[20, 22]] = np.nan
    series = replace(series, estimate_m=estimate_m, std_m=std_m)
    figure = figures.error_over_time(series, "e")
    curves = {curve["name"]: curve for curve in figure.data}
    areas = polygons(curves["95 % interval"])
    assert curves["95 % interval"]["fill"] == "toself"
    spans = [(min(x for x, _ in area), max(x for x, _ in area)) for area in areas]
    np.testing.assert_allclose(spans, [(0.0, 0.9), (1.5, 1.9), (2.07, 2.13), (2.3, 2.9)], atol=1e-9)
    for area in areas:
        assert {round(abs(y), 4) for _, y in area} == {1.96}
        assert len(area) % 2 == 0
    (dash,) = polygons(curves["single frames"])
    np.testing.assert_allclose(
        dash, [(2.07, series.error_m[21] * 1e3), (2.13, series.error_m[21] * 1e3)], atol=1e-4
    )


def test_many_spans_that_were_not_measured_are_one_area() -> None:
    """A browser takes seconds for thousands of shapes; few are shapes, which show below the curves."""
    few, many = (figures.distance_over_time(flickering(count, 3), "d") for count in (300, 3000))
    assert len(few.layout["shapes"]) == len(rejected_spans(flickering(300, 3))) == 98
    assert many.layout["shapes"] == []
    area = next(curve for curve in many.data if curve["name"] == "not measured")
    expected = rejected_spans(flickering(3000, 3))
    np.testing.assert_allclose(np.reshape(area["x"], (-1, 4))[:, 1:3], expected)
    np.testing.assert_allclose(np.reshape(area["y"], (-1, 4)), np.tile([0, 1, 1, 0], (len(expected), 1)))
    assert "998 spans were not measured" in many.text
    assert many.layout["yaxis2"]["range"] == [0, 1]


@pytest.mark.parametrize(("every", "bytes_a_frame"), [(None, 120), (3, 160), (2, 260)])
def test_a_frame_adds_a_bounded_number_of_bytes(every: int | None, bytes_a_frame: int) -> None:
    """10,000 frames are 1.2 MB beside plotly's 4.8, or 2.6 MB where every other frame is not measured."""
    sizes = [
        len("".join(page(make_report(make_series(count) if every is None else flickering(count, every)))))
        for count in (4000, 8000)
    ]
    assert (sizes[1] - sizes[0]) / 4000 < bytes_a_frame
    assert sizes[0] < 4000 * bytes_a_frame + 5.6e6


def test_the_texts_say_what_the_figures_show() -> None:
    series = make_series(1000)
    error_mm = series.error_m[np.isfinite(series.error_m)] * 1e3
    assert f"RMSE {np.sqrt(np.mean(error_mm**2)):.2f} mm" in figures.error_over_time(series, "x").text
    agreement = figures.bland_altman([series], "x")
    assert f"Bias {error_mm.mean():+.2f} mm" in agreement.text
    honest = replace(series, std_m=np.full(1000, error_mm.std() * 1e-3))
    held = figures.interval_calibration([honest], "x").data[1]["y"]
    np.testing.assert_allclose(held, [100 * level for level in figures.LEVELS], atol=4.0)
    assert "995 of 1000 frames" in figures.distance_over_time(series, "x").text


def test_a_log_without_truth_has_no_figures_of_errors() -> None:
    blind = replace(make_series(50), truth_m=np.full(50, np.nan), reference=None)
    assert set(figures_of("".join(page(make_report(blind))))) == {"distance-0", "consistency-0"}


def test_validate_writes_a_report_with_its_figures_and_worst_frames(
    golden: Path, cli: Cli, tmp_path: Path
) -> None:
    output = tmp_path / "report.html"
    log = golden / "occlusion.mcap"
    outcome = cli(
        "validate", log, "--truth", "ground_truth", "--lag", "auto", "-f", "json", "--report", output
    )
    assert outcome.code == 0
    text = output.read_text()
    score = json.loads(outcome.out)["recordings"][0]
    assert f"RMSE {score['rmse_m'] * 1e3:.2f} mm" in text
    assert text.count("data:image/jpeg;base64,") == build.WORST_COUNT
    assert "no_instrument" in text
    assert "SHA-256" in text
    assert "Lag before and after" in text
    curve = next(one for one in figures_of(text)["distance-0"]["data"] if one["name"] == "estimate")
    assert sum(value is not None for value in curve["y"]) == score["frame_count"] - sum(
        score["rejected"].values()
    )


def test_estimate_writes_the_report_beside_the_rows_or_in_their_place(
    golden: Path, cli: Cli, tmp_path: Path
) -> None:
    log = golden / "sweep.mcap"
    beside = cli("estimate", log, "-f", "csv", "--report", tmp_path / "a.html")
    assert beside.out.startswith("recording,")
    alone = cli("estimate", log, "-o", tmp_path / "b.html")
    assert (alone.code, alone.out) == (0, "")
    both = [figures_of((tmp_path / name).read_text()) for name in ("a.html", "b.html")]
    assert both[0] == both[1]


def test_a_report_of_another_ending_is_refused_before_the_work(golden: Path, cli: Cli) -> None:
    refused = cli("validate", golden / "sweep.mcap", "--report", "report.pdf")
    assert refused.code == 2
    assert ".html" in refused.err


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Debian's Chromium, without a network."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright has no wheel for this platform"
    )
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine: apt-get install chromium")
    with playwright.sync_playwright() as running:
        chromium = running.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        yield chromium
        chromium.close()


def opened(browser: Any, path: Path, **options: Any) -> tuple[Any, list[str]]:
    """A page of a report, and what its console says."""
    shown = browser.new_context(offline=True, **options).new_page()
    problems: list[str] = []
    shown.on(
        "console",
        lambda message: problems.append(message.text) if message.type in ("error", "warning") else None,
    )
    shown.on("pageerror", lambda error: problems.append(str(error)))
    shown.goto(path.as_uri())
    shown.locator("#distance-0").scroll_into_view_if_needed()
    shown.wait_for_selector("#distance-0 .main-svg")
    return shown, problems


def test_a_browser_shows_the_figures_hovers_and_zooms_them_together(browser: Any, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_report(make_report(make_series(200)), path)
    shown, problems = opened(browser, path, viewport={"width": 1200, "height": 900})
    shown.evaluate("svmdistReport.drawAll()")
    assert shown.locator(".plot .main-svg").count() >= 8
    assert shown.evaluate("document.querySelector('.frames img').naturalWidth") == 64

    box = shown.locator("#distance-0 .nsewdrag").bounding_box()
    shown.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    shown.wait_for_selector("#distance-0 .hovertext")
    assert "mm" in shown.locator("#distance-0 .hovertext").first.text_content()

    shown.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 0.5 * box["height"])
    shown.mouse.down()
    shown.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"], steps=5)
    shown.mouse.up()
    shown.wait_for_function("document.getElementById('error-0').layout.xaxis.range[0] > 1")
    ranges = [
        shown.evaluate(f"document.getElementById('{name}').layout.xaxis.range")
        for name in ("distance-0", "error-0", "consistency-0")
    ]
    assert ranges[0] == ranges[1] == ranges[2]
    np.testing.assert_allclose(ranges[0], [0.25 * 19.9, 0.5 * 19.9], atol=0.5)
    assert problems == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_follows_the_colour_scheme_and_fits_a_phone(
    browser: Any, tmp_path: Path, scheme: str
) -> None:
    path = tmp_path / "report.html"
    write_report(make_report(make_series(60)), path)
    shown, problems = opened(browser, path, viewport={"width": 390, "height": 800}, color_scheme=scheme)
    assert shown.evaluate("document.documentElement.scrollWidth") == 390
    ground = shown.evaluate("getComputedStyle(document.body).backgroundColor")
    brightness = sum(map(int, re.findall(r"\d+", ground)[:3])) / 3
    assert brightness > 200 if scheme == "light" else brightness < 60
    text = shown.evaluate("getComputedStyle(document.querySelector('#distance-0 .xtick text')).fill")
    letters = sum(map(int, re.findall(r"\d+", text)[:3])) / 3
    assert abs(letters - brightness) > 120  # the plot's letters change with the page
    unnamed = shown.evaluate(
        "[...document.querySelectorAll('[role=img]')].filter(one => !one.getAttribute('aria-label')).length"
    )
    assert unnamed == 0
    assert problems == []


@pytest.mark.parametrize("series", [make_series(10_000), flickering(10_000, 3)], ids=["whole", "flickering"])
def test_ten_thousand_frames_are_less_than_ten_megabytes_and_open_in_three_seconds(
    browser: Any, tmp_path: Path, series: Series
) -> None:
    path = tmp_path / "report.html"
    write_report(make_report(series), path)
    assert path.stat().st_size < 10e6
    shown, problems = opened(browser, path)
    measuring = shown.context.new_cdp_session(shown)
    measuring.send("Performance.enable")
    values = {one["name"]: one["value"] for one in measuring.send("Performance.getMetrics")["metrics"]}
    # The page's own processor time: a clock on the wall would measure what else the machine does.
    assert 0.0 < values["ProcessTime"] < 3.0
    shown.evaluate("svmdistReport.drawAll()")
    assert shown.locator(".plot .main-svg").count() >= 8
    assert problems == []

"""Reports: what they say, that they stand alone, and how they look and work in a browser."""

import base64
import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from svmdist.report import charts
from svmdist.report.html import WORST_COUNT, Report, page, plotly_figure
from svmdist.report.tables import Table
from svmdist.results import AlarmEvent, Distance
from svmdist.workflows.estimate import Series

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = ("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync")  # fmt: skip


def make_series(count: int, name: str = "log", every: int | None = None) -> Series:
    """A clearance that swings, with errors of a third of what is stated, and frames that are not measured.

    Those are a span of five, or every so-many-th frame.
    """
    rng = np.random.default_rng(1)
    seconds = np.arange(count) * 0.1
    truth_m = 0.02 + 0.01 * np.sin(seconds)
    estimate_m = truth_m + rng.normal(0.0, 0.0003, count)
    estimate_m[slice(None, None, every) if every else slice(10, 15)] = np.nan
    measured = np.isfinite(estimate_m)
    return Series(
        name, "PSM1", "fused", "clearance", np.arange(count), seconds,
        tuple("ok" if one else "no_tissue" for one in measured), ("",) * count, estimate_m,
        np.where(measured, 0.001, np.nan), truth_m, rng.uniform(0, 480, (count, 2)), np.full(count, 0.9),
        (AlarmEvent("PSM1", 20, 2.0, 2.5, Distance(0.004), 22),), 0.005,
    )  # fmt: skip


def make_report(*series: Series) -> Report:
    """A report whose texts try to end the element that they stand in."""
    table = Table("Counts", ("log", "frames"), (True, False), (("</script><b>log", "100"),))
    frames = [("log, frame 3: clearance error +1.00 mm", b"\xff\xd8")]
    return Report("A report of <svmdist>\x1b", series, [table], frames, [("profile", "psm13")])


def figures_of(text: str) -> dict[str, Any]:
    """The plots in a page, by name."""
    found = re.search(r'<script type="application/json" id="figures-data">(.*?)</script>', text, re.DOTALL)
    loaded: dict[str, Any] = json.loads(found[1])
    return {name: one["figure"] for name, one in loaded.items()}


def curves_of(figure: Any) -> dict[str, Any]:
    """The curves of a plot by name, with their numbers as arrays."""
    data = figure["data"] if isinstance(figure, dict) else json.loads(figure.to_json())["data"]
    return {curve["name"]: {key: _array(value) for key, value in curve.items()} for curve in data}


def _array(value: Any) -> Any:
    if isinstance(value, dict) and "bdata" in value:
        return np.frombuffer(base64.b64decode(value["bdata"]), value["dtype"])
    return value


def test_the_page_needs_no_network_and_takes_no_text_for_markup():
    text = page(make_report(make_series(100)))
    own = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)  # plotly itself names hosts of maps
    assert not re.search(r"(?:src|href)=[\"']?(?:https?:)?//", own)
    assert "<b>log" not in own
    assert "&lt;/script&gt;&lt;b&gt;log" in own
    assert "A report of &lt;svmdist&gt;\N{REPLACEMENT CHARACTER}" in own


def test_plots_hold_the_numbers_of_the_series():
    series = make_series(100)
    found = figures_of(page(make_report(series)))
    assert list(found) == [
        *("distance-0", "error-0", "consistency-0", "by-distance-clearance", "by-place-clearance"),
        *("bland-altman-clearance", "distribution-clearance", "calibration-clearance"),
    ]
    curves = curves_of(found["distance-0"])
    np.testing.assert_allclose(curves["estimate"]["y"], series.estimate_m * 1e3, atol=1e-4)
    np.testing.assert_array_equal(curves["estimate"]["customdata"], series.number)
    np.testing.assert_allclose(curves["truth"]["y"], series.truth_m * 1e3, atol=1e-4)
    np.testing.assert_array_equal(curves["alarm below 5 mm"]["y"], [5.0, 5.0])
    np.testing.assert_allclose(curves["not measured"]["x"], [0.95, 0.95, 1.45, 1.45])
    np.testing.assert_allclose(curves["alarm"]["x"], [1.95, 1.95, 2.55, 2.55])
    blind = replace(series, truth_m=np.full(100, np.nan))
    assert list(figures_of(page(make_report(blind)))) == ["distance-0", "consistency-0"]


def polygons(curve: dict[str, Any]) -> list[list[tuple[float, float]]]:
    """The closed outlines of an area."""
    found: list[list[tuple[float, float]]] = [[]]
    for x, y in zip(curve["x"], curve["y"], strict=True):
        if np.isnan(x):
            found.append([])
        else:
            found[-1].append((float(x), float(y)))
    return [one for one in found if one]


def test_the_interval_is_an_area_for_each_run_of_measured_frames():
    """It spans nothing that was not measured; a frame that stands alone has a width, and a dash for its value."""
    series = make_series(2100)
    estimate_m, std_m = series.estimate_m.copy(), series.std_m.copy()
    estimate_m[[20, 22]] = std_m[[20, 22]] = np.nan
    series = replace(series, estimate_m=estimate_m, std_m=std_m)
    curves = curves_of(plotly_figure(charts.error_over_time(series)))
    areas = polygons(curves["95 % interval"])
    spans = [(min(x for x, _ in area), max(x for x, _ in area)) for area in areas]
    np.testing.assert_allclose(spans, [(0.0, 0.9), (1.5, 1.9), (2.07, 2.13), (2.3, 209.9)], rtol=1e-6)
    assert {round(abs(y), 4) for area in areas for _, y in area} == {1.96}
    error_mm = series.error_m[21] * 1e3
    (dash,) = polygons(curves["single frames"])
    np.testing.assert_allclose(dash, [(2.07, error_mm), (2.13, error_mm)], atol=1e-4)
    flickering = make_series(3000, every=3)
    lost = curves_of(plotly_figure(charts.distance_over_time(flickering)))["not measured"]
    spans_s = flickering.seconds[::3, None] + np.array([-0.05, 0.05])
    np.testing.assert_allclose(lost["x"].reshape(-1, 4)[:, 1:3], spans_s, rtol=1e-6)


@pytest.mark.parametrize(("every", "bytes_a_frame"), [(None, 120), (3, 160), (2, 260)])
def test_a_frame_adds_a_bounded_number_of_bytes(every, bytes_a_frame):
    """10,000 frames are 1.2 MB beside plotly's 4.8, or 2.6 MB where every other frame is not measured."""
    sizes = [len(page(make_report(make_series(count, every=every)))) for count in (4000, 8000)]
    assert (sizes[1] - sizes[0]) / 4000 < bytes_a_frame
    assert sizes[0] < 4000 * bytes_a_frame + 5.6e6


def test_the_texts_say_what_the_plots_show():
    series = make_series(1000)
    error_mm = series.error_m[np.isfinite(series.error_m)] * 1e3
    assert f"RMSE {np.sqrt(np.mean(error_mm**2)):.2f} mm" in charts.error_over_time(series).text
    assert f"Bias {error_mm.mean():+.2f} mm" in charts.agreement([series]).text
    assert "995 of 1000 frames" in charts.distance_over_time(series).text
    as_stated = replace(series, std_m=np.full(1000, error_mm.std() * 1e-3))
    held = charts.calibration([as_stated]).curves[1].y
    np.testing.assert_allclose(held, [100 * level for level in charts.LEVELS], atol=4.0)


def test_validate_writes_a_report_with_its_plots_and_worst_frames(golden, cli, tmp_path):
    output, log = tmp_path / "report.html", golden / "occlusion.mcap"
    options = ["--method", "overlay", "--truth", "ground_truth", "--lag", "auto", "-f", "json", "--report"]
    outcome = cli("validate", log, *options, output)
    text = output.read_text()
    score = outcome.json["recordings"][0]
    assert f"RMSE {score['rmse_m'] * 1e3:.2f} mm" in text
    assert text.count("data:image/jpeg;base64,") == WORST_COUNT
    assert all(part in text for part in ("no_instrument", "SHA-256", "Lag before and after"))
    estimate = curves_of(figures_of(text)["distance-0"])["estimate"]["y"]
    assert np.isfinite(estimate).sum() == score["frame_count"] - sum(score["rejected"].values())


def test_estimate_writes_the_report_beside_the_rows_or_in_their_place(golden, cli, tmp_path):
    command = ("estimate", golden / "sweep.mcap", "--every", 8)
    beside = cli(*command, "-f", "csv", "--report", tmp_path / "a.html")
    assert beside.out.startswith("recording,")
    assert cli(*command, "-o", tmp_path / "b.html").out == ""
    first, second = (figures_of((tmp_path / name).read_text()) for name in ("a.html", "b.html"))
    assert first == second


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Debian's Chromium, without a network."""
    playwright = pytest.importorskip("playwright.sync_api", reason="no wheel for this platform")
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine: apt-get install chromium")
    with playwright.sync_playwright() as running:
        chromium = running.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        yield chromium
        chromium.close()


@pytest.mark.slow
@pytest.mark.parametrize(("every", "scheme"), [(None, "light"), (3, "dark")])
def test_ten_thousand_frames_are_shown_in_a_browser(browser, tmp_path, every, scheme):
    """Below 10 MB and 20,000 nodes, on a phone too; plots hover, zoom together, and follow the colours."""
    path = tmp_path / "report.html"
    path.write_text(page(make_report(make_series(10_000, every=every))), "utf-8")
    assert path.stat().st_size < 10e6
    phone = {"width": 390, "height": 800}
    shown = browser.new_context(offline=True, color_scheme=scheme, viewport=phone).new_page()
    said: list[Any] = []
    problems: list[str] = []
    shown.on("console", lambda message: said.append(message))  # noqa: PLW0108  (a builtin is refused)
    shown.on("pageerror", lambda error: problems.append(str(error)))
    shown.goto(path.as_uri())
    shown.locator("#distance-0").scroll_into_view_if_needed()
    shown.wait_for_selector("#distance-0 .main-svg")
    measuring = shown.context.new_cdp_session(shown)
    measuring.send("Performance.enable")
    values = {one["name"]: one["value"] for one in measuring.send("Performance.getMetrics")["metrics"]}
    # What it draws, not how long that takes: seconds are the machine's (`benchmarks.speed` has their ratio).
    assert 0 < values["Nodes"] < 20_000
    assert values["JSHeapUsedSize"] < 100 << 20
    assert shown.evaluate("document.documentElement.scrollWidth") == 390
    ground, letters = (
        sum(map(int, re.findall(r"\d+", shown.evaluate(found))[:3])) / 3
        for found in (
            "getComputedStyle(document.body).backgroundColor",
            "getComputedStyle(document.querySelector('#distance-0 .xtick text')).fill",
        )
    )
    assert ground > 200 if scheme == "light" else ground < 60
    assert abs(letters - ground) > 120
    shown.set_viewport_size({"width": 1200, "height": 900})
    shown.evaluate("svmdistReport.drawAll()")
    assert shown.locator(".plot .main-svg").count() >= 8
    shown.locator("#distance-0").scroll_into_view_if_needed()
    shown.wait_for_timeout(500)  # plots are redrawn after the window has changed
    # The tool bar covers neither plot nor legend, and has no button that sends the data away.
    boxes = [shown.locator(f"#distance-0 {name}").bounding_box() for name in (".modebar", ".nsewdrag", ".legend")]
    ends = [(one["y"], one["y"] + one["height"]) for one in boxes]
    assert ends[0][1] <= ends[1][0] < ends[1][1] <= ends[2][0]
    assert shown.locator("[data-title^=Share]").count() == 0
    box = boxes[1]
    shown.mouse.move(box["x"] + 0.505 * box["width"], box["y"] + 0.5 * box["height"])
    shown.wait_for_selector("#distance-0 .hovertext")
    shown.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 0.5 * box["height"])
    shown.mouse.down()
    shown.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"], steps=5)
    shown.mouse.up()
    shown.wait_for_function("document.getElementById('error-0').layout.xaxis.range[0] > 1")
    names = ("distance-0", "error-0", "consistency-0")
    ranges = [shown.evaluate(f"document.getElementById('{name}').layout.xaxis.range") for name in names]
    assert ranges[0] == ranges[1] == ranges[2]
    np.testing.assert_allclose(ranges[0], [0.25 * 999.9, 0.5 * 999.9], atol=20.0)
    assert shown.locator("[role=img]:not([aria-label])").count() == 0
    assert problems == []
    assert [line.text for line in said if line.type in ("error", "warning")] == []

"""Plots: what is drawn, in which format, told apart without colour, and names that are text."""

import re
from dataclasses import replace

import cv2
import matplotlib as mpl
import matplotlib.colors
import numpy as np
import pytest
from matplotlib.axes import Axes

from svmdist.errors import OutputError
from svmdist.estimation.alarms import AlarmRules
from svmdist.report.charts import pooled
from svmdist.report.plots import COLUMN_IN, PAGE_IN, draw, draw_compare, draw_series, save_figure
from svmdist.workflows.compare import ALL, Group, MethodScore
from svmdist.workflows.scoring.references import Reference
from svmdist.workflows.scoring.scores import Figures, Pairs
from svmdist.workflows.validate import Validation
from tests.report.test_html import make_series
from tests.report.test_scores import score, validation


def drawn(axes: Axes) -> dict[str, np.ndarray]:
    """The lines of a panel by their labels."""
    return {str(line.get_label()): np.asarray(line.get_ydata(), float) for line in axes.get_lines()}


@pytest.mark.parametrize(
    ("suffix", "magic"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("PNG", b"\x89PNG"), ("pdf", b"%PDF")]
)
def test_the_plot_is_written_in_the_format_of_its_suffix(tmp_path, suffix, magic):
    """Two runs on the same data write the same bytes, and no global setting is left."""
    salt = mpl.rcParams["svg.hashsalt"]
    paths = [tmp_path / f"{name}.{suffix}" for name in ("first", "second")]
    for path in paths:
        save_figure(path, draw, validation("sweep"))
    first, second = (path.read_bytes() for path in paths)
    assert first.startswith(magic)
    assert first == second or suffix == "pdf"  # which has a date
    assert mpl.rcParams["svg.hashsalt"] == salt


@pytest.mark.parametrize("name", ["[red]x", "a$b$c", "$\\frac{", "a\x1bb", "a_b^100%", "測定"])
def test_names_in_titles_are_text(tmp_path, name):
    """No name starts a formula, breaks the drawing or carries a control character into the file."""
    path = tmp_path / "plot.svg"
    with mpl.rc_context({"svg.fonttype": "none"}):
        save_figure(path, draw, validation(name))
    text = path.read_text("utf-8")
    assert "\x1b" not in text
    title = next(line for line in text.splitlines() if ": overlay" in line and "<text" in line)
    assert name.replace("\x1b", "\N{REPLACEMENT CHARACTER}") in title


def test_each_recording_has_two_panels_against_one_reference(tmp_path):
    """Curve above error, of the strongest reference; few frames, or none, are drawn without a warning."""
    figure = draw(validation("a", "b", "c"))
    titles = [axes.get_title(loc="left").partition("\n")[0] for axes in figure.axes[::2]]
    assert titles == ["a: overlay", "b: overlay", "c: overlay"]
    assert figure.get_figwidth() == PAGE_IN
    styles = {(line.get_linestyle(), line.get_marker()) for line in figure.axes[0].get_lines()}
    assert len(styles) == 2  # told apart without colour
    both = tuple(score(reference=reference) for reference in (Reference.KINEMATICS, Reference.GROUND_TRUTH))
    with mpl.rc_context({"svg.fonttype": "none"}):
        save_figure(tmp_path / "plot.svg", draw, Validation(both, both, ()))
    text = (tmp_path / "plot.svg").read_text("utf-8")
    assert (text.count("simulator"), text.count("kinematics")) == (1, 0)
    for count in (0, 1, 2):
        save_figure(tmp_path / f"{count}.png", draw, validation("sweep", count=count))


def test_curves_are_broken_where_frames_are_missing():
    """Ten lost frames leave a gap: no line spans what was not measured, and error = estimate - truth."""
    upper, lower = draw(Validation((score(),), (), ())).axes
    truth, estimate = drawn(upper).values()
    assert int(np.isnan(truth).sum()) == int(np.isnan(estimate).sum()) == 1
    np.testing.assert_allclose(drawn(lower)["error"], estimate - truth, atol=1e-12)
    assert np.nanmax(truth) == pytest.approx(40.0, abs=0.1)  # 0.04 m in mm


def test_of_a_method_in_3d_the_clearance_is_drawn_with_its_interval():
    """Clearance before spatial distance before the planar one; the band is 1.96 deviations wide on either side."""
    planar = score()
    spatial = replace(planar.pairs, std_m=np.full(len(planar.pairs), 1e-3), truth_m=planar.pairs.truth_m - 0.02)
    clearance = replace(spatial, estimate_m=spatial.estimate_m - 0.02)
    for made, name, thresholds in (
        (replace(planar, spatial=spatial, clearance=clearance), "clearance", [5.0]),
        (replace(planar, spatial=spatial), "spatial distance", []),
    ):
        upper, lower = draw(Validation((made,), (), (), AlarmRules(0.005, 0.05))).axes
        assert upper.get_ylabel() == f"{name} [mm]"
        assert f", {name}\nRMSE" in upper.get_title(loc="left")
        (band,) = lower.collections
        assert np.nanmax(band.get_paths()[0].vertices[:, 1]) == pytest.approx(1.96, abs=1e-3)
        dotted = [line for line in upper.get_lines() if line.get_linestyle() == ":"]
        assert [line.get_ydata()[0] for line in dotted] == thresholds


def test_panels_of_one_log_have_the_same_axis_of_time():
    """Also where an instrument was measured in a part of the log only; a frame that stands alone has an interval."""
    series, alone = make_series(100), np.where(np.arange(100) == 70, 0.02, np.nan)
    late = replace(series, instrument="PSM2", estimate_m=alone, truth_m=alone)
    first, second, other = draw_series([series, late, make_series(40, "other")], "time").axes
    assert first.get_xlim() == second.get_xlim() != other.get_xlim()
    (band,) = (one for one in second.collections if one.get_label() == "95 % interval")
    assert band.get_linewidth() > 0.0
    made = score("a", count=60), replace(score("a PSM2", count=20), instrument="PSM2"), score("b", count=20)
    figure = draw(Validation(made, (), ()))
    first, below_first, second, _, other, _ = figure.axes
    assert first.get_xlim() == second.get_xlim() != other.get_xlim()
    figure.draw_without_rendering()
    assert other.get_tightbbox().ymax <= below_first.get_tightbbox().ymin  # the next row of panels


def test_agreement_calibration_and_residuals():
    """Bias and limits; shares of truths inside; a marker for each log. Without a truth there is nothing to draw."""
    series = make_series(300)
    _, error_mm, std_mm = pooled([series])
    figure = draw_series([series], "bland-altman")
    levels = [float(line.get_ydata()[0]) for line in figure.axes[0].get_lines()]
    bias, deviation = error_mm.mean(), error_mm.std(ddof=1)
    np.testing.assert_allclose(levels, [bias, bias - 1.96 * deviation, bias + 1.96 * deviation])
    assert figure.get_figwidth() == COLUMN_IN
    held = drawn(draw_series([series], "calibration").axes[0])["truths inside"]
    assert held[0] == pytest.approx(100 * np.mean(np.abs(error_mm) <= 0.67449 * std_mm), abs=1e-6)
    figure = draw_series([series, make_series(40, "other")], "residuals")
    over_time, _ = figure.axes
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["log PSM1", "other PSM1"]
    assert "fused" in over_time.get_title(loc="left")
    blind = replace(series, truth_m=np.full(300, np.nan))
    with pytest.raises(OutputError, match="no measured frame has a truth"):
        draw_series([blind], "residuals")


def test_where_nothing_was_measured_the_plot_says_why():
    """In place of a scale that stands for nothing."""
    none = make_series(300)
    nothing = np.full(300, np.nan)
    none = replace(none, estimate_m=nothing, truth_m=nothing, status=("no_tissue",) * 300, alarm_below_m=None)
    empty = replace(score(count=0), rejected={"no_tissue": 300}, frame_count=300, measured_count=0)
    for figure in (draw_series([none], "time"), draw(Validation((empty,), (), ()))):
        axes = figure.axes[0]
        assert [text.get_text() for text in axes.texts] == ["nothing measured\n300 no_tissue"]
        assert axes.get_ylabel() == "distance [mm]"
        assert all(len(panel.get_yticks()) == 0 for panel in figure.axes)


def figures(error_mm: float, measured: int = 20, std_mm: float = np.nan, *, in_3d: bool = False) -> Figures:
    """The figures of a method with a constant error."""
    truth_m = np.linspace(0.01, 0.05, 20)
    one = Pairs(np.arange(20), truth_m + error_mm * 1e-3, truth_m, np.full(20, std_mm * 1e-3))
    return Figures(20, measured, 0.1, one, one if in_3d else None, one if in_3d else None)


def dots(axes: Axes) -> dict[tuple[str, str], float]:
    """The marker of each method and group."""
    return {
        (["overlay", "fused"][int(line.get_ydata()[0])], str(line.get_label())): float(line.get_xdata()[0])
        for line in axes.get_lines()
        if line.get_marker() not in ("None", "")
    }


def test_methods_stand_side_by_side_with_their_figures():
    """A grey marker for each group; a planar method has no clearance."""
    groups = [Group("sweep"), Group("contact"), Group(ALL, ALL)]
    scores = [MethodScore(group, "overlay", figures(0.5 + at, 15)) for at, group in enumerate(groups)]
    scores += [MethodScore(group, "fused", figures(0.25, 20, 0.2, in_3d=True)) for group in groups]
    figure = draw_compare(scores)
    above, below = figure.axes[:4], figure.axes[4:]
    assert figure.get_suptitle() == "overlay, fused: 20 frames"
    shares = {"overlay": 75.0, "fused": 100.0}
    measured = {(method, str(group)): share for method, share in shares.items() for group in groups}
    assert dots(above[0]) == pytest.approx(measured)
    assert dots(above[1])["overlay", "contact"] == pytest.approx(1.5)
    assert {method for method, _ in dots(above[2])} == {"fused"}
    assert set(dots(below[3]).values()) == {100.0}  # 0.25 mm inside of 1.96 times 0.2 mm
    assert dots(below[0])["fused", "all"] == 5.0
    looks = {line.get_label(): (line.get_marker(), line.get_color()) for line in above[0].get_lines()}
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend == list(looks) == ["sweep", "contact", "all"]
    assert len(set(looks.values())) == 3
    assert all(len(set(matplotlib.colors.to_rgb(colour))) == 1 for _, colour in looks.values())
    assert draw_compare(scores[3:]).axes[1].get_xscale() == "linear"
    for far_mm, ticks in ((90.0, ["1", "10", "100"]), (20.0, ["0.2", "0.5", "1", "2", "5", "10", "20"])):
        axes = draw_compare([*scores, MethodScore(Group("sweep"), "z", figures(far_mm))]).axes[1]
        assert axes.get_xscale() == "log"
        assert set(ticks) <= {axes.xaxis.get_major_formatter()(at) for at in axes.get_xticks()}


def test_commands_draw_what_they_print(cli, tmp_path, golden):
    """The SVG's methods, and the PNG's size, of a real log; another ending is refused before the work."""
    log = golden / "sweep.mcap"
    outcome = cli(
        "compare", log, "--method", "overlay", "--method", "kinematic", "--every", 20, "-f", "json", "--jobs", 1,
        "--save-plot", tmp_path / "compare.svg",
    )  # fmt: skip
    assert [row["method"] for row in outcome.json] == ["overlay", "kinematic"]
    assert re.search(r"<!-- overlay, kinematic: 4 frames -->", (tmp_path / "compare.svg").read_text("utf-8"))
    cli("estimate", log, "--every", 8, "-f", "csv", "--save-plot", tmp_path / "e.png")
    cli("validate", log, "--every", 8, "--plot", "residuals", "--save-plot", tmp_path / "v.png")
    for name in ("e.png", "v.png"):
        picture = cv2.imread(str(tmp_path / name))
        assert picture.shape[1] == pytest.approx(PAGE_IN * 300, abs=2)

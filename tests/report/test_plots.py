"""Plots: their formats, what is drawn, and names that are text."""

from __future__ import annotations

from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest

from svmdist.errors import OutputError
from svmdist.estimation.alarms import AlarmRules
from svmdist.report.plots import PAGE_IN, draw, save_plot
from svmdist.workflows.scoring.score import score_pairs
from svmdist.workflows.scoring.truth import Reference
from svmdist.workflows.validate import Validation
from tests.report.test_scores import score, validation


@pytest.mark.parametrize(
    ("suffix", "magic"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("PNG", b"\x89PNG"), ("pdf", b"%PDF")]
)
def test_the_plot_is_written_in_the_format_of_its_suffix(tmp_path, suffix, magic):
    """PNG, SVG and PDF come out as such, whatever the case of the suffix."""
    path = tmp_path / f"plot.{suffix}"
    save_plot(validation("sweep.mcap"), path)
    assert path.read_bytes().startswith(magic)


def test_an_svg_is_identical_on_a_rerun(tmp_path):
    """Two runs on the same data write the same bytes: no date, no random ids, and no global setting is left."""
    salt = mpl.rcParams["svg.hashsalt"]
    for name in ("first.svg", "second.svg"):
        save_plot(validation("sweep.mcap"), tmp_path / name)
    assert (tmp_path / "first.svg").read_bytes() == (tmp_path / "second.svg").read_bytes()
    assert mpl.rcParams["svg.hashsalt"] == salt


@pytest.mark.parametrize("name", ["plot.xyz", "plot", "plot.mcap", "plot.pgf", "plot.jpg"])
def test_an_unknown_suffix_lists_the_choices(tmp_path, name):
    """A suffix that cannot be drawn is an OutputError that names those that can, and writes nothing."""
    with pytest.raises(OutputError, match=r"cannot draw .*the choices are png, svg, pdf$"):
        save_plot(validation("sweep.mcap"), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_does_not_exist_is_an_output_error(tmp_path):
    """Where the plot cannot be written, the message names path and reason."""
    with pytest.raises(OutputError, match=r"plot\.png: cannot write: No such file"):
        save_plot(validation("sweep.mcap"), tmp_path / "no folder" / "plot.png")


@pytest.mark.parametrize(
    "name",
    ["[red]x", "a$b$c", "$\\frac{", "a\x1bb", "a_b^100%", "測定.mcap"],
    ids=["markup", "formula", "broken formula", "ESC", "sub and superscript", "Japanese"],
)
def test_names_in_plot_titles_are_text(tmp_path, name):
    """No name starts a formula, breaks the drawing or carries a control character into the file."""
    path = tmp_path / "plot.svg"
    with mpl.rc_context({"svg.fonttype": "none"}):
        save_plot(validation(name), path)
    text = path.read_text("utf-8")
    assert "\x1b" not in text
    title = next(line for line in text.splitlines() if ": overlay" in line and "<text" in line)
    assert name.replace("\x1b", "\N{REPLACEMENT CHARACTER}") in title


def test_several_recordings_make_several_panels():
    """Each recording has its own panel of two axes, curve above residual, with its own title."""
    figure = draw(validation("a.mcap", "b.mcap", "c.mcap").scores)
    assert len(figure.axes) == 6
    titles = [axes.get_title(loc="left") for axes in figure.axes[::2]]
    names = [title.partition("\n")[0] for title in titles]
    assert names == ["a.mcap: overlay", "b.mcap: overlay", "c.mcap: overlay"]
    assert figure.get_figwidth() == PAGE_IN
    styles = {(line.get_linestyle(), line.get_marker()) for line in figure.axes[0].get_lines()}
    assert len(styles) == 2  # told apart without colour


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_frames_still_make_a_plot(tmp_path, count):
    """A recording in which nothing, one or two frames were measured is drawn without a warning."""
    save_plot(validation("sweep.mcap", count=count), tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 1000


def test_curves_are_broken_where_frames_are_missing():
    """Ten lost frames leave a gap: no line spans what was not measured, and residual = estimate - truth."""
    figure = draw([score()])
    upper, lower = figure.axes
    truth, estimate = upper.get_lines()
    assert int(np.isnan(truth.get_ydata()).sum()) == int(np.isnan(estimate.get_ydata()).sum()) == 1
    residual = lower.get_lines()[1].get_ydata()
    np.testing.assert_allclose(residual, estimate.get_ydata() - truth.get_ydata(), atol=1e-12)
    assert np.nanmax(truth.get_ydata()) == pytest.approx(40.0, abs=0.1)  # 0.04 m in mm


def test_of_a_method_in_3d_the_clearance_is_drawn_with_its_interval():
    """Clearance before spatial distance before the planar one; the band is 1.96 deviations wide on either side."""
    planar = score()
    stated = replace(
        planar.pairs, std_m=np.full(len(planar.pairs), 1e-3), truth_m=planar.pairs.truth_m - 0.02
    )
    shifted = replace(stated, estimate_m=stated.estimate_m - 0.02)
    clearance, spatial = score_pairs(shifted), score_pairs(stated)
    rules = AlarmRules(0.005, 0.05)
    for made, name in (
        (replace(planar, spatial=spatial, clearance=clearance), "clearance"),
        (replace(planar, spatial=spatial), "spatial distance"),
    ):
        upper, lower = draw([made], rules).axes
        assert upper.get_ylabel() == f"{name} [mm]"
        assert f", {name}\nRMSE" in upper.get_title(loc="left")
        (band,) = lower.collections
        assert np.nanmax(band.get_paths()[0].vertices[:, 1]) == pytest.approx(1.96, abs=1e-3)
        thresholds = [line for line in upper.get_lines() if line.get_linestyle() == ":"]
        assert [line.get_ydata()[0] for line in thresholds] == ([5.0] if name == "clearance" else [])
    assert "100 % in the 95 % interval" not in draw([planar]).axes[0].get_title(loc="left")


def test_only_one_reference_is_drawn(tmp_path):
    """Of two references the strongest is drawn, a panel a recording, unless another is asked for."""
    both = tuple(score(reference=reference) for reference in (Reference.KINEMATICS, Reference.GROUND_TRUTH))
    for asked, shown, hidden in (
        (None, "simulator", "kinematics"),
        (Reference.KINEMATICS, "kinematics", "simulator"),
    ):
        with mpl.rc_context({"svg.fonttype": "none"}):
            save_plot(Validation(both, both, ()), tmp_path / "plot.svg", asked)
        text = (tmp_path / "plot.svg").read_text("utf-8")
        assert text.count(shown) == 1
        assert hidden not in text


def test_a_reference_that_was_not_scored_is_an_error(tmp_path):
    """Asking for a plot against a reference that no recording has is one clear line."""
    with pytest.raises(OutputError, match="nothing to draw"):
        save_plot(validation("sweep.mcap"), tmp_path / "plot.png", Reference.KINEMATICS)

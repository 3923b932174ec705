"""Validation results: the JSON document, the table and the plot, from a small synthetic validation."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest

from svmdist.errors import OutputError
from svmdist.estimation.alarms import AlarmRules
from svmdist.report.plots import PAGE_IN, draw, save_plot
from svmdist.report.scores import (
    BLUR_COLUMNS,
    BLUR_KEYS,
    blur_row,
    remarks,
    score_keys,
    score_row,
    validation_document,
    validation_table,
)
from svmdist.report.tables import csv_lines, json_array_lines, render, rich_table
from svmdist.vision.degradations import Blur
from svmdist.workflows.blur_bench import BlurRow, PrintedRow
from svmdist.workflows.scoring.score import Pairs, Score, score_pairs
from svmdist.workflows.scoring.truth import Reference
from svmdist.workflows.validate import Validation

START_NS = 1_700_000_000_000_000_000


def score(
    name: str = "sweep.mcap",
    count: int = 60,
    reference: Reference = Reference.GROUND_TRUTH,
    fitted_on: bool = False,
    constant: bool = False,
) -> Score:
    """A score over a smooth distance with half a millimetre of noise, and a gap of ten frames in the middle."""
    rng = np.random.default_rng(1)
    truth_m = 0.03 + (0.0 if constant else 0.01) * np.sin(np.arange(count) / 9)
    estimate_m = truth_m + rng.normal(scale=5e-4, size=count)
    frames = np.arange(count) + 10 * (np.arange(count) >= count // 2)
    pairs = Pairs(
        START_NS + frames.astype(np.int64) * 100_000_000, estimate_m, truth_m, np.full(count, np.nan)
    )
    rejected = {"no_instrument": 9, "no_tissue": 1}
    return Score(name, "overlay", "corrected", reference, count + 12, rejected, pairs, fitted_on)


def validation(*names: str, **changes: object) -> Validation:
    """A validation with a score a name and an overall score."""
    scores = tuple(score(name, **changes) for name in names)  # type: ignore[arg-type]
    return Validation(scores, (replace(scores[0], recording="overall"),), ("a note",))


def strict_loads(text: str) -> object:
    """Parse JSON and refuse NaN and Infinity, which Python's json would accept."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


def test_the_document_has_the_fields_of_its_schema():
    """Every recording has all figures of svmdist.validation/1, in SI, equal to the score's own."""
    made = validation("sweep.mcap", "random.mcap")
    document = strict_loads(json.dumps(validation_document(made)))
    assert isinstance(document, dict)
    assert document["schema"] == "svmdist.validation/1"
    assert [row["recording"] for row in document["recordings"]] == ["sweep.mcap", "random.mcap"]
    row, statistics = document["recordings"][0], made.scores[0].statistics
    assert statistics is not None
    assert set(row) == set(score_keys())
    assert (row["sample_count"], row["rejected_count"], row["frame_count"], row["unpaired_count"]) == (
        60,
        10,
        72,
        2,
    )
    assert row["coverage"] == pytest.approx(62 / 72)
    assert row["rejected"] == {"no_instrument": 9, "no_tissue": 1}
    assert (row["rmse_m"], row["bias_m"], row["r_squared"]) == (
        statistics.rmse,
        statistics.bias,
        statistics.r_squared,
    )
    assert row["rmse_low_m"] <= row["rmse_m"] <= row["rmse_high_m"]
    assert document["overall"]["recording"] == "overall"
    assert document["paper"]["r_squared"] == 0.78
    assert document["notes"] == ["a note"]


@pytest.mark.parametrize(
    "made",
    [validation("a", constant=True), validation("a", count=3), validation("a", count=0)],
    ids=["still", "few", "none"],
)
def test_undefined_figures_are_null(made):
    """A still truth, few pairs and no pairs leave R², intervals or all figures out; NaN never reaches JSON."""
    document = strict_loads(json.dumps(validation_document(made), allow_nan=False))
    assert isinstance(document, dict)
    row = document["recordings"][0]
    assert None in row.values()
    cells = dict(
        zip(
            *csv.reader(io.StringIO("".join(csv_lines(score_keys(), [score_row(made.scores[0])])))),
            strict=True,
        )
    )
    assert {key for key, value in cells.items() if value == ""} == {
        key for key, value in row.items() if value is None
    }
    assert "nan" not in render(validation_table(made))


def test_the_overall_score_is_the_one_against_the_strongest_reference():
    """With both references `overall` is against the simulator's truth, and both are listed by reference."""
    both = tuple(score(reference=reference) for reference in (Reference.KINEMATICS, Reference.GROUND_TRUTH))
    document = validation_document(Validation(both, both, ()))
    assert document["overall"]["reference"] == str(Reference.GROUND_TRUTH)
    assert list(document["overall_by_reference"]) == ["kinematics", "ground_truth"]
    assert validation_document(Validation(both, (), ()))["overall"] is None


@pytest.mark.parametrize("name", ["[red]x", "[/nope]", "a\x1b[31mb"], ids=["colour", "no tag", "ESC"])
def test_names_in_the_table_are_text(name):
    """A recording's name can neither colour, nor crash, nor drive the terminal."""
    shown = render(validation_table(validation(name)))
    assert "\x1b" not in shown
    assert name.replace("\x1b", "\N{REPLACEMENT CHARACTER}") in shown


def test_the_table_shows_r_squared_with_rmse_sigma_and_n():
    """R² never stands alone: RMSE, σ and n stand in the same row, with their units in the heading."""
    made = validation("sweep.mcap", fitted_on=True)
    statistics = made.scores[0].statistics
    assert statistics is not None
    shown = render(validation_table(made))
    for heading in ("in mm", "R²", "RMSE", "σ (of the truth)", "cov. %", "bias", " n "):
        assert heading in shown
    row = next(line for line in shown.splitlines() if "sweep.mcap" in line)
    for text in (
        f"{statistics.r_squared:.4f}",
        f"{statistics.rmse * 1e3:.2f}",
        f"{statistics.truth_std * 1e3:.2f}",
    ):
        assert text in row
    remark, note = remarks(made)
    assert "The paper reports R² = 78%" in note
    assert "fitted on this log" in remark
    assert "not measured: 9 no_instrument, 1 no_tissue of" in remark
    assert "2" in remark


def test_of_a_method_in_3d_nothing_is_said_about_the_papers_plane():
    """The title names the distance in place of the equations, and the paper's figure is left out."""
    made = validation("contact.mcap")
    in_3d = replace(made, scores=(replace(made.scores[0], method="fused"),))
    shown = render(validation_table(in_3d))
    assert shown.startswith("fused, planar distance; ")
    assert "equations" not in shown
    assert not any("paper" in remark for remark in remarks(in_3d))


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


def test_blur_rows_stand_beside_the_papers():
    """Rows carry the contract's keys and Table I as published; without a value there is none."""
    ours = BlurRow(Blur.GAUSSIAN, 5, 40, 6.5, 214.0, 900.0, 120.0, 100.0, 1.0, 3e-4, PrintedRow(7, 215))
    clean = BlurRow(Blur.NONE, 1, 40, None, None, None, None, None, 0.0, None, None)
    rows = [blur_row(ours), blur_row(clean)]
    assert BLUR_KEYS[:9] == (
        "blur",
        "kernel_px",
        "keypoint_count",
        "contour_area_px",
        "marker_keypoint_count",
        "match_count",
        "inlier_count",
        "coverage",
        "rmse_m",
    )
    parsed = strict_loads("".join(json_array_lines(BLUR_KEYS, rows)))
    assert isinstance(parsed, list)
    assert (parsed[0]["blur"], parsed[0]["paper_keypoint_count"], parsed[0]["rmse_m"]) == (
        "gaussian",
        7,
        3e-4,
    )
    assert parsed[1]["keypoint_count"] is None
    shown = render(rich_table("Table I", BLUR_COLUMNS, rows))
    assert "RMSE [mm]" in shown
    assert "0.300" in shown

"""Plots of methods side by side and of degradations show the figures, and differ without colour."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import matplotlib.colors
import numpy as np
import pytest
from matplotlib.axes import Axes

from svmdist.cli.plots import PLOTS, PlotKind, require_plot
from svmdist.errors import OutputError, UsageError
from svmdist.report.plots import PAGE_IN, draw_blur, draw_compare
from svmdist.vision.degradations import Degradation
from svmdist.workflows.compare import ALL, Figures, Group, MethodScore
from svmdist.workflows.conditions import CLEAN, Condition
from svmdist.workflows.degradation_grid import GridCell
from svmdist.workflows.scoring.score import DistanceScore, Pairs, score_pairs
from tests.cli.conftest import Cli, cli

__all__ = ["cli"]


def score(error_m: float, std_m: float = np.nan) -> DistanceScore:
    truth_m = np.linspace(0.01, 0.05, 20)
    found = score_pairs(Pairs(np.arange(20), truth_m + error_m, truth_m, np.full(20, std_m)))
    assert found is not None
    return found


def figures(error_mm: float, measured: int = 20, std_mm: float = np.nan, *, in_3d: bool = False) -> Figures:
    one = score(error_mm * 1e-3, std_mm * 1e-3)
    return Figures(20, measured, one, one if in_3d else None, one if in_3d else None, 5.0)


def dots(axes: Axes) -> dict[tuple[str, str], float]:
    """The marker of each method and group."""
    methods = ["overlay", "fused"]
    return {
        (methods[int(line.get_ydata()[0])], str(line.get_label())): float(line.get_xdata()[0])
        for line in axes.get_lines()
        if line.get_marker() not in ("None", "")
    }


def test_methods_stand_side_by_side_with_their_figures() -> None:
    groups = [Group("sweep"), Group("contact"), Group(ALL, ALL)]
    scores = [MethodScore(group, "overlay", figures(0.5 + at, 15)) for at, group in enumerate(groups)]
    scores += [MethodScore(group, "fused", figures(0.25, 20, 0.2, in_3d=True)) for group in groups]
    figure = draw_compare(scores)
    above, below = figure.axes[:4], figure.axes[4:]
    assert figure.get_suptitle() == "overlay, fused: 20 frames"
    assert figure.get_figwidth() == PAGE_IN
    assert dots(above[0]) == pytest.approx(
        {("overlay", name): 75.0 for name in ("sweep", "contact", "all")}
        | {("fused", name): 100.0 for name in ("sweep", "contact", "all")}
    )
    rmse = dots(above[1])
    assert rmse["overlay", "contact"] == pytest.approx(1.5)
    assert rmse["fused", "sweep"] == pytest.approx(0.25)
    assert {method for method, _ in dots(above[2])} == {"fused"}  # a planar method knows no clearance
    assert set(dots(below[3]).values()) == {100.0}  # 0.25 mm inside of 1.96 times 0.2 mm
    assert dots(below[0])["fused", "all"] == 5.0
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["sweep", "contact", "all"]
    looks = {line.get_label(): (line.get_marker(), line.get_color()) for line in above[0].get_lines()}
    assert len(set(looks.values())) == 3
    assert all(is_grey(colour) for _, colour in looks.values())


def is_grey(colour: object) -> bool:
    red, green, blue = matplotlib.colors.to_rgb(colour)  # type: ignore[arg-type]
    return red == green == blue


def test_errors_that_differ_much_are_on_a_logarithmic_axis() -> None:
    near = [MethodScore(Group("a"), name, figures(error)) for name, error in (("x", 1.0), ("y", 3.0))]
    assert draw_compare(near).axes[1].get_xscale() == "linear"
    far = [*near, MethodScore(Group("a"), "z", figures(90.0))]
    assert draw_compare(far).axes[1].get_xscale() == "log"


def grid(in_3d: bool = True) -> list[GridCell]:
    cells = [GridCell("fused", CLEAN, figures(0.1, 20, 0.2, in_3d=in_3d))]
    for name in Degradation:
        cells += [
            GridCell(
                "fused", Condition(name, severity), figures(0.1 * severity, 20 - severity, 0.2, in_3d=in_3d)
            )
            for severity in (1, 3, 5)
        ]
    # At severity 5 of smoke nothing is measured at all.
    lost = Figures(20, 0, None, None, None, 5.0)
    return [replace(cell, figures=lost) if str(cell.condition) == "smoke=5" else cell for cell in cells]


def test_blur_is_drawn_over_severity_from_the_recorded_images_on() -> None:
    figure = draw_blur(grid())
    coverage, error, held = figure.axes
    assert figure.get_suptitle() == "fused: 20 frames, severity 0 as recorded"
    assert error.get_ylabel() == "RMSE of the clearance [mm]"
    lines = {str(line.get_label()): line for line in error.get_lines()}
    assert set(lines) == {name.replace("_", " ") for name in Degradation}
    np.testing.assert_allclose(lines["noise"].get_xdata(), [0, 1, 3, 5])
    np.testing.assert_allclose(lines["noise"].get_ydata(), [0.1, 0.1, 0.3, 0.5])
    np.testing.assert_allclose(lines["smoke"].get_ydata(), [0.1, 0.1, 0.3, np.nan])
    smoke = next(line for line in coverage.get_lines() if line.get_label() == "smoke")
    np.testing.assert_allclose(smoke.get_ydata(), [100.0, 95.0, 85.0, 0.0])
    jpeg = next(line for line in held.get_lines() if line.get_label() == "jpeg")
    np.testing.assert_allclose(jpeg.get_ydata(), [100.0, 100.0, 100.0, 0.0])  # 0.5 mm, 0.39 mm stated
    looks = {(str(line.get_linestyle()), line.get_marker()) for line in lines.values()}
    assert len(looks) == len(lines)
    assert all(is_grey(line.get_color()) for line in lines.values())


def test_without_degradation_or_truth_there_is_nothing_to_draw() -> None:
    with pytest.raises(OutputError, match=r"a\.png: nothing to draw: no image is degraded"):
        draw_blur(grid()[:1], Path("a.png"))
    blind = [replace(cell, figures=Figures(20, 0, None, None, None, 5.0)) for cell in grid()]
    with pytest.raises(OutputError, match="no frame was measured"):
        draw_blur(blind)


def test_the_axis_of_a_planar_method_is_the_planar_distance() -> None:
    cells = [
        replace(cell, figures=replace(cell.figures, spatial=None, clearance=None))
        for cell in grid(in_3d=False)
    ]
    assert draw_blur(cells).axes[1].get_ylabel() == "RMSE of the planar distance [mm]"


def test_every_plot_is_drawn_by_some_command_and_refused_by_the_others() -> None:
    assert {kind for kinds in PLOTS.values() for kind in kinds} == set(PlotKind)
    for command, kinds in PLOTS.items():
        for kind in PlotKind:
            if kind in kinds:
                assert require_plot(command, kind, Path("a.svg")) is kind
                continue
            with pytest.raises(UsageError) as problem:
                require_plot(command, kind, Path("a.svg"))
            for own in kinds:
                assert own in str(problem.value)
    assert require_plot("validate", None, Path("a.svg")) is PlotKind.FIG6
    assert require_plot("validate", None, None) is None


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("validate", "--plot", "blur", "--save-plot", "a.png"), "is drawn by svmdist blur-bench --grid"),
        (("compare", "--plot", "time", "--save-plot", "a.png"), "svmdist compare draws compare"),
        (("compare", "--plot", "compare"), "--save-plot FILE"),
        (("blur-bench", "--save-plot", "a.png"), "it is for --grid"),
        (("blur-bench", "--grid", "--plot", "fig6", "--save-plot", "a.png"), "blur-bench --grid draws blur"),
    ],
)
def test_wrong_combinations_are_one_line(cli: Cli, arguments: tuple[str, ...], said: str) -> None:
    outcome = cli(*arguments)
    assert outcome.code == 2
    assert said in outcome.err
    assert len(outcome.err.splitlines()) == 1


@pytest.mark.parametrize("command", [("estimate",), ("validate",), ("compare",), ("blur-bench", "--grid")])
def test_another_ending_is_an_error_before_any_work(
    cli: Cli, tmp_path: Path, command: tuple[str, ...]
) -> None:
    """Even the recording, which is none, is not looked at."""
    nothing = tmp_path / "nothing.mcap"
    outcome = cli(*command, nothing, "--save-plot", tmp_path / "a.jpeg")
    assert outcome.code == 1
    assert (
        outcome.err == f"svmdist: {tmp_path / 'a.jpeg'}: cannot draw a .jpeg: the choices are png, svg, pdf\n"
    )


def test_commands_draw_what_they_print(cli: Cli, tmp_path: Path, golden: Path) -> None:
    """The SVG's axis of methods, and the PNG's size, of a real log."""
    log = golden / "sweep.mcap"
    picture = tmp_path / "compare.svg"
    outcome = cli(
        "compare", log, "--method", "overlay", "--method", "kinematic", "--every", 20, "-f", "json", "--jobs", 1,
        "--save-plot", picture,
    )  # fmt: skip
    assert outcome.code == 0
    assert [row["method"] for row in json.loads(outcome.out)] == ["overlay", "kinematic"]
    assert re.search(r"<!-- overlay, kinematic: 4 frames -->", picture.read_text("utf-8"))
    blur = tmp_path / "blur.png"
    outcome = cli(
        "blur-bench", log, "--grid", "--degradations", "smoke,jpeg", "--severities", "1,5", "--every", 20,
        "--jobs", 1, "--save-plot", blur,
    )  # fmt: skip
    assert outcome.code == 0
    image = cv2.imread(str(blur))
    assert image is not None
    assert image.shape[1] == pytest.approx(PAGE_IN * 300, abs=2)
    assert np.ptp(image, axis=2).max() == 0  # no colour in it

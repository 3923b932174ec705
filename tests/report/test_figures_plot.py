"""Plots of methods side by side and of degradations show the figures, and differ without colour."""

from __future__ import annotations

import json
import re
from pathlib import Path

import matplotlib.colors
import numpy as np
import pytest
from matplotlib.axes import Axes

from svmdist.report.plots import PAGE_IN, draw_compare
from svmdist.workflows.compare import ALL, Figures, Group, MethodScore
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


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("compare", "--plot", "compare"), "--save-plot FILE"),
    ],
)
def test_wrong_combinations_are_one_line(cli: Cli, arguments: tuple[str, ...], said: str) -> None:
    outcome = cli(*arguments)
    assert outcome.code == 2
    assert said in outcome.err
    assert len(outcome.err.splitlines()) == 1


@pytest.mark.parametrize("command", [("estimate",), ("validate",), ("compare",)])
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

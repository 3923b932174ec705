"""Tables as LaTeX and Markdown: every cell, escaped, and trajectories that evo reads."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from svmdist.recording.log import open_recording
from svmdist.report.tables import Column, latex, markdown, rich_table
from svmdist.transforms import rotation_from_quaternion_xyzw
from svmdist.workflows.estimate import estimate
from svmdist.workflows.request import prepare
from tests.cli.conftest import Cli, cli

__all__ = ["cli"]
TABLE = rich_table(
    "R² & more", [Column("name", "name", is_text=True), Column("n", "n [%]")], [{"name": "a_b|c", "n": 3}]
)


def test_latex_escapes_and_aligns() -> None:
    text = "".join(latex([TABLE], ["a note"]))
    assert r"\caption{R\textsuperscript{2} \& more}" in text
    assert r"\begin{tabular}{lr}" in text
    assert r"name & n [\%] \\" in text
    assert r"a\_b|c & 3 \\" in text
    assert text.endswith("% a note\n")


def test_markdown_escapes_pipes() -> None:
    lines = "".join(markdown([TABLE], [])).splitlines()
    assert lines[2:] == ["| name | n [%] |", "|---|---:|", r"| a\_b\|c | 3 |", ""]


def test_summaries_are_written_in_markup(golden: Path, cli: Cli, tmp_path: Path) -> None:
    log = golden / "sweep.mcap"
    score = json.loads(cli("validate", log, "-f", "json").out)["recordings"][0]
    text = cli("validate", log, "-f", "latex").out
    assert f"{score['rmse_m'] * 1e3:.2f}" in text
    assert text.count(r"\begin{table}") == text.count(r"\end{table}") >= 1
    assert cli("validate", log, "-o", tmp_path / "a.md").code == 0
    assert (tmp_path / "a.md").read_text().count("|---") >= 1


def test_trajectories_are_the_tools_poses(golden: Path, cli: Cli) -> None:
    log = golden / "3d" / "contact.mcap"
    setup = prepare(method="fiducial")
    rows = [row for row in estimate(open_recording(log, setup.profile), setup) if row.measured]
    text = cli("estimate", log, "--method", "fiducial", "-f", "tum").out
    poses = np.array([line.split() for line in text.splitlines()[1:]], float)
    assert poses.shape == (len(rows), 8)
    for pose, row in zip(poses, rows, strict=True):
        assert row.tool is not None
        np.testing.assert_allclose(pose[1:4], row.tool.pose.position_m, atol=1e-9)
        R = rotation_from_quaternion_xyzw(pose[4:])
        np.testing.assert_allclose(R, row.tool.pose.T_camera_tool[:3, :3], atol=1e-7)
    planar = cli("estimate", log, "-f", "tum")
    assert planar.code == 2
    assert "in 3D" in planar.err
    several = cli("estimate", golden / "3d" / "duo.mcap", "--method", "fiducial", "-f", "tum")
    assert several.code == 2
    assert "--instrument" in several.err

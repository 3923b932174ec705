"""`svmdist blur-bench --grid`: its forms, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.conftest import Cli
from tests.synthetic import write_log

FRAMES = 4


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short log drawn with OpenCV."""
    return write_log(tmp_path_factory.mktemp("grid") / "short.mcap", frame_count=FRAMES)


def test_grid_on_the_command_line(cli: Cli, log: Path) -> None:
    """A row a cell in JSON and CSV, `none` of severity 0 first; the table names the method and stays narrow."""
    common = ("blur-bench", log, "--grid", "--method", "kinematic", "--degradations", "jpeg,noise")
    outcome = cli(*common, "--severities", "1", "-f", "json")
    assert outcome.code == 0, outcome.err
    rows = json.loads(outcome.out)
    assert [(row["degradation"], row["severity"]) for row in rows] == [("none", 0), ("jpeg", 1), ("noise", 1)]
    assert {row["method"] for row in rows} == {"kinematic"}
    assert all(row["frame_count"] == FRAMES for row in rows)
    header, *lines = cli(*common, "--severities", "1", "-f", "csv").out.splitlines()
    assert header.split(",") == list(rows[0])
    assert len(lines) == 3
    table = cli(*common, "--severities", "1").out
    assert "kinematic on 4 frames of 1 recording\n" in table
    assert max(map(len, table.split("Errors in mm")[0].splitlines())) <= 100


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--grid", "--degradations", "smok"), "did you mean smoke"),
        (("--grid", "--degradations", "smoke,"), "as in smoke,noise"),
        (("--grid", "--severities", "0"), "from 1 to 5, found 0"),
        (("--grid", "--severities", "3,x"), "as in 1,3,5"),
        (("--grid", "--kernel", "gaussian=5"), "--kernel is for Table I"),
        (("--method", "overlay"), "--method is for --grid"),
        (("--degradations", "smoke"), "--degradations is for --grid"),
        (("--severities", "1"), "--severities is for --grid"),
    ],
)
def test_wrong_grid_options(cli: Cli, arguments: tuple[str, ...], said: str) -> None:
    """Each is one clear line and exit code 2; no option is ignored."""
    outcome = cli("blur-bench", "x.mcap", *arguments)
    assert outcome.code == 2
    (line,) = outcome.err.splitlines()
    assert said in line

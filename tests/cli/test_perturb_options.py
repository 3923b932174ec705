"""`record --perturb`, `record --world` and `compare --perturb`: one line for what is wrong, groups for the rest."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from svmdist.cli.perturbations import parse_perturb, parse_perturb_groups
from svmdist.perturbations.chosen import World, draw_world, parse_perturbations
from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from tests.cli.conftest import Cli

WRONG = [
    ("focl=1", "did you mean focal? The choices are: backlash"),
    ("focal", "focal: expected NAME=STRENGTH, as in focal=1"),
    ("focal=many", "expected NAME=STRENGTH"),
    ("focal=99", "perturbation focal: from -20 to 20 %, found 99"),
]


@pytest.mark.parametrize(("value", "said"), WRONG)
@pytest.mark.parametrize("command", ["record", "compare"])
def test_a_wrong_perturbation_is_one_line_with_the_choices(
    cli: Cli, tmp_path: Path, synthetic_log: Path, command: str, value: str, said: str
) -> None:
    target = ("-o", tmp_path / "never.mcap") if command == "record" else (synthetic_log,)
    outcome = cli(command, *target, "--perturb", value)
    (line,) = outcome.err.splitlines()
    assert outcome.code == 2
    assert line.startswith("svmdist: --perturb: ")
    assert said in line
    assert not (tmp_path / "never.mcap").exists()


def test_a_name_given_twice_is_refused(cli: Cli, tmp_path: Path) -> None:
    outcome = cli("record", "-o", tmp_path / "never.mcap", "--perturb", "lag=1", "--perturb", "focal=1,lag=2")
    assert outcome.code == 2
    assert outcome.err == "svmdist: --perturb: perturbation lag is given twice\n"


def test_values_are_parsed_together_or_each_alone() -> None:
    values = ["focal=1,lag=2", "plane=3"]
    assert [str(one) for one in parse_perturb_groups("--perturb", values)] == values
    assert str(parse_perturb("--perturb", values)) == "focal=1,lag=2,plane=3"
    assert not parse_perturb("--perturb", None)
    assert parse_perturb_groups("--perturb", None) == ()


def test_a_world_is_ideal_or_real(cli: Cli, tmp_path: Path) -> None:
    outcome = cli("record", "-o", tmp_path / "never.mcap", "--world", "rael")
    assert outcome.code == 2
    assert "real" in outcome.err


def test_compare_has_a_group_for_each_perturbation(cli: Cli, synthetic_log: Path) -> None:
    outcome = cli(
        *("compare", synthetic_log, "--method", "kinematic", "-f", "json"),
        *("--perturb", "plane=1", "--perturb", "lag=30,joint_noise=.05", "--perturb", "plane=1"),
    )
    assert outcome.code == 0
    rows = json.loads(outcome.out)
    named = [row["degradation"] for row in (rows if isinstance(rows, list) else rows["rows"])]
    assert named == ["", "plane=1", "lag=30,joint_noise=0.05", "all"]


def test_record_writes_what_was_chosen_and_drawn(cli: Cli, tmp_path: Path) -> None:
    pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
    path = tmp_path / "real.mcap"
    options = ("--duration", 0.2, "--seed", 3, "--world", "real", "--perturb", "lag=40", "-j", 1)
    assert cli("record", "-o", path, *options).code == 0
    metadata = open_recording(path, load_profile()).metadata
    assert metadata["world"] == "real"
    written = parse_perturbations(metadata["perturb"])
    assert written == draw_world(World.REAL, 3, parse_perturbations("lag=40"))
    assert written["lag"] == 40.0

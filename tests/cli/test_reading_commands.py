"""`estimate`, `fk` and `info` as functions: the output is checked first, and the rows are those of the library."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from svmdist.cli.console import ExitCode

from svmdist.cli.estimate import estimate_command
from svmdist.cli.fk import fk_command
from svmdist.cli.info import info_command
from svmdist.cli.options import Method
from svmdist.errors import OutputError, UsageError
from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.report.writers import Holds, names_of
from svmdist.transforms import rotation_from_quaternion_xyzw
from svmdist.workflows.fk import fk
from tests.recording.builders import scene, write_scene
from tests.synthetic import write_log


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A synthetic log of five frames, with joints and poses."""
    return write_log(tmp_path_factory.mktemp("reading") / "a.mcap", frame_count=5)


def exit_code(command: Callable[..., None], *arguments: Any, **options: Any) -> int:
    """Run a command and give its exit code."""
    with pytest.raises(typer.Exit) as told:
        command(*arguments, **options)
    return int(told.value.exit_code)


@pytest.mark.parametrize("command", [estimate_command, fk_command, info_command])
def test_an_output_that_cannot_be_written_is_refused_first(
    tmp_path: Path, log: Path, command: Callable[..., None]
) -> None:
    """The log that does not exist is not what is told; and no command writes over its log."""
    missing = tmp_path / "no.mcap"
    with pytest.raises(OutputError, match="there is no folder"):
        command([missing], output=tmp_path / "no folder" / "a.csv")
    with pytest.raises(UsageError, match="is the recording to read"):
        command([log], output=log)


@pytest.mark.parametrize("command", [estimate_command, fk_command, info_command])
def test_the_help_begins_with_what_the_command_does(command: Callable[..., None]) -> None:
    """A verb of the English language, and a sentence that ends."""
    first = (command.__doc__ or "").splitlines()[0]
    assert first.split()[0] in {"Estimate", "Print", "Show"}
    assert first.endswith(".")


def test_poses_are_those_of_forward_kinematics_in_every_form(
    tmp_path: Path, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """CSV and JSON give the same numbers; the TUM format a stamp, a position and a quaternion, to nine digits."""
    profile = load_profile()
    expected = fk(open_recording(log, profile), profile)
    rows = {}
    for form in names_of(Holds.POSES):
        output = tmp_path / f"a.{form}"
        assert exit_code(fk_command, [log], form=form, output=output) == ExitCode.CLEAN
        if form != "parquet":
            rows[form] = output.read_text()
    table = list(csv.DictReader(rows["csv"].splitlines()))
    objects = json.loads(rows["json"])
    assert len(table) == len(objects) == len(expected.stamps_ns)
    assert [list(row) for row in objects] == [list(row) for row in table]
    for row, one in zip(table, objects, strict=True):
        for key, value in one.items():
            assert str(value) == row[key] or float(row[key]) == pytest.approx(value, rel=1e-12)
    poses = np.array([line.split() for line in rows["tum"].splitlines() if line[0] != "#"], float)
    assert poses.shape == (len(expected.stamps_ns), 8)
    np.testing.assert_allclose(poses[:, 1:4], expected.poses[:, :3, 3], atol=1e-8)
    rotations = [rotation_from_quaternion_xyzw(pose) for pose in poses[:, 4:]]
    np.testing.assert_allclose(rotations, expected.poses[:, :3, :3], atol=1e-7)
    import pandas

    arrow = pandas.read_parquet(tmp_path / "a.parquet").to_dict("records")
    assert arrow == objects
    assert capsys.readouterr().out == ""


def test_every_frame_is_a_row_in_every_form(
    tmp_path: Path, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And the summary on stderr counts them."""
    import pandas

    counted: dict[str, Callable[[Path], int]] = {
        "table": lambda path: len(path.read_text().splitlines()) - 2,  # the names and the line below them
        "csv": lambda path: len(list(csv.DictReader(path.read_text().splitlines()))),
        "json": lambda path: len(json.loads(path.read_text())),
        "jsonl": lambda path: len([json.loads(line) for line in path.read_text().splitlines()]),
        "tum": lambda path: len([line for line in path.read_text().splitlines() if line[0] != "#"]),
        "parquet": lambda path: len(pandas.read_parquet(path)),
    }
    for form, count in counted.items():
        output = tmp_path / f"a.{form}"
        code = exit_code(estimate_command, [log], method=Method.KINEMATIC, form=form, output=output)
        assert code == ExitCode.CLEAN
        assert count(output) == 5
        assert "of 5 frames measured" in capsys.readouterr().err
    assert set(counted) == set(names_of(Holds.ROWS))


def test_info_tells_the_same_topics_in_every_form(tmp_path: Path) -> None:
    """With the counts of what was written."""
    entries = scene()
    log = write_scene(tmp_path / "a.mcap", entries)
    texts = {}
    for form in names_of(Holds.TABLES):
        output = tmp_path / f"a.{form}"
        assert exit_code(info_command, [log], form=form, output=output) == ExitCode.CLEAN
        texts[form] = output.read_text()
    rows = list(csv.DictReader(texts["csv"].splitlines()))
    document = json.loads(texts["json"])
    counts = {topic: sum(entry.topic == topic for entry in entries) for topic in {e.topic for e in entries}}
    key = next(name for name in rows[0] if "count" in name or "messages" in name)
    assert {row["topic"]: int(row[key]) for row in rows} == counts
    assert {row["topic"]: row[key] for row in document["topics"]} == counts
    assert all(topic in texts["table"] for topic in counts)


def test_a_log_with_losses_gives_their_exit_code(
    tmp_path: Path, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The rows that could be read are written all the same."""
    truncated = tmp_path / "a.mcap"
    data = log.read_bytes()
    truncated.write_bytes(data[: len(data) - 100])
    for command in (info_command, fk_command):
        output = tmp_path / "out"
        assert exit_code(command, [truncated], output=output) == ExitCode.LOSS
        assert output.stat().st_size > 0
        assert "svmdist: loss: " in capsys.readouterr().err

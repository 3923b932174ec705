"""`--lag` of estimate, validate and compare: clocks that differ, put right; and what is said where they are not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from svmdist.cli.lag import told_lag
from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.workflows.request import prepare
from tests.cli.conftest import Cli
from tests.late import IMAGES, ROBOT, Log, samples_of, write_shifted

Rows = list[dict[str, Any]]


@pytest.fixture(scope="module")
def log(golden: Path) -> Log:
    """Two seconds of the golden log in 3D."""
    return samples_of(golden / "3d" / "contact.mcap", 2.0)


@pytest.fixture(scope="module")
def plain(log: Log, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, written with its own stamps."""
    return write_shifted(tmp_path_factory.mktemp("plain") / "log.mcap", log, ROBOT, 0.0)


def rows_of(cli: Cli, path: Path, method: str, *options: object) -> Rows:
    outcome = cli("estimate", path, "--method", method, "-f", "json", "-j", 1, *options)
    rows = list(json.loads(outcome.out))
    nothing_measured = all(row["status"] != "ok" for row in rows)
    assert outcome.code == int(nothing_measured), outcome.err
    return rows


def figures_of(cli: Cli, path: Path, method: str, *options: object) -> dict[str, Any]:
    outcome = cli("compare", path, "--method", method, "-f", "json", *options)
    assert outcome.code == 0, outcome.err
    return dict(json.loads(outcome.out)[0])


def assert_same(found: dict[str, Any], expected: dict[str, Any], but: tuple[str, ...] = ()) -> None:
    """Every field to 1e-9."""
    assert found.keys() == expected.keys()
    for key in found.keys() - {*but}:
        if isinstance(expected[key], float):
            assert found[key] == pytest.approx(expected[key], rel=1e-9, abs=1e-9), key
        else:
            assert found[key] == expected[key], key


@pytest.mark.parametrize("method", ["fused", "kinematic", "fiducial"])
@pytest.mark.parametrize("late_s", [0.5, -0.5])
def test_rows_are_those_of_the_log_without_a_lag(
    cli: Cli, tmp_path: Path, log: Log, plain: Path, late_s: float, method: str
) -> None:
    """Joints, poses and transforms with stamps that are off by half a second: images are as early."""
    late = write_shifted(tmp_path / "log.mcap", log, ROBOT, late_s)
    found = rows_of(cli, late, method, "--lag", -late_s)
    expected = rows_of(cli, plain, method, "--lag", 0)
    assert len(found) == len(expected) == 21
    assert any(row["status"] == "ok" for row in expected)
    for row, other in zip(found, expected, strict=True):
        assert_same(row, other)


@pytest.mark.parametrize("late_s", [100.0, -100.0])
def test_a_lag_may_be_of_any_size(cli: Cli, tmp_path: Path, log: Log, plain: Path, late_s: float) -> None:
    """A hundred seconds, and the robot's messages logged as much later or earlier than the images."""
    late = write_shifted(tmp_path / "log.mcap", log, ROBOT, late_s)
    found = rows_of(cli, late, "kinematic", "--lag", -late_s)
    for row, other in zip(found, rows_of(cli, plain, "kinematic", "--lag", 0), strict=True):
        assert_same(row, other)


def test_without_a_lag_only_deviations_differ(cli: Cli, plain: Path) -> None:
    """A lag of nothing says that the clocks agree: the same nominal distances, with smaller deviations."""
    for row, other in zip(
        rows_of(cli, plain, "kinematic", "--lag", 0), rows_of(cli, plain, "kinematic"), strict=True
    ):
        assert row["spatial_m"] == other["spatial_m"]
        assert row["spatial_std_m"] <= other["spatial_std_m"]


@pytest.mark.parametrize(("kinds", "late_s"), [(ROBOT, 0.5), (ROBOT, -0.5), (IMAGES, 0.5), (IMAGES, -0.5)])
def test_compare_pairs_with_the_truth_on_either_clock(
    cli: Cli, tmp_path: Path, golden: Path, log: Log, plain: Path, kinds: tuple[type, ...], late_s: float
) -> None:
    """Whether the robot's stamps are off, or those of the images and not of the truth: the figures are the same.

    But for frames at the ends whose truth has no stamp.
    """
    lag_s = late_s if kinds == IMAGES else -late_s
    if kinds == IMAGES:
        log = samples_of(golden / "3d" / "contact.mcap", 2.0, decoded=True)
    late = write_shifted(tmp_path / "log.mcap", log, kinds, late_s)
    found = figures_of(cli, late, "fused", "--lag", lag_s)
    expected = figures_of(cli, plain, "fused", "--lag", 0)
    assert expected["coverage"] == 1.0
    assert_same(found, expected, but=("group", "ms_per_frame"))


def test_compare_and_estimate_agree(cli: Cli, tmp_path: Path, log: Log) -> None:
    """The error of the rows is that which compare tells, in processes too; validate's is the same."""
    late = write_shifted(tmp_path / "log.mcap", log, ROBOT, 0.5)
    rows = [row for row in rows_of(cli, late, "fused", "--lag", -0.5) if row["status"] == "ok"]
    truth = open_recording(late, load_profile()).distance_track()
    true_m = truth.at(np.array([row["stamp_ns"] for row in rows], np.int64)).spatial_m
    rmse_m = float(np.sqrt(np.mean((np.array([row["spatial_m"] for row in rows]) - true_m) ** 2)))
    found = figures_of(cli, late, "fused", "--method", "kinematic", "--lag", -0.5, "-j", 2)
    assert found["spatial_rmse_m"] == pytest.approx(rmse_m, rel=1e-9)
    assert rmse_m < 5e-4
    options = ("--lag", -0.5, "--truth", "ground_truth", "-f", "json")
    (score,) = json.loads(cli("validate", late, "--method", "fused", *options).out)["recordings"]
    assert score["spatial_rmse_m"] == pytest.approx(rmse_m, rel=1e-9)


@pytest.mark.parametrize("command", ["estimate", "compare", "validate"])
@pytest.mark.parametrize("lag", ["soon", "nan", "-3600.1", "1e400", ""])
def test_a_lag_that_is_none_is_refused(cli: Cli, plain: Path, command: str, lag: str) -> None:
    outcome = cli(command, plain, "--lag", lag)
    assert outcome.code == 2
    assert outcome.out == ""
    assert outcome.err == f"svmdist: --lag {lag}: expected auto or seconds within ±3600, as in 0.12\n"


def test_auto_finds_the_lag_before_it_measures(cli: Cli, tmp_path: Path, golden: Path) -> None:
    """By where the images show the instrument, in a pass of its own; estimate and compare find the same."""
    late = write_shifted(tmp_path / "log.mcap", samples_of(golden / "3d" / "contact.mcap", 6.0), ROBOT, 0.5)
    outcome = cli("estimate", late, "--method", "fused", "--lag", "auto", "-f", "json")
    note = outcome.err.splitlines()[0]
    assert note.startswith("svmdist: note: log: lag -")
    assert float(note.split()[4]) == pytest.approx(-500.0, abs=20.0)
    measured = [row for row in json.loads(outcome.out) if row["status"] == "ok"]
    assert len(measured) >= 55
    outcome = cli("compare", late, "--method", "fused", "--lag", "auto", "-f", "json")
    assert outcome.err.splitlines()[0] == note
    (figures,) = json.loads(outcome.out)
    assert figures["spatial_rmse_m"] < 5e-4
    assert figures["spatial_interval_coverage"] > 0.9


def test_auto_says_where_it_cannot_tell(cli: Cli, plain: Path, tmp_path: Path, log: Log) -> None:
    """Two frames show no motion: nothing is taken off, and rows are those without the option."""
    short = write_shifted(
        tmp_path / "log.mcap", [pair for pair in log if pair[1].stamp_ns < early(log)], ROBOT, 0.0
    )
    outcome = cli("estimate", short, "--method", "kinematic", "--lag", "auto", "-f", "json")
    assert "svmdist: note: log: the lag cannot be told and none is taken off: " in outcome.err
    assert json.loads(outcome.out) == rows_of(cli, short, "kinematic")


def test_a_lag_that_is_given_is_taken_off_without_a_word(
    golden: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Only what `auto` finds is told; without a lag the recording stays the same object."""
    setup = prepare(method="fused")
    recording = open_recording(golden / "3d" / "contact.mcap", setup.profile)
    assert told_lag(recording, setup, None, None, None) is recording
    assert told_lag(recording, setup, 0.05, None, None) is not recording
    assert capsys.readouterr().err == ""


def early(log: Log) -> int:
    return min(sample.stamp_ns for _, sample in log) + 200_000_000


@pytest.mark.parametrize("late_s", [0.5, -1.0, 1.0, 2.5])
def test_no_row_is_wrong_and_sure_where_no_lag_is_given(
    cli: Cli, tmp_path: Path, golden: Path, late_s: float
) -> None:
    """Joints beyond those that travel with an image: most frames say that clocks differ, none is far off and sure."""
    late = write_shifted(
        tmp_path / "log.mcap", samples_of(golden / "3d" / "contact.mcap", 6.0), ROBOT, late_s
    )
    rows = rows_of(cli, late, "fused")
    assert sum(row["status"] == "inconsistent" for row in rows) >= 0.5 * len(rows)
    measured = [row for row in rows if row["status"] == "ok"]
    truth = open_recording(late, load_profile()).distance_track()
    true_m = truth.at(np.array([row["stamp_ns"] for row in measured], np.int64)).spatial_m
    off = [
        abs(row["spatial_m"] - expected_m) / row["spatial_std_m"]
        for row, expected_m in zip(measured, true_m, strict=True)
    ]
    assert max(off, default=0.0) < 5.0
    assert sum(one < 1.96 for one in off) >= 0.7 * len(off)
    assert any("s late" in (row["detail"] or "") for row in rows)

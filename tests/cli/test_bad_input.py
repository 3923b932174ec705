"""Bad input gets one clear line, the right exit code, and no traceback."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from svmdist.report.rows import ESTIMATE_KEYS
from svmdist.samples import JointSample, Sample
from tests.cli.conftest import Cli
from tests.synthetic import make_scene, write_log


def _one_line(err: str) -> str:
    lines = err.strip().splitlines()
    assert len(lines) == 1, err
    assert "Traceback" not in err
    return lines[0]


def test_missing_topic_lists_the_topics(cli: Cli, tmp_path: Path) -> None:
    """A log without images names what is missing and the topics that there are."""

    def without_images(topic: str, sample: Sample) -> Sample | None:
        return None if "image" in topic else sample

    outcome = cli("estimate", write_log(tmp_path / "blind.mcap", frame_count=3, change=without_images))
    line = _one_line(outcome.err)
    assert outcome.code == 1
    assert "image" in line
    assert "/PSM1/measured_js" in line


@pytest.mark.parametrize(
    ("method", "said"),
    [
        ("fused", "3 no_joints (no joints near the image)"),
        ("stereo", "3 no_stereo (no right view)"),
    ],
)
def test_a_method_says_what_the_log_lacks(cli: Cli, tmp_path: Path, method: str, said: str) -> None:
    """Frames without what a method needs are rows with a reason and its detail, and the last line tells both."""

    def without_joints(topic: str, sample: Sample) -> Sample | None:
        return None if "PSM1" in topic else sample

    path = write_log(tmp_path / "still.mcap", frame_count=3, change=without_joints)
    outcome = cli("estimate", path, "--method", method, "-f", "csv")
    assert outcome.code == 1  # nothing was measured
    assert _one_line(outcome.err) == f"svmdist: 0 of 3 frames measured (0.0%); {said}"
    header, *rows = outcome.out.splitlines()
    assert header.endswith(",detail,tool_std_m,axis_std_rad,consistency")
    assert [f"{row.split(',')[2]} ({row.split(',')[-4]})" for row in rows] == [said.removeprefix("3 ")] * 3


@pytest.mark.parametrize("place_m", [1000.0, 1e8, -1e8])
def test_joints_where_no_joint_can_be(cli: Cli, tmp_path: Path, place_m: float) -> None:
    """An instrument that is a kilometre in is not believed: no row is `ok`, and the joint is named."""

    def far_away(_: str, sample: Sample) -> Sample:
        if not isinstance(sample, JointSample):
            return sample
        positions = sample.positions.copy()
        positions[sample.names.index("insertion")] = place_m
        return replace(sample, positions=positions)

    path = write_log(tmp_path / "far.mcap", frame_count=3, change=far_away)
    for method in ("kinematic", "fused"):
        outcome = cli("estimate", path, "--method", method, "-f", "csv")
        line = _one_line(outcome.err)
        assert line.startswith("svmdist: 0 of 3 frames measured (0.0%); 3 no_joints (joint insertion is at ")


def test_truncated_file(cli: Cli, tmp_path: Path, synthetic_log: Path, synthetic_calibration: Path) -> None:
    """Of a file that was cut off, the readable frames are measured; the loss is said and the exit code is 3."""
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(synthetic_log.read_bytes()[: synthetic_log.stat().st_size // 2])
    outcome = cli("estimate", cut, "--calibration", synthetic_calibration, "-f", "csv")
    whole = cli("estimate", synthetic_log, "--calibration", synthetic_calibration, "-f", "csv")
    rows = [line.replace("cut,", "synthetic,") for line in outcome.out.splitlines()]
    assert outcome.code == 3
    assert "truncated at byte" in outcome.err
    assert 2 < len(rows) < len(whole.out.splitlines())
    assert rows == whole.out.splitlines()[: len(rows)]


def test_calibration_of_another_camera(cli: Cli, tmp_path: Path, synthetic_calibration: Path) -> None:
    """A calibration used with another camera is refused, and both cameras are described."""
    path = write_log(tmp_path / "small.mcap", make_scene(320, 240), frame_count=3)
    outcome = cli("estimate", path, "--calibration", synthetic_calibration)
    line = _one_line(outcome.err)
    assert outcome.code == 1
    assert "640x480" in line
    assert "320x240" in line


@pytest.mark.parametrize("command", ["estimate", "validate", "blur-bench"])
def test_unwritable_output_fails_before_the_work(
    cli: Cli, tmp_path: Path, synthetic_log: Path, command: str
) -> None:
    """An output in a folder that does not exist is said at once."""
    outcome = cli(command, synthetic_log, "-o", tmp_path / "nowhere" / "rows.csv")
    assert (outcome.code, outcome.out) == (1, "")
    assert "nowhere" in _one_line(outcome.err)


@pytest.mark.parametrize("command", ["info", "fk", "estimate", "validate", "compare", "blur-bench"])
def test_a_recording_is_never_written_over(cli: Cli, synthetic_log: Path, command: str) -> None:
    """An output that is the recording itself is wrong usage, and the recording stays."""
    before = synthetic_log.read_bytes()
    outcome = cli(command, synthetic_log, "-o", synthetic_log)
    assert (outcome.code, outcome.out) == (2, "")
    assert "is the recording to read" in _one_line(outcome.err)
    assert synthetic_log.read_bytes() == before


def test_full_device(cli: Cli, synthetic_log: Path, synthetic_calibration: Path) -> None:
    """A device without space is an error, not a short result with exit code 0."""
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    outcome = cli(
        "estimate", synthetic_log, "--calibration", synthetic_calibration, "-f", "csv", "-o", "/dev/full"
    )
    assert outcome.code == 1
    assert "/dev/full" in outcome.err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["estimate"], "FILE"),
        (["estimate", "x.mcap", "--equations", "fixed"], "corrected"),
        (["estimate", "x.mcap", "-f", "xml"], "jsonl"),
        (["estimate", "x.mcap", "--equations", "printed", "--calibration", "c.toml"], "calibration"),
        (["estimate", "x.mcap", "--method", "fuse"], "fuse: did you mean fused? The choices are: centroid"),
        (
            ["calibrate", "x.mcap", "-o", "a", "--method", "fused"],
            "fused: the choices are: centroid, overlay",
        ),
        (["record", "--scenario", "swep"], "swep: did you mean sweep? The choices are: approach"),
        (
            ["validate", "x.mcap", "--method", "fused", "--alarm-below", "5mm", "--alarm-confidence", "1.5"],
            "--alarm-confidence",
        ),
        (
            [
                "validate",
                "x.mcap",
                "--method",
                "fused",
                "--alarm-below",
                "5mm",
                "--alarm-confidence",
                "often",
            ],
            "--alarm-confidence",
        ),
        (["frobnicate"], "frobnicate"),
    ],
)
def test_usage_errors(cli: Cli, arguments: list[str], said: str) -> None:
    """A wrong request exits with 2 and names the choices."""
    outcome = cli(*arguments)
    assert outcome.code == 2
    assert said in outcome.err
    assert "Traceback" not in outcome.err


def test_wrong_profile_key(cli: Cli, tmp_path: Path) -> None:
    """An unknown key of a profile is named with the file and the nearest valid key."""
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"\n[segmentation.tissue]\nhue = [170, 8]\nmin_aera_px = 50\n')
    outcome = cli("estimate", "x.mcap", "--profile", path)
    line = _one_line(outcome.err)
    assert outcome.code == 1
    assert "mine.toml" in line
    assert "did you mean min_area_px" in line


def test_validate_without_recordings(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without FILE and without recordings/, the line says where it looked."""
    monkeypatch.chdir(tmp_path)
    outcome = cli("validate")
    assert outcome.code == 2
    assert "recordings" in _one_line(outcome.err)


def test_names_from_a_file_cannot_drive_a_terminal(cli: Cli, tmp_path: Path) -> None:
    """Control characters in a file's name reach neither stdout nor stderr."""
    path = tmp_path / "a\x1b[31mred.mcap"
    path.write_bytes(b"nothing")
    outcome = cli("estimate", path)
    assert outcome.code == 1
    assert "\x1b" not in outcome.err


def test_closed_pipe_is_quiet(synthetic_log: Path, synthetic_calibration: Path) -> None:
    """`svmdist estimate … | head -1` ends without a complaint."""
    estimate = f"{sys.executable} -m svmdist estimate {synthetic_log} --calibration {synthetic_calibration}"
    command = f"{estimate} -f csv | head -1; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines() == [",".join(ESTIMATE_KEYS), "0"]
    assert done.stderr == ""


def test_record_without_pybullet_says_why(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where PyBullet is missing, `record` says why and what to do, and leaves no file."""
    monkeypatch.setitem(sys.modules, "pybullet", None)
    output = tmp_path / "sweep.mcap"
    outcome = cli("record", "--duration", "0.5", "-o", output)
    assert outcome.code == 1
    assert "svmdist[sim]" in _one_line(outcome.err)
    assert list(tmp_path.iterdir()) == []

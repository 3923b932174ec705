"""A recorded scenario is one complete file, the same for any number of processes, and nothing is left beside it."""

from __future__ import annotations

import multiprocessing
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mcap.reader import make_reader

from svmdist.errors import SimulationError, SvmdistError, UsageError
from svmdist.perturbations.chosen import parse_perturbations
from svmdist.profile import Profile, load_profile
from svmdist.recording.log import open_recording
from svmdist.simulation.motion import Scenario
from svmdist.simulation.scene import Options
from tests.cli.running import require_no_traceback, started

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.workflows import record as record_module
from svmdist.workflows.compare import Group, group_of
from svmdist.workflows.record import Recipe, record

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="needs signals as POSIX has them")
SCENARIO = Scenario("approach", 2, 0.4, 5.0)
EVERYTHING = Options(True, True, 1.0, (("smoke", 2), ("noise", 1)), 2)
PRESSED = Options(True, perturbations=parse_perturbations("dent=2,interlace=1,breathing=1,shadow=1"))


@pytest.fixture(scope="module")
def small() -> Profile:
    """The profile with a camera of few pixels."""
    profile = load_profile()
    assert profile.simulation is not None
    simulation = profile.simulation.model_copy(update={"width_px": 96, "height_px": 72})
    return profile.model_copy(update={"simulation": simulation})


@pytest.fixture
def few_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let short recordings have workers."""
    monkeypatch.setattr(record_module, "FRAMES_PER_WORKER", 1)


def test_recording_is_complete_repeatable_and_never_replaced(tmp_path: Path, small: Profile) -> None:
    path, progress = tmp_path / "approach.mcap", []
    result = record(
        Recipe(SCENARIO, small), path, on_progress=lambda done, total: progress.append((done, total))
    )
    assert progress == [(1, 2), (2, 2)]
    assert (result.frame_count, result.size_bytes) == (2, path.stat().st_size)
    with open(path, "rb") as stream:
        reader = make_reader(stream)
        assert sum(1 for _ in reader.iter_messages()) == result.message_count
        metadata = next(item.metadata for item in reader.iter_metadata() if item.name == "svmdist")
    assert {"scenario": "approach", "seed": "2", "profile": "psm13"}.items() <= metadata.items()
    with pytest.raises(UsageError):
        record(Recipe(SCENARIO, small), path)
    before = path.read_bytes()
    record(Recipe(SCENARIO, small), path, force=True)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_degraded_recording_is_compared_as_such(tmp_path: Path, small: Profile) -> None:
    """What `record --degrade` stores in the log's metadata is the group that `compare` puts the log in."""
    options = Options(degradations=(("smoke", 3), ("jpeg", 1)))
    result = record(Recipe(Scenario("approach", 2, 0.2, 5.0), small, options), tmp_path / "smoky.mcap")
    assert group_of(open_recording(result.path, small)) == Group("approach", "smoke=3,jpeg=1")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "noise", "options", "jpeg_quality"),
    [
        (Scenario("occlusion", 2, 1.0, 7.0), 0.0, Options(), None),
        (Scenario("contact", 2, 0.6, 5.0), 2.0, EVERYTHING, 90),
        (Scenario("contact", 2, 1.0, 9.0), 1.0, PRESSED, None),
    ],
    ids=["plain", "everything", "pressed"],
)
def test_any_number_of_processes_makes_the_same_file(
    tmp_path: Path,
    few_frames: None,
    small: Profile,
    scenario: Scenario,
    noise: float,
    options: Options,
    jpeg_quality: int | None,
) -> None:
    files = []
    for jobs in (1, 3):
        path = tmp_path / f"{jobs}.mcap"
        record(Recipe(scenario, small, options, noise, jpeg_quality), path, jobs=jobs)
        files.append(path.read_bytes())
    assert files[0] == files[1]
    assert multiprocessing.active_children() == []


@pytest.mark.slow
@POSIX
def test_a_killed_worker_is_one_line_and_no_file(tmp_path: Path, few_frames: None, small: Profile) -> None:
    killed: list[int] = []

    def kill_one(done: int, total: int) -> None:
        if done == 4 and not killed:
            killed.append(multiprocessing.active_children()[0].pid or 0)
            os.kill(killed[0], signal.SIGKILL)

    path = tmp_path / "log.mcap"
    with pytest.raises(SvmdistError, match=r"killed.*--jobs") as caught:
        record(Recipe(Scenario("sweep", 1, 20.0, 10.0), small), path, jobs=2, on_progress=kill_one)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []
    assert multiprocessing.active_children() == []


def test_an_error_while_drawing_ends_the_recording(
    tmp_path: Path, small: Profile, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise SimulationError("no such thing")

    monkeypatch.setattr("svmdist.simulation.plan.Arm.nominal_transforms", fail)
    with pytest.raises(SimulationError, match="no such thing"):
        record(Recipe(SCENARIO, small), tmp_path / "log.mcap", jobs=1)


@pytest.mark.slow
@POSIX
@pytest.mark.parametrize("number", [None, signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize(
    "command", [["--duration", "2.6", "-o", "log.mcap"], ["--episodes", "2", "--duration", "1"]]
)
def test_nothing_is_left_in_the_temporary_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals | None, command: list[str]
) -> None:
    """Whether the recording ended, or was ended together with its workers: not a file, not a process."""
    temporary, folder = tmp_path / "temporary", tmp_path / "here"
    temporary.mkdir()
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    process = subprocess.Popen(
        [sys.executable, "-m", "svmdist", "record", "--rate", "10", "-j", "2", *command],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    if number is not None:
        while process.poll() is None and not [p for p in folder.iterdir() if p.stat().st_size > 100_000]:
            time.sleep(0.02)
        process.send_signal(number)
    assert process.communicate(timeout=120)[0] == ""  # PyBullet's own chatter goes nowhere
    deadline = time.monotonic() + 10.0
    while number is not None and list(temporary.iterdir()) and time.monotonic() < deadline:
        time.sleep(0.1)  # workers notice that their parent was killed
    assert list(temporary.iterdir()) == []
    assert (process.returncode == 0) == (number is None)


FRAMES = 12


@pytest.mark.slow
@POSIX
@pytest.mark.parametrize("count", [4, pytest.param(200, marks=pytest.mark.fault)])
def test_whatever_ends_it_no_file_under_a_final_name_is_incomplete(tmp_path: Path, count: int) -> None:
    """KILL, TERM and INT at any time; what was recorded until then is in a `.part`."""
    rng, found, path = random.Random(count), set(), tmp_path / "log.mcap"
    for number in range(count):
        jobs = str(1 + number % 2)
        process = started(
            "record", "--duration", "1.2", "--rate", "10", "-j", jobs, "--force", "-o", str(path)
        )
        time.sleep(rng.uniform(0.0, 3.0))
        process.send_signal((signal.SIGKILL, signal.SIGTERM, signal.SIGINT)[number % 3])
        _, err = process.communicate(timeout=120)
        require_no_traceback(err)
        left = {file.name for file in tmp_path.iterdir()}
        assert left <= {"log.mcap", "log.mcap.part"}, left
        if path.exists():
            recording = open_recording(path, load_profile())
            assert len(list(recording.images())) == FRAMES
            assert recording.health.is_clean
        else:
            assert process.returncode != 0
        found.add("whole" if path.exists() else "part" if left else "nothing")
        path.unlink(missing_ok=True)
    if count > 50:
        assert {"whole", "part"} <= found, "the signals did not meet the recorder at work"

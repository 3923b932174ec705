"""Several processes make the file that one makes, and they end with it, whatever happens."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from svmdist.errors import SimulationError, UsageError
from svmdist.perturbations.chosen import parse_perturbations
from svmdist.profile import Profile, load_profile
from svmdist.simulation.scene import Extras
from svmdist.simulation.scenarios import Scenario
from tests.conftest import REPOSITORY

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.plan import Plan, make_plan
from svmdist.workflows import record_workers
from svmdist.workflows.record import record
from svmdist.workflows.workers import Worker

EVERYTHING = Extras(True, True, 1.0, (("smoke", 2), ("noise", 1)), 2, 0.0003)
PRESSED = Extras(True, perturbations=parse_perturbations("dent=2,interlace=1,breathing=1,shadow=1,rolling=5"))
LONG = """
import sys
from pathlib import Path
from svmdist.profile import load_profile
from svmdist.simulation.scenarios import Scenario
from svmdist.workflows.record import record
record(Scenario("sweep", 1, 600.0, 10.0), load_profile(), Path(sys.argv[1]), jobs=2)
"""


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
    monkeypatch.setattr(record_workers, "FRAMES_PER_WORKER", 1)


def children_of(process_id: int) -> list[int]:
    """The processes that a process has started."""
    tasks = Path(f"/proc/{process_id}/task").glob("*/children")
    return [int(child) for task in tasks for child in task.read_text().split()]


@pytest.mark.parametrize(
    ("scenario", "noise", "extras", "jpeg_quality"),
    [
        (Scenario("occlusion", 2, 1.0, 7.0), 0.0, Extras(), None),
        (Scenario("sweep", 2, 1.0, 7.0), 2.0, Extras(), None),
        (Scenario("contact", 2, 0.6, 5.0), 2.0, EVERYTHING, 90),
        (Scenario("contact", 2, 1.0, 9.0), 0.0, PRESSED, None),
    ],
    ids=["plain", "noise", "everything", "pressed"],
)
def test_any_number_of_processes_makes_the_same_file(
    tmp_path: Path,
    few_frames: None,
    small: Profile,
    scenario: Scenario,
    noise: float,
    extras: Extras,
    jpeg_quality: int | None,
) -> None:
    files = []
    for jobs in (1, 3):
        path = tmp_path / f"{jobs}.mcap"
        result = record(
            scenario, small, path, noise=noise, extras=extras, jpeg_quality=jpeg_quality, jobs=jobs
        )
        assert result.frame_count == scenario.frame_count
        files.append(path.read_bytes())
    assert files[0] == files[1]
    assert multiprocessing.active_children() == []


def test_processes_that_begin_anew_make_it_too(small: Profile) -> None:
    """Without fork, a worker gets the plan and nothing else."""
    plan = make_plan(Scenario("sweep", 1, 0.5, 8.0), small, noise=1.0)
    pool = record_workers._Pool(plan, 2, None, method="spawn")
    try:
        made = [pair for samples in pool.results() for pair in samples]
    finally:
        pool.close()
    assert made == list(record_workers.encoded_samples(plan, 1))


def test_short_recordings_have_few_processes(small: Profile, monkeypatch: pytest.MonkeyPatch) -> None:
    """A process takes as long to start as it takes for some images: below that there is none."""
    counts = []

    class Counted(record_workers._Pool):
        def __init__(self, plan: Plan, count: int, jpeg_quality: int | None) -> None:
            counts.append(count)
            super().__init__(plan, count, jpeg_quality)

    monkeypatch.setattr(record_workers, "_Pool", Counted)
    for frame_count in (4, 16, 20):
        plan = make_plan(Scenario("sweep", 1, frame_count / 20.0, 20.0), small)
        assert len(list(record_workers.encoded_samples(plan, 8))) > frame_count
    assert counts == [2, 2]


def test_a_killed_worker_is_one_line_and_no_file(
    tmp_path: Path, few_frames: None, small: Profile, monkeypatch: pytest.MonkeyPatch
) -> None:
    killed: list[int] = []

    def kill_one(done: int, total: int) -> None:
        if done == 4 and not killed:
            killed.append(multiprocessing.active_children()[0].pid or 0)
            os.kill(killed[0], signal.SIGKILL)

    path = tmp_path / "log.mcap"
    with pytest.raises(SimulationError, match=r"killed by signal 9.*--jobs") as caught:
        record(Scenario("sweep", 1, 20.0, 10.0), small, path, jobs=2, on_progress=kill_one)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []
    assert multiprocessing.active_children() == []


def test_a_worker_passes_its_error_on(
    tmp_path: Path, few_frames: None, small: Profile, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error of the first sample that cannot be made, as from one process."""

    def fail(*_: object) -> None:
        raise SimulationError("no such thing")

    monkeypatch.setattr("svmdist.simulation.arm.Arm.nominal_transforms", fail)  # the forks have it too
    with pytest.raises(SimulationError, match="no such thing"):
        record(Scenario("sweep", 1, 1.0, 10.0), small, tmp_path / "log.mcap", jobs=2)
    assert multiprocessing.active_children() == []


def test_what_a_worker_said_before_it_ended_is_told_when_it_gets_no_task(small: Profile) -> None:
    """A worker may fail, and be gone, before it is given anything: its reason counts, not that it is gone."""
    ours, theirs = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process()
    worker = Worker(process, ours)
    theirs.send(record_workers._Failed(SimulationError("no such thing")))
    theirs.close()
    pool = object.__new__(record_workers._Pool)
    pool._tasks, pool._noise_states = [()], None
    with pytest.raises(SimulationError, match="no such thing"):
        pool._give(worker, 0)


def test_no_process_outlives_a_killed_recorder(tmp_path: Path) -> None:
    """The recorder cannot end them any more: they notice."""
    target = tmp_path / "log.mcap"
    with subprocess.Popen([sys.executable, "-c", LONG, str(target)], cwd=REPOSITORY) as process:
        deadline = time.monotonic() + 60.0
        part = target.with_name("log.mcap.part")
        while not (part.exists() and part.stat().st_size > 100_000):
            assert process.poll() is None
            assert time.monotonic() < deadline, "the recorder does not start"
            time.sleep(0.02)
        workers = children_of(process.pid)
        process.kill()
    assert len(workers) == 2
    while any(Path(f"/proc/{worker}/fd").exists() and _is_alive(worker) for worker in workers):
        assert time.monotonic() < deadline, "a worker goes on alone"
        time.sleep(0.02)


def test_no_jobs_are_told(tmp_path: Path, small: Profile) -> None:
    with pytest.raises(UsageError, match="number of jobs is from 1, found 0"):
        record(Scenario("sweep"), small, tmp_path / "log.mcap", jobs=0)


def _is_alive(process_id: int) -> bool:
    """Whether a process is there and no zombie, which nobody may ever collect."""
    try:
        return Path(f"/proc/{process_id}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False

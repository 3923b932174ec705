"""A recorded scenario is one complete file, the same for any number of processes, and nothing is left beside it."""

import multiprocessing
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace

import pytest
from mcap.reader import make_reader

from svmdist.errors import SvmdistError, UsageError
from svmdist.perturbations import parse_perturbations
from svmdist.profile import Profile, load_profile
from svmdist.recording.log import open_recording
from svmdist.simulation.motion import Scenario
from svmdist.simulation.scene import Options
from tests.conftest import started
from tests.reading import read_images

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.workflows import record as record_module
from svmdist.workflows.record import Recipe, episode_paths, record

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="needs signals as POSIX has them")
SCENARIO = Scenario("approach", 2, 0.4, 5.0)
EVERYTHING = Options(True, True, 1.0, (("smoke", 2), ("noise", 1)), 2)
PRESSED = Options(True, perturbations=parse_perturbations("dent=2,interlace=1,breathing=1,shadow=1"))


@pytest.fixture(scope="module")
def small() -> Profile:
    """The profile with a camera of few pixels."""
    profile = load_profile()
    simulation = profile.simulation.model_copy(update={"width_px": 96, "height_px": 72})
    return profile.model_copy(update={"simulation": simulation})


@pytest.fixture
def few_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let short recordings have workers."""
    monkeypatch.setattr(record_module, "FRAMES_PER_WORKER", 1)


def test_recording_is_complete_repeatable_and_never_replaced(tmp_path, small):
    path, progress = tmp_path / "approach.mcap", []
    result = record(Recipe(SCENARIO, small), path, on_progress=lambda *counts: progress.append(counts))
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
    tmp_path, few_frames, small, scenario, noise, options, jpeg_quality
):
    files = []
    for jobs in (1, 3):
        path = tmp_path / f"{jobs}.mcap"
        record(Recipe(scenario, small, replace(options, noise=noise), jpeg_quality), path, jobs=jobs)
        files.append(path.read_bytes())
    assert files[0] == files[1]
    assert multiprocessing.active_children() == []


@pytest.mark.slow
@POSIX
def test_a_killed_worker_is_one_line_and_no_file(tmp_path, few_frames, small):
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


def test_names_of_episodes(tmp_path):
    paths = episode_paths(tmp_path / "out", "sweep", 7, 3)
    assert [path.name for path in paths] == ["sweep-7.mcap", "sweep-8.mcap", "sweep-9.mcap"]
    assert (tmp_path / "out").is_dir()
    paths = episode_paths(tmp_path / "{seed}" / "run-{episode}.mcap", "sweep", 7, 10)
    assert [str(path.relative_to(tmp_path)) for path in paths[::9]] == ["7/run-01.mcap", "16/run-10.mcap"]
    with pytest.raises(UsageError, match="is one name for 3 episodes"):
        episode_paths(tmp_path / "a.mcap", "sweep", 7, 3)


def test_episodes_are_what_record_writes(cli, tmp_path):
    """In a real world that is drawn by each seed; those that are there are left, others are refused."""
    common = ["--duration", "0.2", "--rate", "5", "--world", "real", "--jpeg", "80"]
    folder = tmp_path / "episodes"
    done = cli("record", "--episodes", "2", "--seed", "5", *common, "-o", folder, "--jobs", "2")
    assert "2 of 2 recordings: 2 frames" in done.err
    cli("record", "--seed", "6", *common, "-o", tmp_path / "one.mcap")
    assert (folder / "sweep-6.mcap").read_bytes() == (tmp_path / "one.mcap").read_bytes()
    three = ("record", "--episodes", "3", "--seed", "5", *common, "-o", folder)
    assert "sweep-5.mcap exists; --skip-existing" in cli(*three, code=2).err
    before = (folder / "sweep-6.mcap").stat().st_mtime_ns
    (folder / "sweep-7.mcap.part").write_text("left by one that was killed")
    assert "3 of 3 recordings, 2 of them were there" in cli(*three, "--skip-existing").err
    assert (folder / "sweep-6.mcap").stat().st_mtime_ns == before
    assert sorted(path.name for path in folder.iterdir()) == [f"sweep-{seed}.mcap" for seed in (5, 6, 7)]
    other = cli(*three, "--skip-existing", "--noise", "3", code=1)
    assert "sweep-5.mcap: is another recording: noise differ" in other.err


FRAMES = 12


@pytest.mark.slow
@POSIX
@pytest.mark.parametrize("count", [4, pytest.param(200, marks=pytest.mark.fault)])
def test_whatever_ends_it_no_file_under_a_final_name_is_incomplete(tmp_path, count):
    """KILL, TERM and INT at any time; what was recorded until then is in a `.part`."""
    rng, found, path = random.Random(count), set(), tmp_path / "log.mcap"
    common = ("--duration", 1.2, "--rate", 10, "--force", "-o", path)
    began_s = time.monotonic()
    with started("record", *common, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as whole:
        whole.communicate()
    lasts_s = time.monotonic() - began_s  # on this machine, as busy as it is
    path.unlink()
    for number in range(count):
        options = (*common, "-j", 1 + number % 2)
        with started("record", *options, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
            time.sleep(rng.uniform(0.0, 1.5 * lasts_s))
            process.send_signal((signal.SIGKILL, signal.SIGTERM, signal.SIGINT)[number % 3])
            _, err = process.communicate()
        # An interrupt may find Python itself still starting, which prints where it was.
        assert "Traceback" not in err or "/svmdist/" not in err, err
        left = {file.name for file in tmp_path.iterdir()}
        assert left <= {"log.mcap", "log.mcap.part"}, left
        if path.exists():
            recording = open_recording(path, load_profile())
            assert len(list(read_images(recording))) == FRAMES
            assert recording.health.is_clean
        else:
            assert process.returncode != 0
        found.add("whole" if path.exists() else "part" if left else "nothing")
        path.unlink(missing_ok=True)
    if count > 50:
        assert {"whole", "part"} <= found, "the signals did not meet the recorder at work"

"""`svmdist record`, ended by KILL, TERM and INT at any time: nothing stands under a final name that is not whole."""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from pathlib import Path

import pytest

from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from tests.cli.running import require_no_traceback, started

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs signals as POSIX has them")
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
FRAMES = 12


def recorded_whole(path: Path) -> bool:
    """Whether a log is all that `record` would have written."""
    recording = open_recording(path, load_profile())
    return len(list(recording.images())) == FRAMES and recording.health.is_clean


def end_one(folder: Path, number: signal.Signals, after_s: float, jobs: int) -> str:
    """Start a recorder, end it after a while, and see what it left; tells how far it was."""
    path = folder / "log.mcap"
    command = ["record", "--duration", "1.2", "--rate", "10", "-j", str(jobs), "--force", "-o", str(path)]
    process = started(*command)
    time.sleep(after_s)
    process.send_signal(number)
    _, err = process.communicate(timeout=120)
    require_no_traceback(err)
    left = {file.name for file in folder.iterdir()}
    assert left <= {"log.mcap", "log.mcap.part"}, left
    if path.exists():
        assert recorded_whole(path)
    if process.returncode == 0:
        assert path.exists()
    elif number is not signal.SIGKILL and "log.mcap.part" in left and f"{path}.part" not in err:
        # It may be one that an earlier recorder left, which ended before it came to its file.
        assert not (folder / "log.mcap.part").stat().st_size or err.strip()
    what = "whole" if path.exists() else "part" if left else "nothing"
    if path.exists():
        os.unlink(path)
    return what


@pytest.mark.parametrize("count", [4, pytest.param(200, marks=pytest.mark.fault)])
def test_kills_of_record(tmp_path: Path, count: int) -> None:
    pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
    rng = random.Random(count)
    found = [
        end_one(tmp_path, SIGNALS[number % 3], rng.uniform(0.0, 3.0), 1 + number % 2)
        for number in range(count)
    ]
    if count > 50:
        assert {"whole", "part"} <= set(found), "the signals did not meet the recorder at work"

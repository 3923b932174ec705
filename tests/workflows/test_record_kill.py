"""A recorder that is killed leaves a `.part` file that holds all but the last moment of what it had produced.

What had been produced is known from the recorder itself: before each sample is handed to the writer, its number
and stamp are written straight to a second file, with no buffer in between. Nothing that the recorder had in its
hands when it was killed can be missing from that list, so that the loss is measured, not estimated.
"""

import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.recording.source import LossKind
from tests.conftest import REPOSITORY

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")

CHUNK_LOSS_NS = 520_000_000
"""The open chunk, and one that was on its way to the file; 260 ms each. A second is promised."""
SYNTHETIC = """
import os, sys, time
from pathlib import Path
from svmdist.recording.writer import RecordingWriter
from tests.synthetic import make_scene, samples
target, pause_s = Path(sys.argv[1]), float(sys.argv[2])
progress = os.open(target.with_suffix(".progress"), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
with RecordingWriter(target, {"scenario": "killed"}) as writer:
    for number, (topic, sample) in enumerate(samples(make_scene(160, 120), 100_000)):
        os.write(progress, f"{number} {sample.stamp_ns}\\n".encode())
        writer.write(topic, sample)
        time.sleep(pause_s)
"""


@dataclass(frozen=True)
class Produced:
    """Samples that a recorder had made when it was killed: how many, the first and the newest stamp."""

    count: int
    first_ns: int
    newest_ns: int


def kill_recorder(script: str, target: Path, after_s: float, *arguments: object) -> Produced:
    """Start a recorder, kill it after a while of recording, and tell what it had produced."""
    command = [sys.executable, "-c", script, str(target), *map(str, arguments)]
    process = subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    progress = target.with_suffix(".progress")
    try:
        deadline = time.monotonic() + 60.0
        while not progress.exists() or not progress.stat().st_size:
            assert process.poll() is None, process.stderr.read() if process.stderr else ""
            assert time.monotonic() < deadline, "the recorder does not start"
            time.sleep(0.002)
        time.sleep(after_s)
        assert process.poll() is None, "the recorder came to its end before it was killed"
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
    stamps_ns = [int(line.split()[1]) for line in progress.read_text().splitlines()]
    return Produced(len(stamps_ns), stamps_ns[0], max(stamps_ns))


def check_what_is_left(target: Path, produced: Produced) -> int:
    """The `.part` is a readable prefix; gives the log time that is missing, in ns."""
    assert not target.exists()
    part = open_recording(target.with_name(target.name + ".part"), load_profile())
    stamps_ns = [raw.log_time_ns for raw in part.file.source.messages()]
    assert len(stamps_ns) <= produced.count
    if len(stamps_ns) < produced.count:
        assert {loss.kind for loss in part.health.losses} == {LossKind.TRUNCATED}
        assert len(part.health.describe()) == 1
    newest_ns = max(stamps_ns, default=produced.first_ns)
    assert newest_ns <= produced.newest_ns
    return produced.newest_ns - newest_ns


@pytest.mark.parametrize(
    ("count", "max_s", "pause_s"),
    [(2, 0.6, 0.0), (2, 0.6, 0.0005), pytest.param(50, 2.0, 0.0, marks=pytest.mark.fault)],
)
def test_a_killed_writer_loses_less_than_a_second(tmp_path, count, max_s, pause_s):
    """As fast as it can, and slowly, killed at random times."""
    rng = random.Random(count)
    for number in range(count):
        target = tmp_path / f"{number}.mcap"
        produced = kill_recorder(SYNTHETIC, target, rng.uniform(0.0, max_s), pause_s)
        assert check_what_is_left(target, produced) <= CHUNK_LOSS_NS

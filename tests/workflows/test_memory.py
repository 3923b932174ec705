"""Memory: one frame at a time, however long the log is; and of a joint state, its numbers."""

import gc
import subprocess
import sys
import tracemalloc
from pathlib import Path

import pytest

from svmdist.estimation.plane_mapping import PUBLISHED_MAPPING
from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.samples import JointSample
from svmdist.workflows.estimate import estimate
from svmdist.workflows.request import Setup
from tests.shipped import CHAIN, POSTURE
from tests.synthetic import write_log, write_samples


def _peak_bytes(path: Path) -> int:
    """Peak of what Python and NumPy allocate while every result is made and dropped, by one worker."""
    setup = Setup(load_profile(), "overlay", "corrected", None, PUBLISHED_MAPPING)
    gc.collect()
    tracemalloc.start()
    try:
        for result in estimate(open_recording(path, setup.profile), setup, jobs=1):
            assert result.stamp_ns
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_memory_does_not_grow_with_the_log(tmp_path):
    """Eight times the frames, and a peak that is no more than one frame higher.

    The least of three: what the collector frees late is no part of it, and comes at any time.
    """
    logs = [write_log(tmp_path / f"{count}.mcap", frame_count=count) for count in (10, 80)]
    _peak_bytes(logs[0])  # what is imported and cached on first use
    short, long = (min(_peak_bytes(path) for _ in range(3)) for path in logs)
    assert long < short + 640 * 480 * 3


FK = """
import sys
from svmdist.cli.main import run
sys.argv = ["svmdist", "fk", sys.argv[1], "-o", "/dev/null"]
try:
    run()
except SystemExit as end:
    assert not end.code, end.code
print(next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM:")) >> 10)
"""


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads its peak memory from /proc")
def test_a_joint_state_takes_few_bytes(tmp_path):
    """A joint state is kept as its numbers, and poses are computed block by block: 300 bytes each at most."""
    count = 300_000
    states = (JointSample(number * 1_000_000, CHAIN.joint_names, POSTURE) for number in range(count))
    path = write_samples(tmp_path / "joints.mcap", (("/PSM1/measured_js", state) for state in states))
    done = subprocess.run([sys.executable, "-c", FK, path], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) <= 102 + 300 * count / 1e6

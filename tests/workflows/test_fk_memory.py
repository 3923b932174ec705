"""`fk` on a log of any length: what it keeps of a joint state is its numbers."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from svmdist.recording.writer import RecordingWriter
from svmdist.samples import JointSample
from tests.shipped import CHAIN, POSTURE

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


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads its peak memory from /proc")
@pytest.mark.parametrize("count", [60_000, pytest.param(300_000, marks=pytest.mark.slow)])
def test_a_joint_state_takes_few_bytes(tmp_path: Path, count: int) -> None:
    """A joint state is kept as its numbers, and poses are computed block by block: 300 bytes each at most."""
    path = tmp_path / "joints.mcap"
    with RecordingWriter(path, {}) as writer:
        for number in range(count):
            writer.write("/PSM1/measured_js", JointSample(number * 1_000_000, CHAIN.joint_names, POSTURE))
    done = subprocess.run([sys.executable, "-c", FK, path], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) <= 102 + 300 * count / 1e6

"""Several recorders of one name at a time: whoever ends with 0 has left a whole log."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from svmdist.errors import UsageError
from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.recording.writer import RecordingWriter
from svmdist.samples import DistanceSample

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="a file that is open cannot be replaced there"
)

WRITE = """
import sys
from pathlib import Path
from svmdist.errors import UsageError
from svmdist.recording.writer import RecordingWriter
from svmdist.samples import DistanceSample
path, who, count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
print("ready", flush=True)
sys.stdin.readline()
try:
    with RecordingWriter(path, {"who": str(who)}, force=True) as writer:
        for number in range(count):
            writer.write("/distance", DistanceSample(number * 10_000_000, float(who), 0.0, 0.0))
except UsageError as problem:
    assert "another process is recording to it" in str(problem), problem
    sys.exit(2)
"""


def test_one_of_those_that_begin_together_writes(tmp_path: Path) -> None:
    """Six recorders of different lengths: the log that is there at the end is whole, and of one that ended with 0."""
    path = tmp_path / "log.mcap"
    for _ in range(3):
        recorders = [
            subprocess.Popen(
                [sys.executable, "-c", WRITE, path, str(who), str(1000 * (who + 1))],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            for who in range(6)
        ]
        for recorder in recorders:
            assert recorder.stdout is not None
            assert recorder.stdout.readline() == "ready\n"
        for recorder in recorders:
            assert recorder.stdin is not None
            recorder.stdin.write("\n")
            recorder.stdin.flush()
        for recorder in recorders:
            recorder.communicate()
        codes = [recorder.returncode for recorder in recorders]
        assert set(codes) <= {0, 2}
        assert 0 in codes
        log = open_recording(path, load_profile())
        who = int(log.metadata["who"])
        assert codes[who] == 0
        track = log.distance_track()
        assert len(track.stamps_ns) == 1000 * (who + 1)
        assert set(track.planar_m) == {float(who)}
        assert log.health.is_clean
        assert list(tmp_path.iterdir()) == [path]


def test_the_second_recorder_is_told_of_the_first(tmp_path: Path) -> None:
    """With --force or without: the part that another process writes is not touched."""
    path = tmp_path / "log.mcap"
    with RecordingWriter(path, {}) as first:
        first.write("/distance", DistanceSample(0, 1.0, 1.0, 1.0))
        for force in (False, True):
            with pytest.raises(UsageError, match="another process is recording to it"):
                RecordingWriter(path, {}, force=force).__enter__()
    assert open_recording(path, load_profile()).distance_track().planar_m.tolist() == [1.0]

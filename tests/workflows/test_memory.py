"""Replaying a log holds one frame at a time, however long the log is."""

from __future__ import annotations

import gc
import tracemalloc
from pathlib import Path

import pytest

from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.workflows.calibrate import PIXELS_AS_THEY_ARE
from svmdist.workflows.estimate import estimate
from svmdist.workflows.request import Setup
from tests.synthetic import write_log


def _peak_bytes(path: Path) -> int:
    """Peak of what Python and NumPy allocate while every result is made and dropped, by one worker.

    The least of three: what the collector frees late is no part of it, and comes at any time.
    """
    return min(_once_bytes(path) for _ in range(3))


def _once_bytes(path: Path) -> int:
    setup = Setup(load_profile(), "overlay", "corrected", None, PIXELS_AS_THEY_ARE)
    gc.collect()
    tracemalloc.start()
    try:
        for result in estimate(open_recording(path, setup.profile), setup, jobs=1):
            assert result.stamp_ns
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_memory_does_not_grow_with_the_log(tmp_path: Path) -> None:
    """Eight times the frames, and a peak that is no more than one frame higher."""
    short, long = (write_log(tmp_path / f"{n}.mcap", frame_count=n) for n in (10, 80))
    _peak_bytes(short)  # what is imported and cached on first use
    one_frame = 640 * 480 * 3
    assert _peak_bytes(long) < _peak_bytes(short) + one_frame

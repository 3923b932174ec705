"""Benchmarks of reading: `uv run pytest tests/benchmarks --benchmark-enable --benchmark-group-by=group`.

Everything is for the same 80 frames, so that the ratios within one run tell what reading costs beside decoding.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import cv2
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from svmdist.profile import Profile, load_profile
from svmdist.recording.encoded import EVERYTHING, LEFT_IMAGES, Decoded, Needs
from svmdist.recording.reader import Recording, open_recording

FRAMES = 80
AHEAD = 4
LOGS = {"mono PNG": "sweep.mcap", "stereo JPEG, two arms": "3d/duo.mcap"}
NEEDS = {"left images": LEFT_IMAGES, "everything": EVERYTHING}


@pytest.fixture(scope="module")
def profile() -> Profile:
    """The profile of the golden logs."""
    return load_profile()


@pytest.fixture(params=LOGS)
def recording(request: pytest.FixtureRequest, golden: Path, profile: Profile) -> Recording:
    """A golden log whose cameras are known already."""
    log = open_recording(golden / LOGS[request.param], profile)
    _ = log.camera, log.right_camera
    return log


@pytest.mark.benchmark(group="reading 80 frames")
def test_messages(benchmark: BenchmarkFixture, recording: Recording) -> None:
    """Framing, decompression, CRCs: every message of the file, none decoded."""
    assert benchmark(lambda: sum(1 for _ in recording.raw_messages())) > FRAMES


@pytest.mark.benchmark(group="reading 80 frames")
@pytest.mark.parametrize("needs", NEEDS)
def test_encoded_observations(benchmark: BenchmarkFixture, recording: Recording, needs: str) -> None:
    """The same, and what belongs to each image: all that the reading thread does."""
    names = recording.instruments
    assert benchmark(lambda: sum(1 for _ in recording.encoded_observations(names, NEEDS[needs]))) == FRAMES


@pytest.mark.benchmark(group="reading 80 frames")
@pytest.mark.parametrize("needs", NEEDS)
def test_observations(benchmark: BenchmarkFixture, recording: Recording, needs: str) -> None:
    """The same, and the images decoded one after another."""
    names = recording.instruments
    assert benchmark(lambda: sum(1 for _ in recording.observations_of(names, NEEDS[needs]))) == FRAMES


@pytest.mark.benchmark(group="reading 80 frames")
@pytest.mark.parametrize("threads", [1, 2])
def test_decoding_ahead(benchmark: BenchmarkFixture, recording: Recording, threads: int) -> None:
    """The same with images decoded in threads, a few ahead: wall time, which depends on idle cores."""
    opencv_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        assert benchmark(lambda: sum(1 for _ in _ahead(recording, EVERYTHING, threads))) == FRAMES
    finally:
        cv2.setNumThreads(opencv_threads)


def _ahead(recording: Recording, needs: Needs, threads: int) -> Iterator[object]:
    waiting: deque[Future[Decoded]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        for encoded in recording.encoded_observations(recording.instruments, needs):
            waiting.append(pool.submit(encoded.decode))
            if len(waiting) > AHEAD:
                yield recording.record_losses(waiting.popleft().result())
        while waiting:
            yield recording.record_losses(waiting.popleft().result())

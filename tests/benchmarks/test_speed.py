"""Benchmarks: run them with `uv run pytest tests/benchmarks --benchmark-enable --benchmark-group-by=group`.

They print ratios to compare within one run; nothing here fails for being slow, since machines are noisy.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from svmdist.kinematics.dh import chain_of, forward_kinematics
from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.workflows.estimate import estimate
from svmdist.workflows.request import Setup, prepare

FRAMES = 80


@pytest.fixture(scope="module")
def setup() -> Setup:
    """The paper's method."""
    return prepare()


@pytest.mark.benchmark(group="replay of 80 frames")
def test_reading_without_decoding(benchmark: BenchmarkFixture, golden: Path, setup: Setup) -> None:
    """Read the log's joint states: framing, decompression and CRCs of everything, no image decoded."""
    track = benchmark(lambda: open_recording(golden / "sweep.mcap", setup.profile).joint_track())
    assert len(track.stamps_ns) > FRAMES


@pytest.mark.benchmark(group="replay of 80 frames")
def test_reading_and_decoding(benchmark: BenchmarkFixture, golden: Path, setup: Setup) -> None:
    """Read the log and decode its images: what an estimator that does nothing would cost."""
    count = benchmark(lambda: sum(1 for _ in open_recording(golden / "sweep.mcap", setup.profile).images()))
    assert count == FRAMES


@pytest.mark.benchmark(group="replay of 80 frames")
@pytest.mark.parametrize("method", ["overlay", "centroid"])
def test_estimate(benchmark: BenchmarkFixture, golden: Path, method: str) -> None:
    """Estimate every frame; divide by the decoding above for the cost of the method itself."""
    chosen = prepare(method=method)

    def replay() -> int:
        recording = open_recording(golden / "sweep.mcap", chosen.profile)
        return sum(row.measured for row in estimate(recording, chosen))

    benchmark.extra_info["frames"] = FRAMES
    assert benchmark(replay) == FRAMES


@pytest.mark.benchmark(group="kinematics of 1e5 joint vectors")
@pytest.mark.parametrize("profile", ["psm13", "dvrk-psm"])
def test_forward_kinematics(benchmark: BenchmarkFixture, profile: str) -> None:
    """DH kinematics of 100,000 joint vectors at once."""
    robot = load_profile(profile).robot
    assert robot is not None
    chain = chain_of(robot)
    q = np.random.default_rng(0).uniform(chain.lower, chain.upper, (100_000, len(chain.joint_names)))
    assert benchmark(forward_kinematics, chain, q).shape == (100_000, 4, 4)


@pytest.mark.benchmark(group="kinematics of 1e5 joint vectors")
def test_forward_kinematics_one_by_one(benchmark: BenchmarkFixture) -> None:
    """The same chain for a thousand vectors in a loop: times 100 is what vectorising saves."""
    robot = load_profile().robot
    assert robot is not None
    chain = chain_of(robot)
    q = np.random.default_rng(0).uniform(chain.lower, chain.upper, (1000, len(chain.joint_names)))
    poses = benchmark(lambda: [forward_kinematics(chain, row) for row in q])
    assert len(poses) == 1000

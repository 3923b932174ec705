"""Damage of every kind: cut files, flipped bits, structural mutants. Nothing wrong, nothing lost in silence."""

import random
import resource
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from svmdist.errors import SvmdistError
from svmdist.profile import Profile
from svmdist.recording.log import open_recording
from svmdist.recording.source import LossKind
from svmdist.samples import Observation
from tests.reading import read_observations

from .builders import COMPRESSIONS, rewrite, scene, write_scene
from .faults import Reading, chunks, flip_bit, is_subsequence, mutate, read


@dataclass(frozen=True)
class Intact:
    """A recording before it is broken."""

    data: bytes
    reading: Reading


@pytest.fixture(scope="module", params=sorted(COMPRESSIONS))
def small(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Intact:
    """A few frames in several chunks, by compression."""
    return make_intact(tmp_path_factory.mktemp("small"), request.param)


def make_intact(folder: Path, compression: str, *, data_crc: bool = True) -> Intact:
    """Write a scene of three frames with a compression, and read it once."""
    native = write_scene(folder / "native.mcap", scene(3))
    path = rewrite(native, folder / "intact.mcap", compression, chunk_size=3000, data_crc=data_crc)
    reading = read(path)
    assert reading.is_clean
    assert len(reading.messages) == 30
    return Intact(path.read_bytes(), reading)


def chunk_ends(data: bytes) -> list[tuple[int, int]]:
    """End of every chunk in the file, and the number of messages in it."""
    return [(part.end, count) for part, count in chunks(data)]


def check_cut(intact: Intact, ends: list[tuple[int, int]], size_bytes: int, path: Path) -> None:
    """All complete chunks come back, what comes back is an exact prefix, and the loss is told."""
    path.write_bytes(intact.data[:size_bytes])
    reading = read(path)
    if reading is None:
        assert size_bytes <= 8
        return
    certain = sum(count for end, count in ends if end <= size_bytes)
    assert len(reading.messages) >= certain, size_bytes
    assert reading.messages == intact.reading.messages[: len(reading.messages)], size_bytes
    assert LossKind.TRUNCATED in reading.kinds, size_bytes
    assert reading.metadata in (intact.reading.metadata, {}), size_bytes


@pytest.mark.parametrize("step", [211, pytest.param(1, marks=pytest.mark.fault)])
def test_truncation_of_a_small_log(small, tmp_path, step):
    ends = chunk_ends(small.data)
    near_ends = [end + beside for end, _ in ends for beside in (-1, 0, 1)]
    for size_bytes in [*range(40), *range(40, len(small.data), step), *near_ends, len(small.data) - 1]:
        check_cut(small, ends, size_bytes, tmp_path / "cut.mcap")


def flipped(intact: Intact, path: Path, count: int, seed: int) -> Iterator[Reading]:
    """What is read of files with one flipped bit each, where they are not refused; no message is another one."""
    rng = random.Random(seed)
    for number in range(count):
        path.write_bytes(flip_bit(intact.data, rng))
        reading = read(path)
        if reading is not None:
            assert is_subsequence(reading.messages, intact.reading.messages), number
            yield reading


@pytest.mark.parametrize("count", [300, pytest.param(10_000, marks=pytest.mark.fault)])
def test_flipped_bits_give_no_wrong_value_and_no_silent_loss(small, tmp_path, count):
    for reading in flipped(small, tmp_path / "flipped.mcap", count, 2):
        assert not reading.is_clean
        assert reading.metadata in (small.reading.metadata, {})


@pytest.mark.parametrize("count", [200, pytest.param(5_000, marks=pytest.mark.fault)])
def test_flipped_bits_without_a_crc_of_the_data_section(tmp_path, count):
    """Other recorders write none: chunks still protect their messages, and no loss of one is silent."""
    intact = make_intact(tmp_path, "zstd", data_crc=False)
    for reading in flipped(intact, tmp_path / "flipped.mcap", count, 3):
        assert len(reading.messages) == len(intact.reading.messages) or not reading.is_clean


@pytest.mark.parametrize("count", [300, pytest.param(7_000, marks=pytest.mark.fault)])
def test_structural_mutants_end_in_a_result_or_a_clear_error(small, tmp_path, profile, count):
    """Three compressions make 21,000 mutants in the long form, each read through the whole facade.

    Each takes milliseconds; one that took 5 s of the processor would all but hang.
    """
    rng = random.Random(4)
    path = tmp_path / "mutant.mcap"
    peak_before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for number in range(count):
        path.write_bytes(mutate(small.data, rng))
        started_s = time.process_time()
        read_everything(path, profile)
        assert time.process_time() - started_s < 5.0, number
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak_before_kib < 1 << 20  # 1 GiB


def read_everything(path: Path, profile: Profile) -> None:
    """Do all that can be done with a recording; only errors of svmdist's own may come out."""
    with suppress(SvmdistError):
        recording = open_recording(path, profile)
        for action in (
            lambda: recording.metadata,
            recording.joint_track,
            recording.distance_track,
            recording.pose_track,
            lambda: recording.transform_track("camera", "tool"),
            lambda: recording.transform_track("camera", "tool", ground_truth=True),
            lambda: [isinstance(item, Observation) for item in read_observations(recording)],
        ):
            with suppress(SvmdistError):
                action()
        assert all("\n" not in line for line in recording.health.describe())

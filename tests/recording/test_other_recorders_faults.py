"""Broken logs of other recorders: a result, a counted loss or a clear error, and nothing else."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import StoragePlugin

from svmdist.profile import Limits, Profile
from svmdist.recording.images import ImageError
from svmdist.recording.messages import KINDS, DecodeError, Decoder, EncodedImage
from svmdist.recording.source import RawMessage

from .builders import scene
from .faults import mutate_body
from .other_recorders import ros_messages, write_ros2_mcap, write_rosbag1, write_rosbag2
from .test_faults import read_everything

LOGS: dict[str, Callable[[Path], Path]] = {
    "bag": lambda folder: write_rosbag1(folder / "a.bag", ros_messages(scene(3))),
    "bag bz2": lambda folder: write_rosbag1(
        folder / "a.bag", ros_messages(scene(3)), Bag1Writer.CompressionFormat.BZ2
    ),
    "bag lz4": lambda folder: write_rosbag1(
        folder / "a.bag", ros_messages(scene(3)), Bag1Writer.CompressionFormat.LZ4
    ),
    "db3": lambda folder: next(
        write_rosbag2(folder / "a", ros_messages(scene(3)), StoragePlugin.SQLITE3).glob("*.db3")
    ),
    "ros2": lambda folder: write_ros2_mcap(folder / "a.mcap", ros_messages(scene(3))),
}


@pytest.mark.parametrize("count", [150, pytest.param(4000, marks=pytest.mark.fault)])
@pytest.mark.parametrize("kind", LOGS)
def test_mutants_of_other_recorders_logs(tmp_path: Path, profile: Profile, kind: str, count: int) -> None:
    rng = random.Random(6)
    data = LOGS[kind](tmp_path).read_bytes()
    path = tmp_path / "mutant"
    for number in range(count):
        mutant = data
        for _ in range(rng.choice((1, 1, 3))):
            start = rng.randrange(len(mutant))
            end = min(len(mutant), start + rng.choice((8, 64, 512)))
            mutant = mutant[:start] + mutate_body(mutant[start:end], rng) + mutant[end:]
        path.write_bytes(mutant if rng.random() < 0.8 else mutant[: rng.randrange(1, len(mutant))])
        started_s = time.process_time()
        read_everything(path, profile)
        assert time.process_time() - started_s < 5.0, number


def decode_anything(raw: RawMessage) -> None:
    """Decode a message with all its pixels; only the two expected errors may come out."""
    with suppress(DecodeError, ImageError):
        sample = Decoder(Limits()).decode(raw)
        if isinstance(sample, EncodedImage):
            sample.decode()


ALL_SCHEMAS = [(encoding, schema) for encoding, schemas in KINDS.items() for schema in schemas]


@settings(max_examples=300)
@given(st.sampled_from(ALL_SCHEMAS), st.binary(max_size=200), st.integers(0, 2**64 - 1))
def test_random_bytes_as_any_message(kind: tuple[str, str], data: bytes, log_time_ns: int) -> None:
    decode_anything(RawMessage("/t", kind[1], kind[0], log_time_ns, data))
    decode_anything(RawMessage("/t", kind[1], kind[0], log_time_ns, b"\0\1\0\0" + data))

"""ROS 1 bags: every message in file order, and a loss for whatever is missing."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from rosbags.rosbag1 import Writer

from svmdist.errors import RecordingError
from svmdist.profile import Limits
from svmdist.recording.rosbag.bag1_records import MAGIC, OP_CONNECTION, OP_MESSAGE
from svmdist.recording.rosbag.bag1_source import Rosbag1Source
from svmdist.recording.source import LossKind
from tests.recording.builders import Entry, scene
from tests.recording.other_recorders import Message, ros_messages, write_rosbag1

from .test_bag1_records import fields_bytes, record_bytes

Format = Writer.CompressionFormat
LIMITS = Limits()


@pytest.fixture(scope="module")
def messages(entries: list[Entry]) -> list[Message]:
    """The scene as ROS has it."""
    return ros_messages(entries)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory, messages: list[Message]) -> Path:
    """The scene as a bag without compression."""
    return write_rosbag1(tmp_path_factory.mktemp("bag1") / "a.bag", messages)


def delivered(source: Rosbag1Source) -> list[tuple[str, int]]:
    """Topic and log time of every message."""
    return [(raw.topic, raw.log_time_ns) for raw in source.messages()]


@pytest.mark.parametrize("compression", [None, Format.BZ2, Format.LZ4], ids=["none", "bz2", "lz4"])
def test_every_message_is_delivered_in_file_order(
    tmp_path: Path, messages: list[Message], compression: Format | None
) -> None:
    source = Rosbag1Source(write_rosbag1(tmp_path / "a.bag", messages, compression), LIMITS)
    assert delivered(source) == [(topic, time_ns) for topic, _, _, time_ns in messages]
    assert source.health.is_clean
    assert source.metadata() == {}


def test_topics_are_counted_and_chosen(bag: Path, messages: list[Message]) -> None:
    source = Rosbag1Source(bag, LIMITS)
    counts = {info.topic: info.message_count for info in source.topics()}
    assert counts == {
        topic: sum(each[0] == topic for each in messages) for topic in {each[0] for each in messages}
    }
    assert {info.message_encoding for info in source.topics()} == {"ros1"}
    assert {raw.topic for raw in source.messages({"/tf"})} == {"/tf"}


@pytest.mark.parametrize("part", [0.2, 0.5, 0.8])
def test_of_a_truncated_bag_the_first_messages_are_delivered(
    tmp_path: Path, bag: Path, messages: list[Message], part: float
) -> None:
    data = bag.read_bytes()
    path = tmp_path / "a.bag"
    path.write_bytes(data[: int(part * len(data))])
    source = Rosbag1Source(path, LIMITS)
    found = delivered(source)
    assert 0 < len(found) < len(messages)
    assert found == [(topic, time_ns) for topic, _, _, time_ns in messages[: len(found)]]
    (loss,) = source.health.losses
    assert (loss.kind, loss.byte_offset) == (LossKind.TRUNCATED, len(data[: int(part * len(data))]))
    assert loss.detail == f"{len(found)} messages recovered"


def connection(key: int, topic: bytes) -> bytes:
    """A connection record."""
    fields = {b"op": bytes([OP_CONNECTION]), b"conn": struct.pack("<I", key), b"topic": topic}
    return record_bytes(fields, fields_bytes({b"type": b"sensor_msgs/JointState"}))


def message(key: int, seconds: int) -> bytes:
    """A message record."""
    time = struct.pack("<II", seconds, 0)
    return record_bytes({b"op": bytes([OP_MESSAGE]), b"conn": struct.pack("<I", key), b"time": time}, b"data")


def test_a_connection_that_is_missing_or_means_two_topics_is_a_loss(tmp_path: Path) -> None:
    """The first meaning stays; `losses_before` grows where messages may be missing."""
    path = tmp_path / "a.bag"
    parts = [connection(1, b"/a"), message(1, 1), message(2, 2), connection(1, b"/b"), message(1, 3)]
    path.write_bytes(MAGIC + b"".join(parts))
    source = Rosbag1Source(path, LIMITS)
    found = [(raw.topic, raw.log_time_ns // 10**9, raw.losses_before) for raw in source.messages()]
    assert found == [("/a", 1, 0), ("/a", 3, 2)]
    undefined, double, end = source.health.losses
    assert (undefined.kind, double.kind, end.kind) == (LossKind.MESSAGE, LossKind.CHUNK, LossKind.TRUNCATED)
    assert "not defined" in undefined.detail
    assert "connection 1 is '/a' and '/b'" in double.detail


def test_a_length_that_cannot_be_ends_the_reading(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(MAGIC + connection(1, b"/a") + message(1, 1) + b"\xff" * 100)
    source = Rosbag1Source(path, LIMITS)
    assert delivered(source) == [("/a", 10**9)]
    (loss,) = source.health.losses
    assert loss.kind is LossKind.STRUCTURE
    assert "the rest is unreadable, 1 messages recovered" in loss.detail


def test_a_file_that_is_gone_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="cannot read: No such file"):
        list(Rosbag1Source(tmp_path / "a.bag", LIMITS).messages())


def messages_of(path: Path) -> tuple[list[tuple[str, int, bytes]], bool]:
    """What a bag gives, and whether nothing was lost."""
    source = Rosbag1Source(path, Limits())
    found = [(raw.topic, raw.log_time_ns, bytes(raw.data)) for raw in source.messages()]
    return found, source.health.is_clean


@pytest.mark.parametrize("count", [150, pytest.param(5_000, marks=pytest.mark.fault)])
def test_flipped_bits_in_bz2_give_no_wrong_value_and_no_silent_loss(tmp_path: Path, count: int) -> None:
    """The format has no checksum, but bzip2 has one a block: what such chunks hold is right or told as lost."""
    import random
    import re

    from tests.recording.faults import is_subsequence

    path = write_rosbag1(tmp_path / "a.bag", ros_messages(scene(3)), Writer.CompressionFormat.BZ2)
    data, (intact, _) = path.read_bytes(), messages_of(path)
    chunks = [
        (found.start(), int.from_bytes(data[found.start() - 4 : found.start()], "little"))
        for found in re.finditer(b"BZh", data)
    ]
    rng = random.Random(count)
    dropped = 0
    for number in range(count):
        start, length = rng.choice(chunks)
        flipped = bytearray(data)
        flipped[start + rng.randrange(length)] ^= 1 << rng.randrange(8)
        path.write_bytes(flipped)
        found, is_clean = messages_of(path)
        assert is_subsequence(found, intact), number
        assert len(found) == len(intact) or not is_clean, number
        dropped += len(found) < len(intact)
    assert dropped > count / 2

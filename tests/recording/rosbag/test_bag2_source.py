"""rosbag2 folders: the storage files one after another, held against what their metadata declare."""

from __future__ import annotations

from pathlib import Path

import pytest
import zstandard
from rosbags.rosbag2 import StoragePlugin

from svmdist.errors import RecordingError
from svmdist.profile import Limits
from svmdist.recording.rosbag import METADATA_FILE
from svmdist.recording.rosbag.bag2_source import Rosbag2Source, storage_files
from svmdist.recording.source import LossKind
from tests.recording.builders import Entry, write_messages
from tests.recording.other_recorders import Message, ros_messages, write_rosbag2

LIMITS = Limits()
STORAGES = pytest.mark.parametrize(
    "storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP], ids=["SQLite", "MCAP"]
)


@pytest.fixture(scope="module")
def messages(entries: list[Entry]) -> list[Message]:
    """The scene as ROS has it."""
    return ros_messages(entries)


def delivered(source: Rosbag2Source) -> list[tuple[str, int]]:
    """Topic and log time of every message."""
    return [(raw.topic, raw.log_time_ns) for raw in source.messages()]


@STORAGES
@pytest.mark.parametrize("compressed", [False, True], ids=["plain", "compressed"])
def test_every_message_is_delivered(
    tmp_path: Path, messages: list[Message], storage: StoragePlugin, compressed: bool
) -> None:
    """Messages that were compressed one by one come out expanded: CDR begins with a zero byte."""
    source = Rosbag2Source(write_rosbag2(tmp_path / "bag", messages, storage, compressed=compressed), LIMITS)
    found = list(source.messages())
    assert [(raw.topic, raw.log_time_ns) for raw in found] == [(each[0], each[3]) for each in messages]
    assert {bytes(raw.data[:2]) for raw in source.messages()} == {b"\0\1"}
    assert {info.topic for info in source.topics()} == {each[0] for each in messages}
    assert source.health.is_clean


@STORAGES
def test_without_readable_metadata_the_messages_are_delivered_all_the_same(
    tmp_path: Path, messages: list[Message], storage: StoragePlugin
) -> None:
    """And that they were compressed shows in the first of them."""
    folder = write_rosbag2(tmp_path / "bag", messages, storage, compressed=True)
    (folder / METADATA_FILE).write_text("[")
    source = Rosbag2Source(folder, LIMITS)
    assert {bytes(raw.data[:2]) for raw in source.messages()} == {b"\0\1"}
    (loss,) = source.health.losses
    assert loss.kind is LossKind.STRUCTURE


def test_what_the_metadata_declare_is_held_against_what_is_there(
    tmp_path: Path, messages: list[Message]
) -> None:
    """A count that differs, and a file that is named but missing; its name is never used as a path."""
    folder = write_rosbag2(tmp_path / "bag", messages, StoragePlugin.SQLITE3)
    text = (folder / METADATA_FILE).read_text()
    count = sum(each[0] == "/tf" for each in messages)
    assert f"message_count: {count}\n" in text
    (folder / METADATA_FILE).write_text(
        text.replace(f"message_count: {count}\n", f"message_count: {count + 1}\n")
    )
    source = Rosbag2Source(folder, LIMITS)
    assert delivered(source) == [(each[0], each[3]) for each in messages]
    assert {loss.kind for loss in source.health.losses} == {LossKind.STATISTICS}
    assert "/tf" in {loss.topic for loss in source.health.losses}
    (folder / METADATA_FILE).write_text(text.replace("bag.db3", "../../etc/passwd"))
    missing = Rosbag2Source(folder, LIMITS)
    assert len(delivered(missing)) == len(messages)
    (loss,) = missing.health.losses
    assert loss.detail == f"passwd named in {METADATA_FILE} but not there"


def test_a_message_that_does_not_expand_is_a_loss_and_the_next_one_follows(tmp_path: Path) -> None:
    plain = b"\0\1\0\0" + bytes(20)
    good = zstandard.compress(plain)
    rows = [
        ("/js", "sensor_msgs/msg/JointState", "cdr", data, n) for n, data in enumerate([good, b"bad", good])
    ]
    (tmp_path / METADATA_FILE).write_text("[")
    write_messages(tmp_path / "a.mcap", rows)
    source = Rosbag2Source(tmp_path, LIMITS)
    found = [(raw.log_time_ns, bytes(raw.data), raw.losses_before) for raw in source.messages()]
    assert found == [(0, plain, 0), (2, plain, 1)]
    assert [loss.kind for loss in source.health.losses] == [LossKind.STRUCTURE, LossKind.MESSAGE]
    assert "not compressed with zstd" in source.health.losses[1].detail


def test_files_are_read_in_the_order_in_which_they_were_written(tmp_path: Path) -> None:
    """By the numbers in their names; `losses_before` grows from file to file, for an end may have lost some."""
    names = ["bag_0.mcap", "bag_1.mcap", "bag_2.mcap", "bag_10.mcap"]
    for number, name in reversed(list(enumerate(names))):
        write_messages(tmp_path / name, [("/js", "sensor_msgs/msg/JointState", "cdr", b"\0\1\0\0", number)])
    (tmp_path / "other.txt").write_text("")
    assert [path.name for path in storage_files(tmp_path)] == names
    (tmp_path / METADATA_FILE).write_text("[")
    found = [(raw.log_time_ns, raw.losses_before) for raw in Rosbag2Source(tmp_path, LIMITS).messages()]
    assert [number for number, _ in found] == [0, 1, 2, 3]
    losses = [count for _, count in found]
    assert losses == sorted(set(losses))


def test_a_folder_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    (tmp_path / METADATA_FILE).write_text("[")
    with pytest.raises(RecordingError, match=r"a rosbag2 folder without any \.mcap or \.db3 file"):
        Rosbag2Source(tmp_path, LIMITS)
    (tmp_path / "a.db3.zstd").write_bytes(b"")
    with pytest.raises(
        RecordingError, match=r"compressed as a whole; expand them first: zstd -d a\.db3\.zstd"
    ):
        Rosbag2Source(tmp_path, LIMITS)

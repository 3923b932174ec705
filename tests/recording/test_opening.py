"""Opening: the first bytes decide which reader serves, and what is no recording is named for what it is."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import zstandard
from rosbags.rosbag2 import StoragePlugin

from svmdist.errors import RecordingError
from svmdist.profile import Limits
from svmdist.recording.log import LOOKS_LIKE, open_source
from svmdist.recording.mcap_file.framing import MAGIC
from svmdist.recording.mcap_file.source import McapSource
from svmdist.recording.rosbag.bag1_source import Rosbag1Source
from svmdist.recording.rosbag.bag2_source import Rosbag2Source
from svmdist.recording.rosbag.sqlite_source import SqliteSource

from .builders import Entry, write_messages
from .other_recorders import ros_messages, write_rosbag1, write_rosbag2

LIMITS = Limits()


def test_each_format_has_its_reader_whatever_its_name(
    tmp_path: Path, native: Path, entries: list[Entry]
) -> None:
    """A bag, a folder, the database in it, and MCAP, under names that say nothing."""
    messages = ros_messages(entries[:10])
    bag = write_rosbag1(tmp_path / "a.dat", messages)
    folder = write_rosbag2(tmp_path / "folder", messages, StoragePlugin.SQLITE3)
    database = next(folder.glob("*.db3")).rename(tmp_path / "b.dat")
    mcap = tmp_path / "c.dat"
    mcap.write_bytes(native.read_bytes())
    assert isinstance(open_source(mcap, LIMITS), McapSource)
    assert isinstance(open_source(bag, LIMITS), Rosbag1Source)
    assert isinstance(open_source(database, LIMITS), SqliteSource)
    database.rename(folder / "b.db3")
    assert isinstance(open_source(folder, LIMITS), Rosbag2Source)


@pytest.mark.parametrize(
    "number", range(len(LOOKS_LIKE)), ids=[what.split()[-1] for what in LOOKS_LIKE.values()]
)
def test_another_kind_of_file_is_named(tmp_path: Path, number: int) -> None:
    magic, what = list(LOOKS_LIKE.items())[number]
    path = tmp_path / "a.mcap"
    path.write_bytes(magic + bytes(40))
    with pytest.raises(RecordingError, match=f"is {what}; expected an MCAP file, a ROS 1 bag or"):
        open_source(path, LIMITS)


def test_what_is_nothing_known_is_no_recording(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    for data, reason in (
        (b"", "is empty"),
        (b"hello", "is no recording"),
        (MAGIC[:5], "truncated at byte 5"),
    ):
        path.write_bytes(data)
        with pytest.raises(RecordingError, match=reason):
            open_source(path, LIMITS)


def test_a_path_that_is_no_file_is_told(tmp_path: Path) -> None:
    """Nothing there, a folder that is no bag, a pipe, a name that cannot be."""
    os.mkfifo(tmp_path / "pipe")
    refused = {
        tmp_path / "none.mcap": "no such file",
        tmp_path: "a directory without metadata.yaml",
        tmp_path / "pipe": "no regular file",
        tmp_path / "a\0b": "a",
    }
    for path, reason in refused.items():
        with pytest.raises(RecordingError, match=reason):
            open_source(path, LIMITS)


def test_a_file_out_of_a_compressed_bag_asks_for_its_folder(tmp_path: Path) -> None:
    """CDR begins with a zero byte, so that the magic of zstd cannot be a message."""
    compressed = zstandard.compress(bytes(100))
    path = write_messages(tmp_path / "a.mcap", [("/js", "sensor_msgs/msg/JointState", "cdr", compressed, 1)])
    with pytest.raises(RecordingError, match="compressed one by one; open the folder"):
        open_source(path, LIMITS)

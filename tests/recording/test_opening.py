"""Opening: the first bytes decide which reader serves, and what is no recording is named for what it is."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import zstandard
from rosbags.rosbag2 import StoragePlugin

from svmdist.errors import RecordingError
from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.recording.mcap import McapSource
from svmdist.recording.rosbag import BagSource, FolderSource

from .builders import Entry, write_messages
from .other_recorders import ros_messages, write_rosbag1, write_rosbag2

PROFILE = load_profile()


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
    assert isinstance(open_recording(mcap, PROFILE).file.source, McapSource)
    assert isinstance(open_recording(bag, PROFILE).file.source, BagSource)
    assert isinstance(open_recording(database, PROFILE).file.source, BagSource)
    database.rename(folder / "folder.db3")
    assert isinstance(open_recording(folder, PROFILE).file.source, FolderSource)


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
            open_recording(path, PROFILE)


def test_a_file_out_of_a_compressed_bag_asks_for_its_folder(tmp_path: Path) -> None:
    """CDR begins with a zero byte, so that the magic of zstd cannot be a message."""
    compressed = zstandard.compress(bytes(100))
    path = write_messages(tmp_path / "a.mcap", [("/js", "sensor_msgs/msg/JointState", "cdr", compressed, 1)])
    with pytest.raises(RecordingError, match="compressed one by one; open the folder"):
        open_recording(path, PROFILE)

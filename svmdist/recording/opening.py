"""Finding out what a path is, and opening it as the source of messages that reads it."""

from __future__ import annotations

from svmdist.errors import RecordingError
from svmdist.input_file import LogPath, open_regular, why
from svmdist.profile import Limits
from svmdist.recording.mcap_file.framing import MAGIC as MCAP_MAGIC
from svmdist.recording.mcap_file.source import McapSource
from svmdist.recording.rosbag import METADATA_FILE
from svmdist.recording.sources import ZSTD_MAGIC, Source, is_message_compressed
from svmdist.remote_file import RemoteFile

ROSBAG_MAGIC = b"#ROSBAG V2.0\n"
SQLITE_MAGIC = b"SQLite format 3\x00"

LOOKS_LIKE = {
    b"#ROSBAG V1": "a ROS bag of version 1, from before 2010",
    b"\x1f\x8b": "gzip-compressed",
    ZSTD_MAGIC: "zstd-compressed",
    b"\x04\x22\x4d\x18": "lz4-compressed",
    b"BZh": "bzip2-compressed",
    b"\xfd7zXZ": "xz-compressed",
    b"PK\x03\x04": "a zip archive",
    b"\x89HDF": "an HDF5 file",
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"version https://git-lfs": "a Git LFS pointer, whose file has not been fetched",
}


# The modules of other formats are imported when a file of theirs is opened: MCAP starts sooner without them.
WHAT_IS_EXPECTED = "an MCAP file, a ROS 1 bag or a rosbag2 folder"


def open_source(path: LogPath, limits: Limits) -> Source:
    """Open a recording; RecordingError says in one line why a path cannot be one."""
    try:
        if not isinstance(path, RemoteFile) and path.is_dir():
            if (path / METADATA_FILE).is_file():
                from svmdist.recording.rosbag.bag2_source import Rosbag2Source

                return Rosbag2Source(path, limits)
            detail = f"a directory without {METADATA_FILE}"
            raise RecordingError(f"{path}: is {detail}; expected {WHAT_IS_EXPECTED}")
        with open_regular(path) as file:
            start = file.read(64)
    except FileNotFoundError:
        raise RecordingError(f"{path}: no such file") from None
    except (OSError, ValueError) as problem:
        raise RecordingError(f"{path}: cannot read: {why(problem)}") from None
    source = _open_file(path, start, limits)
    if is_message_compressed(source):
        raise RecordingError(
            f"{path}: a rosbag2 file whose messages are compressed one by one;"
            f" open the folder that holds it and its {METADATA_FILE}"
        )
    return source


def _open_file(path: LogPath, start: bytes, limits: Limits) -> Source:
    if not start:
        raise RecordingError(f"{path}: is empty; expected {WHAT_IS_EXPECTED}")
    if start.startswith(MCAP_MAGIC):
        return McapSource(path, limits)
    if start.startswith(ROSBAG_MAGIC):
        from svmdist.recording.rosbag.bag1_source import Rosbag1Source

        return Rosbag1Source(path, limits)
    if start.startswith(SQLITE_MAGIC):
        if isinstance(path, RemoteFile):
            raise RecordingError(
                f"{path}: a rosbag2 database is read from a disk only; copy it to this machine"
            )
        from svmdist.recording.rosbag.sqlite_source import SqliteSource

        return SqliteSource(path, limits)
    if MCAP_MAGIC.startswith(start):
        raise RecordingError(
            f"{path}: truncated at byte {len(start)}, inside the first bytes of an MCAP file"
        )
    found = next((what for magic, what in LOOKS_LIKE.items() if start.startswith(magic)), None)
    raise RecordingError(f"{path}: is {found or 'no recording'}; expected {WHAT_IS_EXPECTED}")

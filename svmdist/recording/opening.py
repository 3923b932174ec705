"""Finding out what a path is, and opening it as the source of messages that reads it."""

from __future__ import annotations

from pathlib import Path

from svmdist.errors import RecordingError
from svmdist.recording.framing import MAGIC
from svmdist.recording.limits import Limits
from svmdist.recording.mcap_source import McapSource
from svmdist.recording.sources import Source

LOOKS_LIKE = {
    b"#ROSBAG V": "a ROS 1 bag",
    b"SQLite format 3\x00": "an SQLite database",
    b"\x1f\x8b": "gzip-compressed",
    b"\x28\xb5\x2f\xfd": "zstd-compressed",
    b"\x04\x22\x4d\x18": "lz4-compressed",
    b"BZh": "bzip2-compressed",
    b"\xfd7zXZ": "xz-compressed",
    b"PK\x03\x04": "a zip archive",
    b"\x89HDF": "an HDF5 file",
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"version https://git-lfs": "a Git LFS pointer, whose file has not been fetched",
}


def open_source(path: Path, limits: Limits) -> Source:
    """Open a recording; RecordingError says in one line why a path cannot be one."""
    try:
        if path.is_dir():
            raise RecordingError(f"{path}: is a directory, expected an MCAP file")
        if not path.exists():
            raise RecordingError(f"{path}: no such file")
        if not path.is_file():
            raise RecordingError(f"{path}: is no regular file, which reading it twice needs")
        with path.open("rb") as file:
            start = file.read(64)
    except (OSError, ValueError) as problem:
        raise RecordingError(
            f"{path}: cannot read: {getattr(problem, 'strerror', None) or problem}"
        ) from None
    if not start:
        raise RecordingError(f"{path}: is empty, expected an MCAP file")
    if start.startswith(MAGIC):
        return McapSource(path, limits)
    if MAGIC.startswith(start):
        raise RecordingError(
            f"{path}: truncated at byte {len(start)}, inside the first bytes of an MCAP file"
        )
    found = next((what for magic, what in LOOKS_LIKE.items() if start.startswith(magic)), None)
    raise RecordingError(f"{path}: not an MCAP file" + (f"; it is {found}" if found else ""))

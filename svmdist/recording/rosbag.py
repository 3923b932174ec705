"""ROS 1 bags and rosbag2 folders as sources of messages, read with the `rosbags` library.

Neither bags nor databases have checksums: flipped bits in their values cannot be found.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Collection, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import quote

import yaml
import zstandard
from rosbags.rosbag1 import Reader as Bag1Reader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from svmdist.errors import RecordingError
from svmdist.files import open_regular, read_regular, why
from svmdist.profile import Limits
from svmdist.recording import source
from svmdist.recording.mcap import McapSource
from svmdist.remote import LogPath, RemoteFile

METADATA_BYTES = 1 << 20
SQLITE_HEADER_BYTES = 100


class BagSource:
    """One file that `rosbags` reads: a ROS 1 bag, or a database of rosbag2."""

    def __init__(self, path: LogPath, encoding: str) -> None:
        self.path, self.health, self._encoding = path, source.Health(), encoding
        if encoding == "cdr":
            if isinstance(path, RemoteFile):
                raise RecordingError(f"{path}: a database is read from a disk only: download it first")
            _require_whole_database(Path(str(path)))
            for left in (Path(f"{path}{suffix}") for suffix in ("-wal", "-journal")):
                if left.exists() and left.stat().st_size:
                    detail = f"{left.name}, left by an interrupted recorder, is not read; sqlite3 merges it"
                    self.health.lose(source.LossKind.STRUCTURE, detail)
        reader = self._opened()
        found = [source.TopicInfo(one.topic, one.msgtype, encoding, one.msgcount) for one in reader.connections]
        self.topics = source.merge_topics(found)
        reader.close()

    def metadata(self) -> dict[str, str]:
        """Bags have no metadata of svmdist's."""
        return {}

    def messages(self, topics: Collection[str] | None = None) -> Iterator[source.RawMessage]:
        """Yield the messages of some topics, or of all, in the order of their times."""
        reader = self._opened()
        count = 0
        try:
            wanted = [one for one in reader.connections if topics is None or one.topic in topics]
            for one, time_ns, data in reader.messages(wanted) if wanted else ():
                count += 1
                yield source.RawMessage(one.topic, one.msgtype, self._encoding, time_ns, bytes(data))
        except Exception as problem:  # rosbags lets through whatever its parsers raise
            rest = f"the rest of {self.path.name} is unreadable ({_line(problem)})"
            self.health.lose(source.LossKind.TRUNCATED, f"{rest}, {count} messages recovered")
        finally:
            reader.close()

    def _opened(self) -> Any:
        """A reader that is open; RecordingError names the command that repairs the file."""
        try:
            reader: Any
            if self._encoding == "ros1":
                reader = Bag1Reader(self.path)  # type: ignore[arg-type]  # a RemoteFile has what it needs
            else:
                reader = Sqlite3Reader(Path(quote(str(Path(str(self.path)).resolve()))))
            reader.open()
            if not all(isinstance(name, str) for one in reader.connections for name in (one.topic, one.msgtype)):
                raise TypeError("a topic without a name or a type")
        except OSError as problem:
            raise RecordingError(f"{self.path}: cannot read: {why(problem)}") from None
        except Exception as problem:
            if self._encoding == "cdr":
                raise RecordingError(f"{self.path}: no usable rosbag2 database: {_line(problem)}") from None
            found = f"{self.path}: a ROS 1 bag that is truncated or damaged ({_line(problem)})"
            remedy = f"what is left of it can be saved with: rosbag reindex {self.path.name}"
            raise RecordingError(f"{found}; {remedy}") from None
        return reader


class FolderSource:
    """A rosbag2 folder: its storage files one after another, messages expanded where they are compressed."""

    def __init__(self, path: Path, limits: Limits) -> None:
        self.path: LogPath = path
        self.health = source.Health()
        self._message_bytes = 4 * limits.image_pixels + limits.message_bytes
        names, self._declared, self._is_compressed = _read_metadata(path)
        if packed := [name for name in names if name.endswith(".zstd")]:
            remedy = f"expand them first: zstd -d {source.sanitize(packed[0])}"
            raise RecordingError(f"{path}: its files are compressed as a whole; {remedy}")
        self._parts: list[source.Source] = []
        for name in names:
            file = path / name
            if not file.is_file():
                self.health.lose(source.LossKind.STRUCTURE, f"{name} named in {source.METADATA_FILE} but not there")
            elif file.suffix in {".mcap", ".db3"}:
                self._parts.append(McapSource(file, limits) if file.suffix == ".mcap" else BagSource(file, "cdr"))
        if not self._parts:
            there = source.sanitize_list(sorted(file.name for file in path.iterdir()))
            expected = f"a .mcap or .db3 file that {source.METADATA_FILE} names, as {source.sanitize_list(names)}"
            raise RecordingError(f"{path}: expected {expected}; found {there}")
        for part in self._parts:
            self.health.join(part.health)
            part.health = self.health

    @cached_property
    def topics(self) -> tuple[source.TopicInfo, ...]:
        """The topics of all files."""
        return source.merge_topics(info for part in self._parts for info in part.topics)

    def metadata(self) -> dict[str, str]:
        """Read the record `svmdist` of the first file that has one."""
        return next((found for part in self._parts if (found := part.metadata())), {})

    def messages(self, topics: Collection[str] | None = None) -> Iterator[source.RawMessage]:
        """Yield the messages of some topics, or of all, file by file."""
        losses, counts = 0, Counter[str]()
        for part in self._parts:
            before = losses
            for raw in part.messages(topics):
                counts[raw.topic] += 1
                message = raw._replace(losses_before=losses + raw.losses_before)
                if self._is_compressed:
                    try:
                        message = message._replace(data=_expanded(raw.data, self._message_bytes))
                    except (ValueError, zstandard.ZstdError) as problem:
                        losses += 1
                        self.health.lose(source.LossKind.MESSAGE, str(problem), raw.offset, raw.topic)
                        continue
                before = message.losses_before
                yield message
            losses = max(losses, before) + 1  # what the end of a file lost shows in no message of it
        for topic, declared in self._declared.items() if self.health.is_clean else ():
            if (topics is None or topic in topics) and declared != counts[topic]:
                detail = f"{source.METADATA_FILE} declares {declared} messages, {counts[topic]} were read"
                self.health.lose(source.LossKind.STATISTICS, detail, None, topic)


def _read_metadata(folder: Path) -> tuple[list[str], dict[str, int], bool]:
    """Storage files in order, counts of messages by topic, and whether these are compressed."""
    try:
        bag = yaml.safe_load(read_regular(folder / source.METADATA_FILE, METADATA_BYTES))["rosbag2_bagfile_information"]
        counts = bag.get("topics_with_message_count") or []
        return (
            [Path(name).name for name in bag["relative_file_paths"]],
            {str(one["topic_metadata"]["name"]): int(one["message_count"]) for one in counts},
            str(bag.get("compression_mode")).upper() == "MESSAGE",
        )
    except Exception as problem:  # somebody else's file: anything can be missing, or of another type
        expected = "expected rosbag2_bagfile_information with relative_file_paths"
        raise RecordingError(f"{folder}: {source.METADATA_FILE} is not usable: {expected} ({_line(problem)})") from None


def _expanded(data: bytes, limit_bytes: int) -> bytes:
    """Expand a message that was compressed on its own; ValueError where it declares more than the limit."""
    size_bytes = zstandard.frame_content_size(data)
    if not 0 <= size_bytes <= limit_bytes:
        raise ValueError(f"a message of {size_bytes} bytes declared, the limit is {limit_bytes}")
    return zstandard.ZstdDecompressor().decompress(data)


def _line(problem: Exception) -> str:
    return " ".join(str(problem).split())[:200] or type(problem).__name__


def _require_whole_database(path: Path) -> None:
    """Raise RecordingError for a file shorter than its header says: SQLite may take zeros for the missing part."""
    with open_regular(path) as file:
        header = file.read(SQLITE_HEADER_BYTES)
        size_bytes = file.seek(0, 2)
    if len(header) < SQLITE_HEADER_BYTES:
        raise RecordingError(f"{path}: truncated at byte {size_bytes}, inside the header")
    (page_bytes,) = struct.unpack_from(">H", header, 16)
    changes, page_count = struct.unpack_from(">II", header, 24)
    (counted_at,) = struct.unpack_from(">I", header, 92)
    declared_bytes = (65536 if page_bytes == 1 else page_bytes) * page_count
    # The count of pages is valid only where it was written with the last change (SQLite file format, 1.3.7).
    if changes == counted_at and size_bytes < declared_bytes:
        remedy = f"what is left of it can be saved with: sqlite3 {path.name} .recover"
        found = f"truncated at byte {size_bytes} of {declared_bytes}: an SQLite database cannot be read in part"
        raise RecordingError(f"{path}: {found}; {remedy}")

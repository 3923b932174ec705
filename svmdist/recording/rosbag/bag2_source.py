"""rosbag2 recordings as a source of messages: folders of MCAP or SQLite files, and single SQLite files.

Everything is read with the storage files alone. Of `metadata.yaml`, only the names of the files are
held against what is there: a name in a file is never used as a path.
"""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Callable, Collection, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

from svmdist.errors import RecordingError
from svmdist.recording.decompress import DecompressionError, decompress_message
from svmdist.recording.health import Health, Loss, LossKind
from svmdist.recording.limits import Limits
from svmdist.recording.mcap_file.source import McapSource
from svmdist.recording.sources import RawMessage, Source, TopicInfo, merge_topics

METADATA_FILE = "metadata.yaml"
MAX_METADATA_BYTES = 1 << 20
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
COUNT_PLAIN_TABLES = (
    "SELECT COUNT(*) FROM sqlite_master WHERE name IN ('topics', 'messages') AND type = 'table' "
    "AND sql LIKE 'CREATE TABLE%'"
)
STORED_FILE = re.compile(r"^\s*-\s*['\"]?([^'\"\n]+\.(?:mcap|db3)(?:\.zstd)?)['\"]?\s*$", re.MULTILINE)
COMPRESSION_MODE = re.compile(r"^\s*compression_mode:\s*['\"]?(\w*)", re.MULTILINE)


class SqliteSource:
    """One `.db3` file of rosbag2."""

    def __init__(self, path: Path, limits: Limits) -> None:
        self.path = path
        self.health = Health()
        self._limits = limits

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics, with counts by reading their messages' headers."""
        query = (
            "SELECT name, type, serialization_format, COALESCE(total, 0) FROM topics LEFT JOIN "
            "(SELECT topic_id, COUNT(*) AS total FROM messages GROUP BY topic_id) ON topic_id = topics.id"
        )
        rows = list(self._rows(query))
        return merge_topics(TopicInfo(str(a), str(b), str(c), int(n)) for a, b, c, n in rows)

    def metadata(self) -> dict[str, str]:
        """The files have no metadata of svmdist's."""
        return {}

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of some topics, or of all, in the order in which they were stored."""
        query = (
            "SELECT name, type, serialization_format, timestamp, length(data), "
            "CASE WHEN length(data) <= ? THEN data END, messages.id "
            "FROM messages CROSS JOIN topics ON topics.id = messages.topic_id ORDER BY messages.id"
        )
        limit = self._limits.record_bytes
        losses = 0
        for topic, schema, encoding, time_ns, length, data, row in self._rows(query, limit):
            if topics is not None and topic not in topics:
                continue
            if not isinstance(data, bytes) or not isinstance(time_ns, int):
                losses += 1
                detail = f"message {row} of {length} bytes is malformed or above the limit"
                self.health.add(Loss(LossKind.RECORD, detail, None, str(topic)))
                continue
            yield RawMessage(str(topic), str(schema), str(encoding), time_ns, data, None, losses)

    def _rows(self, query: str, *parameters: int) -> Iterator[tuple[Any, ...]]:
        uri = f"file:{quote(str(self.path.resolve()))}?mode=ro&immutable=1"
        count = 0
        try:
            with closing(sqlite3.connect(uri, uri=True)) as database:
                # A view or a virtual table could run anything, and for ever.
                (plain_tables,) = database.execute(COUNT_PLAIN_TABLES).fetchone()
                if plain_tables != 2:
                    raise RecordingError(f"{self.path}: an SQLite database, but not of rosbag2")
                for row in database.execute(query, parameters):
                    count += 1
                    yield row
        except (sqlite3.Error, UnicodeError, OverflowError, MemoryError) as problem:
            if count == 0:
                raise RecordingError(f"{self.path}: no usable rosbag2 database: {problem}") from None
            detail = f"the rest of {self.path.name} is unreadable ({problem}), {count} messages recovered"
            self.health.add(Loss(LossKind.TRUNCATED, detail))


class Rosbag2Source:
    """A rosbag2 folder: its storage files one after another, messages expanded where they are compressed."""

    def __init__(self, path: Path, limits: Limits) -> None:
        self.path = path
        self.health = Health()
        self._limits = limits
        self._message_bytes = 4 * limits.image_pixels + limits.message_bytes
        files = storage_files(path)
        if not files:
            raise RecordingError(f"{path}: a rosbag2 folder without any .mcap or .db3 file")
        packed = [file.name for file in path.iterdir() if file.name.endswith((".mcap.zstd", ".db3.zstd"))]
        if packed:
            raise RecordingError(
                f"{path}: its files are compressed as a whole; expand them first: zstd -d {packed[0]}"
            )
        text = _read_metadata(path)
        missing = sorted(
            {Path(name).name for name in STORED_FILE.findall(text)} - {file.name for file in files}
        )
        if missing:
            detail = f"{', '.join(missing[:3])} named in {METADATA_FILE} but not there"
            self.health.add(Loss(LossKind.STRUCTURE, detail))
        mode = COMPRESSION_MODE.search(text)
        self._is_compressed = mode is not None and mode[1].upper() == "MESSAGE"
        open_one: dict[str, Callable[[Path, Limits], Source]] = {".mcap": McapSource, ".db3": SqliteSource}
        self._parts = [open_one[file.suffix](file, limits) for file in files]
        for part in self._parts:
            part.health = self.health

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics of all files."""
        return merge_topics(info for part in self._parts for info in part.topics())

    def metadata(self) -> dict[str, str]:
        """Read the record `svmdist` of the first file that has one."""
        return next((found for part in self._parts if (found := part.metadata())), {})

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of some topics, or of all, file by file."""
        losses = 0
        for part in self._parts:
            part_losses = 0
            for raw in part.messages(topics):
                part_losses = raw.losses_before
                message = replace(raw, losses_before=losses + part_losses)
                if not self._is_compressed:
                    yield message
                    continue
                try:
                    data = decompress_message(raw.data, self._message_bytes, self._limits)
                except DecompressionError as problem:
                    losses += 1
                    self.health.add(Loss(LossKind.MESSAGE, str(problem), raw.offset, raw.topic))
                    continue
                yield replace(message, data=data)
            losses += part_losses + 1  # what the end of a file lost shows in no message of it


def storage_files(folder: Path) -> list[Path]:
    """List the storage files of a folder in the order in which they were written: `_2` before `_10`."""

    def order(path: Path) -> list[tuple[int, str]]:
        return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]

    return sorted((path for path in folder.iterdir() if path.suffix in {".mcap", ".db3"}), key=order)


def is_message_compressed(source: Source) -> bool:
    """Tell whether the messages of a single file were compressed one by one, as only the folder knows."""
    topics = {info.topic for info in source.topics() if info.message_encoding == "cdr"}
    if not topics:
        return False
    first = next(iter(source.messages(topics)), None)
    # CDR begins with a zero byte, so these four cannot be a message.
    return first is not None and bytes(first.data[:4]) == ZSTD_MAGIC


def _read_metadata(folder: Path) -> str:
    try:
        with (folder / METADATA_FILE).open("rb") as file:
            return file.read(MAX_METADATA_BYTES).decode("utf-8", "replace")
    except OSError as problem:
        raise RecordingError(
            f"{folder}: cannot read {METADATA_FILE}: {problem.strerror or problem}"
        ) from None

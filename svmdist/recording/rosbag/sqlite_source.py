"""SQLite files of rosbag2 as a source of messages."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

from svmdist.errors import RecordingError
from svmdist.input_file import open_regular
from svmdist.profile import Limits
from svmdist.recording.health import Health, Loss, LossKind
from svmdist.recording.sources import RawMessage, TopicInfo, merge_topics

HEADER_BYTES = 100
UNMERGED_SUFFIXES = ("-wal", "-journal")
COUNT_PLAIN_TABLES = (
    "SELECT COUNT(*) FROM sqlite_master WHERE name IN ('topics', 'messages') AND type = 'table' "
    "AND sql LIKE 'CREATE TABLE%'"
)


class SqliteSource:
    """One `.db3` file of rosbag2. SQLite has no checksums: flipped bits in its values cannot be found."""

    def __init__(self, path: Path, limits: Limits, health: Health | None = None) -> None:
        self.path = path
        self.health = health or Health()
        self._limits = limits
        _refuse_truncated_file(path)
        for suffix in UNMERGED_SUFFIXES:
            left = path.with_name(path.name + suffix)
            if left.exists() and left.stat().st_size:
                detail = f"{left.name} was left by an interrupted recorder and is not read; sqlite3 merges it"
                self.health.add(Loss(LossKind.STRUCTURE, detail))

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
            "FROM messages LEFT JOIN topics ON topics.id = messages.topic_id ORDER BY messages.id"
        )
        limit = self._limits.record_bytes
        losses = 0
        previous_row = 0
        for topic, schema, encoding, time_ns, length, data, row in self._rows(query, limit):
            if row != previous_row + 1:
                losses += 1
                detail = f"{self.path.name}: message {row} follows message {previous_row}"
                self.health.add(Loss(LossKind.RECORD, detail))
            previous_row = row
            if topic is None:
                losses += 1
                self.health.add(Loss(LossKind.RECORD, f"message {row} belongs to no topic"))
                continue
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


def _refuse_truncated_file(path: Path) -> None:
    """Raise RecordingError for a file shorter than its header says.

    SQLite refuses most of these too, but where only a part of the last page is missing, it takes zeros for it.
    """
    try:
        with open_regular(path) as file:
            header = file.read(HEADER_BYTES)
            size_bytes = file.seek(0, 2)
    except OSError as problem:
        raise RecordingError(f"{path}: cannot read: {problem.strerror or problem}") from None
    if len(header) < HEADER_BYTES:
        raise RecordingError(f"{path}: truncated at byte {size_bytes}, inside the header")
    (page_bytes,) = struct.unpack_from(">H", header, 16)
    changes, page_count = struct.unpack_from(">II", header, 24)
    (counted_at,) = struct.unpack_from(">I", header, 92)
    declared_bytes = (65536 if page_bytes == 1 else page_bytes) * page_count
    # The count of pages is valid only where it was written with the last change (SQLite file format, 1.3.7).
    if changes == counted_at and size_bytes < declared_bytes:
        raise RecordingError(
            f"{path}: truncated at byte {size_bytes} of {declared_bytes}: an SQLite database cannot be read in"
            f" part; what is left of it can be saved with: sqlite3 {path.name} .recover"
        )

"""SQLite files of rosbag2 as a source of messages."""

from __future__ import annotations

import os
import sqlite3
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

from svmdist.errors import RecordingError
from svmdist.input_file import open_regular
from svmdist.profile import Limits
from svmdist.recording.source import (
    MAX_NAME_BYTES,
    Health,
    Loss,
    LossKind,
    RawMessage,
    TopicInfo,
    merge_topics,
)

Topic = tuple[str, str, str]
"""Name, type and serialization format."""

HEADER_BYTES = 100
MAX_TOPICS = 10_000
OTHER_COLUMNS_BYTES = 1 << 20
"""Of a row, beside a message's data."""
STEP, MAX_STEPS = 10_000, 20_000_000
"""Steps of SQLite's machine for one row: a tenth of a second. A row of rosbag2 takes a hundred."""
UNMERGED_SUFFIXES = ("-wal", "-journal")
COUNT_PLAIN_TABLES = (
    "SELECT COUNT(*) FROM sqlite_master WHERE name IN ('topics', 'messages') AND type = 'table' "
    "AND sql LIKE 'CREATE TABLE%'"
)
COUNT_COMPUTED_COLUMNS = (
    "SELECT (SELECT COUNT(*) FROM pragma_table_xinfo('topics') WHERE hidden) + "
    "(SELECT COUNT(*) FROM pragma_table_xinfo('messages') WHERE hidden)"
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
        known = self._read_topics()
        counts = Counter(topic_id for (topic_id,) in self._rows("SELECT topic_id FROM messages"))
        return merge_topics(TopicInfo(*topic, counts[topic_id]) for topic_id, topic in known.items())

    def metadata(self) -> dict[str, str]:
        """The files have no metadata of svmdist's."""
        return {}

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of some topics, or of all, in the order in which they were stored."""
        known = self._read_topics()
        query = (
            "SELECT rowid, id, topic_id, timestamp, typeof(data), "
            "CASE WHEN typeof(data) = 'blob' THEN length(data) END, "
            "CASE WHEN typeof(data) = 'blob' AND length(data) <= ? THEN data END "
            "FROM messages ORDER BY rowid"
        )
        losses = 0
        previous_row = 0
        for row, number, topic_id, time_ns, kind, length, data in self._rows(
            query, self._limits.record_bytes
        ):
            if row != number:
                losses += 1
                self._record_loss(f"message {row} has an id that is no number")
                continue
            if row != previous_row + 1:
                losses += 1
                self._record_loss(f"{self.path.name}: message {row} follows message {previous_row}")
            previous_row = row
            topic = known.get(topic_id) if isinstance(topic_id, int) else None
            if topic is None:
                losses += 1
                self._record_loss(f"message {row} belongs to no topic")
                continue
            if topics is not None and topic[0] not in topics:
                continue
            if not isinstance(data, bytes) or not isinstance(time_ns, int):
                losses += 1
                found = f"of {length} bytes" if kind == b"blob" else f"of type {str(kind, 'ascii')}"
                self._record_loss(f"message {row} {found} is malformed or above the limit", topic[0])
                continue
            yield RawMessage(*topic, time_ns, data, None, losses)

    def _read_topics(self) -> dict[int, Topic]:
        """The topics by their id; one that means nothing, or contradicts another one, is a loss."""
        known: dict[int, Topic] = {}
        contradicting: set[int] = set()
        types: dict[str, Topic] = {}
        for topic_id, *texts in self._rows("SELECT id, name, type, serialization_format FROM topics"):
            if len(known) >= MAX_TOPICS:
                self._record_loss(
                    f"more than {MAX_TOPICS} topics; the rest is not read", kind=LossKind.DEFINITION
                )
                break
            topic = _topic(texts)
            if not isinstance(topic_id, int) or topic is None:
                self._record_loss("a topic's row is malformed", kind=LossKind.DEFINITION)
            elif topic_id in known:
                contradicting.add(topic_id)
                self._record_loss(f"two topics have the id {topic_id}", kind=LossKind.DEFINITION)
            elif types.setdefault(topic[0], topic) != topic:
                detail = f"it is {types[topic[0]][1]} and {topic[1]}; the second one is dropped"
                self._record_loss(detail, topic[0], LossKind.DEFINITION)
            else:
                known[topic_id] = topic
        return {key: topic for key, topic in known.items() if key not in contradicting}

    def _record_loss(self, detail: str, topic: str | None = None, kind: LossKind = LossKind.RECORD) -> None:
        self.health.add(Loss(kind, detail, None, topic))

    def _rows(self, query: str, *parameters: int) -> Iterator[tuple[Any, ...]]:
        uri = f"file:{quote(os.fsencode(self.path.resolve()))}?mode=ro&immutable=1"
        count = 0
        steps = 0

        def work() -> int:
            """Count the steps that SQLite takes for one row; it ends where this is true."""
            nonlocal steps
            steps += STEP
            return steps > MAX_STEPS

        try:
            with closing(sqlite3.connect(uri, uri=True)) as database:
                database.text_factory = bytes  # the file says whether it is UTF-8; SQLite believes it
                database.execute("PRAGMA trusted_schema = OFF")
                database.setlimit(
                    sqlite3.SQLITE_LIMIT_LENGTH, self._limits.record_bytes + OTHER_COLUMNS_BYTES
                )
                database.set_progress_handler(work, STEP)
                self._require_plain_tables(database)
                for row in database.execute(query, parameters):
                    steps = 0
                    count += 1
                    yield row
        except (sqlite3.Error, UnicodeError, OverflowError, MemoryError) as problem:
            if count == 0:
                raise RecordingError(f"{self.path}: no usable rosbag2 database: {problem}") from None
            detail = f"the rest of {self.path.name} is unreadable ({problem}), {count} rows recovered"
            self.health.add(Loss(LossKind.TRUNCATED, detail))

    def _require_plain_tables(self, database: sqlite3.Connection) -> None:
        """A view, a virtual table or a column that is computed could run anything, and for ever."""
        (plain_tables,) = database.execute(COUNT_PLAIN_TABLES).fetchone()
        computed = 0
        if plain_tables == 2:
            (computed,) = database.execute(COUNT_COMPUTED_COLUMNS).fetchone()
        if plain_tables != 2 or computed:
            raise RecordingError(f"{self.path}: an SQLite database, but not of rosbag2")


def _topic(texts: list[object]) -> Topic | None:
    """Name, type and encoding of a topic; None where one of them is no text, or longer than a name."""
    if not all(isinstance(text, bytes) and len(text) <= MAX_NAME_BYTES for text in texts):
        return None
    try:
        name, schema, encoding = (bytes(text).decode("utf-8") for text in texts if isinstance(text, bytes))
    except UnicodeDecodeError:
        return None
    return name, schema, encoding


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

"""ROS 1 bags as a source of messages, read in file order so that a bag without an index is no problem."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Collection, Iterator
from typing import BinaryIO

from svmdist.errors import RecordingError
from svmdist.input_file import LogPath, open_regular
from svmdist.profile import Limits
from svmdist.recording.effort import Effort, TooMuchError
from svmdist.recording.rosbag import bag1_records
from svmdist.recording.rosbag.bag1_records import (
    MAGIC,
    OP_CONNECTION,
    OP_MESSAGE,
    BagRecord,
    BrokenRecordError,
    chunk_records,
    parse_fields,
    read_record,
)
from svmdist.recording.source import Health, Loss, LossKind, RawMessage, TopicInfo, cut, merge_topics

MAX_CONNECTIONS = 10_000


class Rosbag1Source:
    """One ROS 1 bag. The format has no checksums: flipped bits in its values cannot be found."""

    def __init__(self, path: LogPath, limits: Limits) -> None:
        self.path = path
        self.health = Health()
        self._limits = limits
        self._topics: tuple[TopicInfo, ...] | None = None

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics, by reading the whole bag once."""
        if self._topics is None:
            counts = Counter((raw.topic, raw.schema) for raw in self.messages())
            self._topics = merge_topics(TopicInfo(*key, "ros1", count) for key, count in counts.items())
        return self._topics

    def metadata(self) -> dict[str, str]:
        """Bags have no metadata."""
        return {}

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of some topics, or of all, in file order."""
        try:
            with open_regular(self.path) as file:
                size_bytes = file.seek(0, 2)
                file.seek(len(MAGIC))
                for message in _Pass(self.health, self._limits, Effort(size_bytes)).read(file, size_bytes):
                    if topics is None or message.topic in topics:
                        yield message
        except OSError as problem:
            raise RecordingError(f"{self.path}: cannot read: {problem.strerror or problem}") from None


class _Pass:
    """One pass over a bag: connections so far, counts, and what the bag declares."""

    def __init__(self, health: Health, limits: Limits, effort: Effort) -> None:
        self._effort = effort
        self._health = health
        self._limits = limits
        self._connections: dict[int, tuple[str, str]] = {}
        self._message_count = 0
        self._declared_count = 0
        self._is_indexed = False
        self._loss_count = 0

    def read(self, file: BinaryIO, size_bytes: int) -> Iterator[RawMessage]:
        while (offset := file.tell()) < size_bytes:
            try:
                record = read_record(file, size_bytes, self._limits)
            except BrokenRecordError as problem:
                detail = f"{problem}; the rest is unreadable, {self._message_count} messages recovered"
                self._record_loss(LossKind.STRUCTURE, detail, offset)
                return
            if record is not None:
                try:
                    self._effort.idle()
                    yield from self._record(record)
                except TooMuchError as problem:
                    self._record_loss(LossKind.STRUCTURE, f"{problem}; the rest is not read", offset)
                    return
            if record is None or record.is_truncated:
                self._truncated(size_bytes)
                return
        if not self._is_indexed:
            self._truncated(size_bytes)
        elif self._declared_count != self._message_count:
            detail = f"the index declares {self._declared_count} messages, {self._message_count} were read"
            self._record_loss(LossKind.STATISTICS, detail, None)

    def _record(self, record: BagRecord) -> Iterator[RawMessage]:
        try:
            match record.op:
                case bag1_records.OP_BAG_HEADER if not record.is_truncated:
                    self._is_indexed = record.number(b"index_pos") != 0
                case bag1_records.OP_CHUNK:
                    for inner in chunk_records(record, self._limits, self._effort):
                        yield from self._inner(inner)
                case bag1_records.OP_CHUNK_INFO if not record.is_truncated:
                    pairs = bytes(record.data)[: len(record.data) // 8 * 8]
                    self._declared_count += sum(count for _, count in struct.iter_unpack("<II", pairs))
                case bag1_records.OP_MESSAGE | bag1_records.OP_CONNECTION if not record.is_truncated:
                    yield from self._inner(record)
                case _:
                    pass
        except BrokenRecordError as problem:
            self._record_loss(LossKind.CHUNK, str(problem), record.offset)

    def _inner(self, record: BagRecord) -> Iterator[RawMessage]:
        if record.op != OP_MESSAGE:
            self._effort.idle()
        if record.op == OP_CONNECTION:
            self._connect(record)
        elif record.op == OP_MESSAGE:
            connection = self._connections.get(record.number(b"conn"))
            if connection is None:
                self._record_loss(
                    LossKind.MESSAGE, "messages of a connection that is not defined", record.offset
                )
                return
            time_ns = record.time_ns()
            self._effort.message()
            self._message_count += 1
            yield RawMessage(*connection, "ros1", time_ns, record.data, record.offset, self._loss_count)

    def _connect(self, record: BagRecord) -> None:
        key = record.number(b"conn")
        schema = cut(parse_fields(record.data).get(b"type", b"").decode("utf-8", "replace"))
        connection = (record.text(b"topic"), schema)
        known = self._connections.setdefault(key, connection)
        if known != connection:
            raise BrokenRecordError(f"connection {key} is {known[0]!r} and {connection[0]!r}")
        if len(self._connections) > MAX_CONNECTIONS:
            raise BrokenRecordError(f"more than {MAX_CONNECTIONS} connections")

    def _truncated(self, size_bytes: int) -> None:
        detail = f"{self._message_count} messages recovered"
        self._record_loss(LossKind.TRUNCATED, detail, size_bytes)

    def _record_loss(self, kind: LossKind, detail: str, offset: int | None) -> None:
        self._loss_count += 1
        self._health.add(Loss(kind, detail, offset))

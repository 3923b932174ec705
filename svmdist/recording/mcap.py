"""MCAP files as a source of messages, read with the `mcap` library: whatever is whole, and what was lost.

A chunk is delivered when its CRC is right, and dropped whole otherwise. Messages outside of chunks are protected by the
CRC of the data section alone, which is known at its end: where it is wrong, that is a loss. A file on a disk is read
and verified whole, one behind a URL by its index: only the chunks that hold what is asked for.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter, deque
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from io import BytesIO
from typing import Any, BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary

from svmdist.errors import RecordingError
from svmdist.files import open_regular, reading
from svmdist.profile import Limits
from svmdist.recording.source import Health, LossKind, RawMessage, TopicInfo, merge_topics
from svmdist.remote import LogPath, RemoteFile

METADATA_NAME = "svmdist"  # the metadata record that says what a recording came from
MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
TAIL = struct.Struct("<BQQQI8s")  # the footer record and the magic, with which every complete file ends
PARSED = frozenset(Opcode) - {Opcode.MESSAGE_INDEX}


class McapSource:
    """One MCAP file."""

    def __init__(self, path: LogPath, limits: Limits) -> None:
        self.path, self.limits, self.health = path, limits, Health()
        self._metadata: dict[str, str] | None = None

    def metadata(self) -> dict[str, str]:
        """Read the record `svmdist`, unless the CRC of the data section is wrong."""
        if self._metadata is None:
            one_pass = _Pass(self)
            deque(one_pass.frames(frozenset()), maxlen=0)
            self._metadata = one_pass.metadata
        return self._metadata

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of some topics, or of all, in file order."""
        one_pass = _Pass(self)
        for offset, record in one_pass.records(topics):
            if not isinstance(record, Message):
                continue
            channel = one_pass.channels[record.channel_id]
            if topics is None or channel.topic in topics:
                topic, schema, encoding, _ = one_pass.topic_of(channel)
                yield RawMessage(topic, schema, encoding, record.log_time, record.data, offset, one_pass.loss_count)
        self._metadata = one_pass.metadata if self._metadata is None else self._metadata

    @cached_property
    def summary(self) -> Summary | None:
        """The summary section where its CRC covers every byte of it and is right."""
        with reading(self.path, RecordingError), open_regular(self.path) as file:
            size_bytes = file.seek(0, 2)
            tail = _tail(file, size_bytes)
            start, crc = (min(tail[2], size_bytes), tail[4]) if tail else (0, 0)
            file.seek(start)
            if start and crc and zlib.crc32(file.read(max(size_bytes - len(MAGIC) - 4 - start, 0))) == crc:
                file.seek(0)
                with suppress(Exception):  # right by its CRC, and still not MCAP
                    return SeekingReader(file).get_summary()
        return None

    @cached_property
    def topics(self) -> tuple[TopicInfo, ...]:
        """The topics: from the summary where its CRC is right, else by reading the whole file."""
        one_pass, is_counted = _Pass(self), True
        statistics = self.summary.statistics if self.summary else None
        if statistics and statistics.channel_count == len(one_pass.channels):
            one_pass.counts.update(statistics.channel_message_counts)
            is_counted = one_pass.counts.total() == statistics.message_count
        else:
            deque(one_pass.records(None), maxlen=0)
        found = map(one_pass.topic_of, one_pass.channels.values())
        return merge_topics(found if is_counted else (one._replace(message_count=None) for one in found))


class _Pass:
    """One pass over a file: the definitions so far, the metadata record, and the losses of this pass."""

    def __init__(self, source: McapSource) -> None:
        self._path, self._health, self._limits = source.path, source.health, source.limits
        self._summary = summary = source.summary
        # From the summary, so that the loss of a chunk does not take the definitions in it along.
        self.schemas = dict(summary.schemas) if summary else dict[int, Schema]()
        self.channels = dict(summary.channels) if summary else dict[int, Channel]()
        self.metadata, self.loss_count = dict[str, str](), 0
        self._statistics = summary.statistics if summary else None
        self.counts: Counter[int] = Counter()  # messages read by channel
        self._has_data_ended = self._is_cut = False

    def topic_of(self, channel: Channel) -> TopicInfo:
        """The topic of a channel, with the count of its messages so far."""
        schema = self.schemas.get(channel.schema_id)
        name = schema.name if schema else ""
        return TopicInfo(channel.topic, name, channel.message_encoding, self.counts[channel.id])

    def records(self, topics: Collection[str] | None) -> Iterator[tuple[int, McapRecord]]:
        """Yield the records with their offsets, chunks unpacked; of messages those with a known channel."""
        is_chunked = False
        for offset, record in self.frames(topics):
            inner: list[McapRecord] = [record]
            belonging = Message if self._has_data_ended else Message | Schema | Channel
            if isinstance(record, Chunk):
                is_chunked = True
                try:
                    inner = breakup_chunk(_expanded(record, self._limits), validate_crc=True)
                except Exception as problem:  # mcap raises a dozen kinds
                    self._lose(LossKind.CHUNK, f"dropped: {str(problem) or type(problem).__name__}", offset)
                    continue
            # A record that belongs into a chunk, as all others are in one: its opcode is broken.
            elif is_chunked and not self._is_cut and isinstance(record, belonging):
                self._lose(LossKind.RECORD, f"{type(record).__name__} outside of chunks dropped", offset)
                continue
            yield from ((offset, one) for one in inner if self._is_usable(one, offset))
        self._check_counts(topics)

    def frames(self, topics: Collection[str] | None) -> Iterator[tuple[int, McapRecord]]:
        """Yield the records as they stand in the file; of a remote file with an index, only chunks with some topics."""
        with reading(self._path, RecordingError), open_regular(self._path) as file:
            size_bytes = file.seek(0, 2)
            file.seek(0)
            if file.read(len(MAGIC)) != MAGIC:
                raise RecordingError(f"{self._path}: not an MCAP file")
            if isinstance(self._path, RemoteFile) and self._summary and self._summary.chunk_indexes:
                yield from self._indexed(file, self._summary, topics)
            else:
                yield from self._sequential(file, size_bytes)

    def _sequential(self, file: BinaryIO, size_bytes: int) -> Iterator[tuple[int, McapRecord]]:
        crc: int | None = zlib.crc32(MAGIC)
        offset = len(MAGIC)
        while len(head := file.read(HEAD.size)) == HEAD.size:
            opcode, length = HEAD.unpack(head)
            end = offset + HEAD.size + length
            if end > size_bytes or opcode == 0:
                break
            if length > self._limits.record_bytes:
                self._lose_long(length, offset)
                file.seek(end)
                crc = None  # as bytes were left out, it says nothing any more
            else:
                body = file.read(length)
                record = self._parsed(head + body, offset)
                if opcode == Opcode.DATA_END:
                    self._end_data(int.from_bytes(body[:4], "little"), crc, offset)
                elif crc is not None:
                    crc = zlib.crc32(body, zlib.crc32(head, crc))
                if record is not None:
                    yield offset, record
                if opcode == Opcode.FOOTER and length == 20 and end + len(MAGIC) == size_bytes:
                    self._end_file(body, offset)
                    return
            offset = end
        self._is_cut = _tail(file, size_bytes) is None
        if not self._is_cut:
            detail = f"a record of impossible length; the rest is unreadable, {self.counts.total()} messages recovered"
            self._lose(LossKind.STRUCTURE, detail, offset)
            return
        if head[:1] == bytes([Opcode.CHUNK]):
            file.seek(offset + HEAD.size)
            body = file.read(self._limits.record_bytes)
            with suppress(Exception):  # it ends early, wherever that is, and no CRC covers its records
                chunk = _expanded(Chunk.read(ReadDataStream(BytesIO(body))), self._limits, is_whole=False)
                yield from ((offset, one) for one in StreamReader(BytesIO(chunk.data), skip_magic=True).records)
        self._lose(LossKind.TRUNCATED, f"{self.counts.total()} messages recovered", size_bytes)

    def _indexed(
        self, file: BinaryIO, summary: Summary, topics: Collection[str] | None
    ) -> Iterator[tuple[int, McapRecord]]:
        wanted = {key for key, one in summary.channels.items() if topics is None or one.topic in topics}
        places = [(one.offset, one.length) for one in summary.metadata_indexes]
        places += [
            (one.chunk_start_offset, one.chunk_length)
            for one in summary.chunk_indexes
            if not one.message_index_offsets or wanted & one.message_index_offsets.keys()
        ]
        for offset, length in sorted(places):
            if length > self._limits.record_bytes + HEAD.size:
                self._lose_long(length - HEAD.size, offset)
                continue
            file.seek(offset)
            if (record := self._parsed(file.read(length), offset)) is not None:
                yield offset, record

    def _parsed(self, frame: bytes, offset: int) -> McapRecord | None:
        """Parse one record, head included; None for a message index, an unknown record, and one that is broken."""
        if not frame or frame[0] not in PARSED:
            return None
        try:
            record = next(StreamReader(BytesIO(frame), skip_magic=True, emit_chunks=True).records)
        except Exception as problem:
            self._lose(LossKind.RECORD, str(problem) or "a record ends early", offset)
            return None
        if isinstance(record, Metadata) and record.name == METADATA_NAME and not self.metadata:
            self.metadata = dict(record.metadata)
        return record

    def _is_usable(self, record: McapRecord, offset: int) -> bool:
        """Take note of definitions and counts; false for a message whose channel is not known."""
        if isinstance(record, Schema | Channel):
            known: Any = self.schemas if isinstance(record, Schema) else self.channels
            if known.setdefault(record.id, record) != record:
                detail = f"{type(record).__name__.lower()} {record.id} is defined twice in different ways"
                self._lose(LossKind.DEFINITION, detail, offset)
        elif isinstance(record, Statistics):
            self._statistics = record
        elif isinstance(record, Message):
            if record.channel_id not in self.channels:
                detail = f"messages of channel {record.channel_id}, which is not defined"
                self._lose(LossKind.MESSAGE, detail)
                return False
            self.counts[record.channel_id] += 1
        return True

    def _end_data(self, declared_crc: int, crc: int | None, offset: int) -> None:
        self._has_data_ended = True
        if declared_crc and crc is not None and declared_crc != crc:
            self._lose(LossKind.DATA_CRC, "the CRC of the data section is wrong", offset)
            if self.metadata:
                self.metadata = {}
                self._lose(LossKind.RECORD, "metadata dropped: no other CRC covers it", offset)

    def _end_file(self, footer: bytes, offset: int) -> None:
        if not self._has_data_ended:
            self._lose(LossKind.STRUCTURE, "the end of the data is missing", offset)
        start, _, crc = struct.unpack("<QQI", footer)
        if start and crc and self._summary is None:
            self._lose(LossKind.SUMMARY, "its CRC is wrong, or it cannot be read", offset)

    def _check_counts(self, topics: Collection[str] | None) -> None:
        if self._statistics is None:
            return
        declared, found = Counter(self._statistics.channel_message_counts), self.counts
        total = self._statistics.message_count
        if isinstance(self._path, RemoteFile) and topics is not None:
            wanted = {key for key, one in self.channels.items() if one.topic in topics}
            declared, found = (Counter({k: c[k] for k in wanted & c.keys()}) for c in (declared, found))
            total = declared.total()
        if total != found.total():
            self._lose(LossKind.STATISTICS, f"the statistics declare {total} messages, {found.total()} were read")
        elif declared and declared != found:
            self._lose(LossKind.STATISTICS, "the statistics declare other counts by channel than were read")

    def _lose_long(self, length: int, offset: int) -> None:
        self._lose(LossKind.RECORD, f"{length} bytes; the limit is {self._limits.record_bytes}", offset)

    def _lose(self, kind: LossKind, detail: str, offset: int | None = None) -> None:
        self.loss_count += 1
        self._health.lose(kind, detail, offset)


def _tail(file: BinaryIO, size_bytes: int) -> tuple[Any, ...] | None:
    """The fields of the footer and the magic behind it; None where the file does not end with them."""
    file.seek(max(size_bytes - TAIL.size, 0))
    tail = file.read()
    if len(tail) != TAIL.size or tail[: HEAD.size] != HEAD.pack(Opcode.FOOTER, 20) or tail[-8:] != MAGIC:
        return None
    return TAIL.unpack(tail)


def _expanded(chunk: Chunk, limits: Limits, *, is_whole: bool = True) -> Chunk:
    """The chunk without compression; ValueError where it is whole and not of exactly the size that it declares."""
    size_bytes = chunk.uncompressed_size
    if size_bytes > limits.chunk_bytes:
        raise ValueError(f"{size_bytes} bytes declared, the limit is {limits.chunk_bytes}")
    match chunk.compression:
        case "":
            data = chunk.data
        case "zstd":
            # In a stream: a frame that declares a size of its own would be expanded to that at once.
            decompressor = zstandard.ZstdDecompressor(max_window_size=limits.window_bytes)
            data = decompressor.stream_reader(chunk.data).read(size_bytes + 1)
        case "lz4":
            import lz4.frame  # here, for few logs have it

            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size_bytes + 1)
        case other:
            raise ValueError(f"compression {other!r} is not known; the choices are zstd, lz4, none")
    if is_whole and len(data) != size_bytes:
        raise ValueError(f"{size_bytes} bytes declared, found {len(data)}")
    return replace(chunk, compression="", data=data)

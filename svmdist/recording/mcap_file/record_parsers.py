"""The inner layer of MCAP: parsers of single records, which read strictly and trust no length."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from io import BytesIO
from typing import cast

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from svmdist.recording.source import MAX_NAME_BYTES

CHUNK_HEAD = struct.Struct("<QQQII")
MESSAGE_HEAD = struct.Struct("<HIQQ")
CHUNK_INDEX_HEAD = struct.Struct("<QQQQ")
MAX_COMPRESSION_NAME_BYTES = 64


class MalformedRecordError(ValueError):
    """A body does not hold what its record must hold."""


class StrictStream(ReadDataStream):
    """The library's stream over one body, which refuses to deliver less than was asked for."""

    def __init__(self, body: bytes | memoryview) -> None:
        super().__init__(BytesIO(body))
        self._left = len(body)

    def read(self, length: int) -> bytes:
        """Read bytes; MalformedRecordError when the body is shorter."""
        if length > self._left:
            raise MalformedRecordError(f"{length} bytes expected, {self._left} left")
        self._left -= length
        return super().read(length)

    def read_name(self, what: str) -> str:
        """Read the name of something; MalformedRecordError when it is longer than a name, or not UTF-8."""
        length = self.read4()
        if length > MAX_NAME_BYTES:
            raise MalformedRecordError(f"a {what} of {length} bytes, the limit is {MAX_NAME_BYTES}")
        try:
            return str(self.read(length), "utf-8")
        except UnicodeDecodeError as problem:
            raise MalformedRecordError(str(problem)) from None


_RECORD_TYPES: dict[int, type[McapRecord]] = {
    Opcode.HEADER: Header,
    Opcode.FOOTER: Footer,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.MESSAGE_INDEX: MessageIndex,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT: Attachment,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.STATISTICS: Statistics,
    Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.SUMMARY_OFFSET: SummaryOffset,
    Opcode.DATA_END: DataEnd,
}


def parse(opcode: int, body: bytes | memoryview) -> McapRecord:
    """Read the body of a record with the mcap library; MalformedRecordError when it does not hold one.

    Time and memory grow with the body: bound its size before, for maps cost a hundred times their bytes.
    """
    try:
        if opcode == Opcode.MESSAGE:
            if len(body) < MESSAGE_HEAD.size:
                raise MalformedRecordError("a message needs 22 bytes")
            return cast(McapRecord, Message.read(StrictStream(body), len(body)))
        record = _RECORD_TYPES[opcode].read(StrictStream(body))  # type: ignore[attr-defined]
    except (EndOfFile, struct.error, UnicodeDecodeError, KeyError) as problem:
        raise MalformedRecordError(str(problem) or "it ends early") from None
    return cast(McapRecord, record)


@dataclass(frozen=True, slots=True)
class SchemaBody:
    """A schema as a file declares it."""

    id: int
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class ChannelBody:
    """A channel as a file declares it, without its metadata, which nothing here needs."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str


@dataclass(frozen=True, slots=True)
class ChunkBody:
    """A chunk before expansion; `data` is shorter than `data_length` where the file ends inside it."""

    uncompressed_size: int
    uncompressed_crc: int
    compression: str
    data_start: int
    data_length: int
    data: memoryview


def parse_schema(body: memoryview) -> SchemaBody:
    """Read a schema record."""
    stream = StrictStream(body)
    schema_id = stream.read2()
    name, encoding = stream.read_name("schema"), stream.read_name("schema encoding")
    return SchemaBody(schema_id, name, encoding, stream.read(stream.read4()))


def parse_channel(body: memoryview) -> ChannelBody:
    """Read a channel record."""
    stream = StrictStream(body)
    channel_id, schema_id = stream.read2(), stream.read2()
    topic, message_encoding = stream.read_name("topic"), stream.read_name("message encoding")
    return ChannelBody(channel_id, schema_id, topic, message_encoding)


def parse_chunk(body: bytes) -> ChunkBody:
    """Read a chunk record; the data may be truncated, the fields before it may not."""
    if len(body) < CHUNK_HEAD.size:
        raise MalformedRecordError("a chunk's head is incomplete")
    _, _, size, crc, name_length = CHUNK_HEAD.unpack_from(body)
    data_start = CHUNK_HEAD.size + name_length + 8
    if name_length > MAX_COMPRESSION_NAME_BYTES or data_start > len(body):
        raise MalformedRecordError("a chunk's head is incomplete")
    name = body[CHUNK_HEAD.size : CHUNK_HEAD.size + name_length]
    data_length = int.from_bytes(body[data_start - 8 : data_start], "little")
    data = memoryview(body)[data_start : data_start + min(data_length, len(body))]
    return ChunkBody(size, crc, name.decode("utf-8", "replace"), data_start, data_length, data)


def is_attachment_intact(body: memoryview) -> bool:
    """Compare an attachment's CRC with the one that it declares behind its data; 0 means that it has none."""
    stream = StrictStream(body)
    try:
        stream.read(16)
        stream.read(stream.read4())
        stream.read(stream.read4())
        stream.read(stream.read8())
        covered = stream.count
        declared = stream.read4()
    except MalformedRecordError:
        return False
    return declared in {0, zlib.crc32(body[:covered])}

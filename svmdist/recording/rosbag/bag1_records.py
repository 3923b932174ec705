"""The records of ROS 1 bags, checked before memory is allocated, and the content of their chunks."""

from __future__ import annotations

import bz2
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

from svmdist.profile import Limits
from svmdist.recording.decompress import DecompressionError, decompress, decompress_prefix
from svmdist.recording.effort import Effort
from svmdist.recording.source import MAX_NAME_BYTES

MAGIC = b"#ROSBAG V2.0\n"
OP_MESSAGE, OP_BAG_HEADER, OP_CHUNK, OP_CHUNK_INFO, OP_CONNECTION = 2, 3, 5, 6, 7
MAX_HEADER_BYTES = 1 << 20
LENGTH = struct.Struct("<I")
COMPRESSIONS = {b"none": "", b"lz4": "lz4", b"bz2": "bz2"}
NS = 1_000_000_000


class BrokenRecordError(ValueError):
    """A record that does not hold what it must."""


@dataclass(frozen=True, slots=True)
class BagRecord:
    """One record: its fields by name, and its data, shorter than declared where the file ends inside it."""

    offset: int
    fields: dict[bytes, bytes]
    data: bytes | memoryview
    data_length: int

    @property
    def op(self) -> int:
        """What kind of record it is, by the values OP_*; -1 where it does not say."""
        return int.from_bytes(self.fields[b"op"], "little") if b"op" in self.fields else -1

    @property
    def is_truncated(self) -> bool:
        """Whether the file ends inside this record."""
        return len(self.data) < self.data_length

    def number(self, name: bytes) -> int:
        """Read a field as an unsigned number; BrokenRecordError where there is none."""
        if name not in self.fields or len(self.fields[name]) > 8:
            raise BrokenRecordError(f"a record has no number {name.decode()}")
        return int.from_bytes(self.fields[name], "little")

    def text(self, name: bytes) -> str:
        """Read a field as text; BrokenRecordError where there is none."""
        if len(self.fields.get(name, b"")) > MAX_NAME_BYTES:
            raise BrokenRecordError(f"a {name.decode()} of more than {MAX_NAME_BYTES} bytes")
        try:
            return self.fields[name].decode("utf-8")
        except (KeyError, UnicodeDecodeError):
            raise BrokenRecordError(f"a record has no text {name.decode()}") from None

    def time_ns(self) -> int:
        """Read the field `time`; BrokenRecordError where there is none."""
        if len(self.fields.get(b"time", b"")) != 8:
            raise BrokenRecordError("a message has no time")
        seconds, nanoseconds = struct.unpack("<II", self.fields[b"time"])
        return int(seconds * NS + nanoseconds)


def read_record(file: BinaryIO, size_bytes: int, limits: Limits) -> BagRecord | None:
    """Read the next record of a bag; None where the file ends before its data begin.

    Raises BrokenRecordError for lengths that cannot be.
    """
    offset = file.tell()
    header = _read_block(file, size_bytes, min(MAX_HEADER_BYTES, limits.record_bytes))
    if header is None or file.tell() + LENGTH.size > size_bytes:
        return None
    (length,) = LENGTH.unpack(file.read(LENGTH.size))
    if length > limits.record_bytes:
        raise BrokenRecordError(f"a record of {length} bytes, the limit is {limits.record_bytes}")
    return BagRecord(offset, parse_fields(header), file.read(length), length)


def _read_block(file: BinaryIO, size_bytes: int, limit: int) -> bytes | None:
    head = file.read(LENGTH.size)
    if len(head) < LENGTH.size:
        return None
    (length,) = LENGTH.unpack(head)
    if length > limit:
        raise BrokenRecordError(f"a header of {length} bytes, the limit is {limit}")
    return file.read(length) if file.tell() + length <= size_bytes else None


def parse_fields(header: bytes | memoryview) -> dict[bytes, bytes]:
    """Split a header into its fields, each `name=value` behind a length."""
    view = bytes(header)
    fields = {}
    position = 0
    while position < len(view):
        if position + LENGTH.size > len(view):
            raise BrokenRecordError("a header is malformed")
        (length,) = LENGTH.unpack_from(view, position)
        position += LENGTH.size
        name, equals, value = view[position : position + length].partition(b"=")
        if not equals or position + length > len(view):
            raise BrokenRecordError("a header is malformed")
        fields[name] = value
        position += length
    return fields


def chunk_records(chunk: BagRecord, limits: Limits, effort: Effort) -> Iterator[BagRecord]:
    """Yield the complete records inside a chunk, of a truncated one those in its readable prefix.

    Raises BrokenRecordError for a chunk that does not expand, before the first record of it, and
    TooMuchError where the bag expands to more than its size allows.
    """
    content = _expand(chunk, limits)
    effort.expand(len(content))
    position, count = 0, 0
    while position + LENGTH.size <= len(content):
        (header_length,) = LENGTH.unpack_from(content, position)
        data_place = position + LENGTH.size + header_length
        if data_place + LENGTH.size > len(content):
            break
        (data_length,) = LENGTH.unpack_from(content, data_place)
        end = data_place + LENGTH.size + data_length
        if end > len(content):
            break
        count += 1
        if count > limits.chunk_records:
            raise BrokenRecordError(f"more than {limits.chunk_records} records in a chunk")
        fields = parse_fields(content[position + LENGTH.size : data_place])
        yield BagRecord(chunk.offset, fields, content[data_place + LENGTH.size : end], data_length)
        position = end
    if position < len(content) and not chunk.is_truncated:
        raise BrokenRecordError("the last record of a chunk is incomplete")


def _expand(chunk: BagRecord, limits: Limits) -> memoryview:
    name = chunk.fields.get(b"compression", b"")
    if name not in COMPRESSIONS:
        raise BrokenRecordError(f"compression {name!r} is not known; the choices are none, lz4, bz2")
    size_bytes = chunk.number(b"size")
    data = memoryview(chunk.data)
    try:
        if name == b"bz2":
            return _expand_bz2(data, size_bytes, limits, is_truncated=chunk.is_truncated)
        expand = decompress_prefix if chunk.is_truncated else decompress
        return expand(COMPRESSIONS[name], data, size_bytes, limits)
    except (DecompressionError, OSError, ValueError) as problem:
        raise BrokenRecordError(f"a chunk does not expand: {problem}") from None


def _expand_bz2(data: memoryview, size_bytes: int, limits: Limits, *, is_truncated: bool) -> memoryview:
    if size_bytes > limits.chunk_bytes:
        raise DecompressionError(f"{size_bytes} bytes declared, the limit is {limits.chunk_bytes}")
    content = bz2.BZ2Decompressor().decompress(data, size_bytes + 1)
    if len(content) > size_bytes or (len(content) < size_bytes and not is_truncated):
        raise DecompressionError(f"{size_bytes} bytes declared, found {len(content)} or more")
    return memoryview(content)

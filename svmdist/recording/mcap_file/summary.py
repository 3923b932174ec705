"""The end of an MCAP file: whether it is there, whether its CRC is right, and what it declares."""

from __future__ import annotations

import struct
import zlib
from array import array
from dataclasses import dataclass, field
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Footer, Statistics

from svmdist.profile import Limits
from svmdist.recording.mcap_file.framing import HEAD, MAGIC, TAIL_BYTES, split_records
from svmdist.recording.mcap_file.record_parsers import (
    CHUNK_INDEX_HEAD,
    ChannelBody,
    MalformedRecordError,
    SchemaBody,
    parse,
    parse_channel,
    parse_schema,
)

CHUNK_CHANNELS = struct.Struct("<HQ")


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """Where a chunk is, and the channels of its messages; none where its index does not name them."""

    offset: int
    length: int
    channels: frozenset[int]


@dataclass
class Summary:
    """What the summary section declares. `chunks` and `metadata_places` are kept where a list is given for them."""

    schemas: dict[int, SchemaBody] = field(default_factory=dict)
    channels: dict[int, ChannelBody] = field(default_factory=dict)
    chunk_offsets: array[int] = field(default_factory=lambda: array("Q"))
    statistics: Statistics | None = None
    start: int = 0
    definition_bytes: int = 0
    chunks: list[ChunkPlace] | None = None
    metadata_places: list[tuple[int, int]] | None = None
    """Offset and length of each metadata record."""

    def add(self, opcode: int, body: memoryview, limits: Limits) -> None:
        """Take note of a record of the summary section; MalformedRecordError when it cannot be read."""
        if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            self.definition_bytes += len(body)
            if self.definition_bytes > limits.definition_bytes:
                raise MalformedRecordError(f"definitions of more than {limits.definition_bytes} bytes")
        match opcode:
            case Opcode.SCHEMA:
                schema = parse_schema(body)
                self.schemas[schema.id] = schema
            case Opcode.CHANNEL:
                channel = parse_channel(body)
                self.channels[channel.id] = channel
            case Opcode.CHUNK_INDEX:
                if len(body) < CHUNK_INDEX_HEAD.size:
                    raise MalformedRecordError("a chunk index is too short")
                self.chunk_offsets.append(CHUNK_INDEX_HEAD.unpack_from(body)[2])
                if self.chunks is not None:
                    self.chunks.append(_chunk_place(body))
            case Opcode.METADATA_INDEX if self.metadata_places is not None:
                if len(body) < 16:
                    raise MalformedRecordError("a metadata index is too short")
                self.metadata_places.append(
                    (int.from_bytes(body[:8], "little"), int.from_bytes(body[8:16], "little"))
                )
            case Opcode.STATISTICS:
                if len(body) > limits.metadata_bytes:
                    raise MalformedRecordError(
                        f"statistics of {len(body)} bytes, the limit is {limits.metadata_bytes}"
                    )
                statistics = parse(opcode, body)
                assert isinstance(statistics, Statistics)
                self.statistics = statistics
            case _:
                pass


def read_footer(file: BinaryIO, size_bytes: int) -> Footer | None:
    """Read the footer where the file ends with one and the magic; None for a file that is truncated or broken."""
    if size_bytes < len(MAGIC) + TAIL_BYTES:
        return None
    file.seek(size_bytes - TAIL_BYTES)
    tail = file.read(TAIL_BYTES)
    if not tail.endswith(MAGIC) or HEAD.unpack_from(tail) != (
        Opcode.FOOTER,
        TAIL_BYTES - HEAD.size - len(MAGIC),
    ):
        return None
    footer = parse(Opcode.FOOTER, tail[HEAD.size : -len(MAGIC)])
    assert isinstance(footer, Footer)
    return footer


def _chunk_place(body: memoryview) -> ChunkPlace:
    _, _, offset, length = CHUNK_INDEX_HEAD.unpack_from(body)
    begin = CHUNK_INDEX_HEAD.size + 4
    size = int.from_bytes(body[begin - 4 : begin], "little")
    places = body[begin : begin + size]
    if len(places) != size or size % CHUNK_CHANNELS.size:
        raise MalformedRecordError("the channels of a chunk index are incomplete")
    return ChunkPlace(offset, length, frozenset(channel for channel, _ in CHUNK_CHANNELS.iter_unpack(places)))


def read_trusted_summary(
    file: BinaryIO, size_bytes: int, limits: Limits, *, with_places: bool = False
) -> Summary | None:
    """Read the summary section where its CRC covers every byte of it and is right; None otherwise.

    With `with_places` it holds where chunks and metadata are, and what is in the chunks.
    """
    footer = read_footer(file, size_bytes)
    if footer is None or footer.summary_crc == 0 or footer.summary_start == 0:
        return None
    length = size_bytes - TAIL_BYTES - footer.summary_start
    if not 0 <= length <= limits.record_bytes:
        return None
    file.seek(footer.summary_start)
    section = file.read(length + HEAD.size + 16)  # the CRC covers the footer up to the CRC itself
    if zlib.crc32(section) != footer.summary_crc:
        return None
    summary = Summary(start=footer.summary_start)
    if with_places:
        summary.chunks, summary.metadata_places = [], []
    try:
        for opcode, _, body in split_records(memoryview(section)[:length]):
            summary.add(opcode, body, limits)
    except MalformedRecordError:
        return None
    return summary

"""The end of an MCAP file: whether it is there, whether its CRC is right, and what it declares."""

from __future__ import annotations

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


@dataclass
class Summary:
    """What the summary section declares."""

    schemas: dict[int, SchemaBody] = field(default_factory=dict)
    channels: dict[int, ChannelBody] = field(default_factory=dict)
    chunk_offsets: array[int] = field(default_factory=lambda: array("Q"))
    statistics: Statistics | None = None
    start: int = 0
    definition_bytes: int = 0

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


def read_trusted_summary(file: BinaryIO, size_bytes: int, limits: Limits) -> Summary | None:
    """Read the summary section where its CRC covers every byte of it and is right; None otherwise."""
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
    try:
        for opcode, _, body in split_records(memoryview(section)[:length]):
            summary.add(opcode, body, limits)
    except MalformedRecordError:
        return None
    return summary

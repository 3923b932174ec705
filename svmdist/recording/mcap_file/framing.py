"""The outer layer of MCAP: records one after another in file order, checked before memory is allocated."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

from svmdist.profile import Limits

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
FOOTER_BODY_BYTES = 20
TAIL_BYTES = HEAD.size + FOOTER_BODY_BYTES + len(MAGIC)
SKIP_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Frame:
    """One record: its opcode, the place of its head in the file, and its body as declared or as far as it goes.

    `crc_before` is the CRC-32 of everything between the start of the section and this record. `body` is
    None for a record above the limit, which was skipped.
    """

    opcode: int
    offset: int
    length: int
    body: bytes | None
    crc_before: int

    @property
    def end(self) -> int:
        """Place behind the last byte, by the declared length."""
        return self.offset + HEAD.size + self.length

    @property
    def is_truncated(self) -> bool:
        """Whether the file ends inside this record."""
        return self.body is not None and len(self.body) < self.length


class FrameStream:
    """Reads records from a file with a running CRC, which whoever reads sets to 0 where a section starts."""

    def __init__(self, file: BinaryIO, size_bytes: int, limits: Limits) -> None:
        self.position = 0
        self.crc = 0
        self._file = file
        self._size_bytes = size_bytes
        self._limits = limits

    @property
    def remaining_bytes(self) -> int:
        """Bytes between here and the end of the file."""
        return self._size_bytes - self.position

    def read(self, count: int) -> bytes:
        """Read bytes; fewer only at the end of the file."""
        data = self._file.read(min(count, max(self.remaining_bytes, 0)))
        self.position += len(data)
        self.crc = zlib.crc32(data, self.crc)
        return data

    def jump(self, offset: int) -> None:
        """Go on at another place; the running CRC means nothing from then on."""
        self._file.seek(offset)
        self.position = offset

    def next_frame(self) -> Frame | None:
        """Read the next record, truncated where the file ends inside it; None where no head fits any more."""
        offset, crc_before = self.position, self.crc
        if self.remaining_bytes < HEAD.size:
            return None
        head = self.read(HEAD.size)
        if len(head) < HEAD.size:  # the file has shrunk since it was opened
            self._size_bytes = self.position
            return None
        opcode, length = HEAD.unpack(head)
        if length > self._limits.record_bytes and length <= self.remaining_bytes:
            self._skip(length)
            return Frame(opcode, offset, length, None, crc_before)
        if length > self.remaining_bytes and self.remaining_bytes > self._limits.record_bytes:
            return Frame(opcode, offset, length, b"", crc_before)
        return Frame(opcode, offset, length, self.read(length), crc_before)

    def _skip(self, count: int) -> None:
        while count > 0 and (piece := self.read(min(count, SKIP_BYTES))):
            count -= len(piece)


def split_records(data: bytes | bytearray | memoryview) -> Iterator[tuple[int, int, memoryview]]:
    """Yield opcode, place and body of the complete records in an expanded chunk; stop at an incomplete one.

    Whether the end was met shows in the last record: it reaches to the end of the data.
    """
    view = memoryview(data)
    position, end = 0, len(view)
    while position + HEAD.size <= end:
        opcode, length = HEAD.unpack_from(view, position)
        start = position + HEAD.size
        if length > end - start:
            return
        yield opcode, position, view[start : start + length]
        position = start + length

"""One chunk: from its record to its verified content."""

from __future__ import annotations

import zlib

from svmdist.profile import Limits
from svmdist.recording.decompress import DecompressionError, decompress, decompress_prefix
from svmdist.recording.effort import Effort
from svmdist.recording.mcap_file.record_parsers import ChunkBody, MalformedRecordError, parse_chunk


class ChunkError(ValueError):
    """A chunk that cannot be used; `is_misframed` when its length contradicts its content."""

    def __init__(self, reason: str, *, is_misframed: bool = False) -> None:
        super().__init__(reason)
        self.is_misframed = is_misframed


def expand_chunk(body: bytes, limits: Limits, effort: Effort) -> tuple[memoryview, int]:
    """Expand a chunk and verify its CRC; ChunkError says why it cannot be used.

    The number tells how many bytes of the body are known fields: what is behind them may be fields of a newer
    version of MCAP, or other records where the length of this one is wrong. TooMuchError when the file expands to
    more than its size allows.
    """
    chunk = _parse(body)
    if len(chunk.data) < chunk.data_length:
        raise ChunkError("its data are longer than its record", is_misframed=True)
    data = _expand_whole(chunk, limits)
    effort.expand(len(data))
    return data, chunk.data_start + chunk.data_length


def expand_truncated_chunk(body: bytes, limits: Limits, *, may_be_prefix: bool) -> memoryview:
    """Expand what is there of a chunk that the file ends in; ChunkError when nothing of it can be trusted.

    Where all of its data are there, the CRC decides. Where they are not, and the file was truncated rather
    than corrupted (`may_be_prefix`), the prefix is what was written.
    """
    chunk = _parse(body)
    if len(chunk.data) == chunk.data_length and chunk.uncompressed_crc != 0:
        return _expand_whole(chunk, limits)
    if not may_be_prefix:
        raise ChunkError("it is incomplete")
    try:
        return decompress_prefix(chunk.compression, chunk.data, chunk.uncompressed_size, limits)
    except DecompressionError as problem:
        raise ChunkError(str(problem)) from None


def _parse(body: bytes) -> ChunkBody:
    try:
        return parse_chunk(body)
    except MalformedRecordError as problem:
        raise ChunkError(str(problem), is_misframed=True) from None


def _expand_whole(chunk: ChunkBody, limits: Limits) -> memoryview:
    try:
        data = decompress(chunk.compression, chunk.data, chunk.uncompressed_size, limits)
    except DecompressionError as problem:
        raise ChunkError(str(problem)) from None
    if chunk.uncompressed_crc != 0 and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ChunkError("its CRC is wrong")
    return data

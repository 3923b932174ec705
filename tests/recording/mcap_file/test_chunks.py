"""Chunks: delivered when size and CRC are right; otherwise the error tells what is wrong."""

from __future__ import annotations

import random
import struct

import pytest

from svmdist.profile import Limits
from svmdist.recording.effort import Effort
from svmdist.recording.mcap_file.chunks import ChunkError, expand_chunk, expand_truncated_chunk
from tests.recording.faults import pack_chunk

LIMITS = Limits()
CONTENT = random.Random(2).randbytes(3000) + bytes(3000)
COMPRESSIONS = pytest.mark.parametrize(
    "compression",
    [pytest.param("", id="none"), pytest.param("zstd", id="zstd"), pytest.param("lz4", id="lz4")],
)


@COMPRESSIONS
def test_a_chunk_gives_its_content_and_the_length_of_its_fields(compression: str) -> None:
    """Bytes behind the fields may be those of a newer version: they are not counted."""
    body = pack_chunk(compression, CONTENT)
    for behind in (b"", b"new field"):
        content, known_bytes = expand_chunk(body + behind, LIMITS, Effort(0))
        assert bytes(content) == CONTENT
        assert known_bytes == len(body)


@COMPRESSIONS
def test_a_flipped_byte_of_the_data_is_always_told(compression: str) -> None:
    """CRC-32 finds every change within 32 bits; what does not expand is told too."""
    body = pack_chunk(compression, CONTENT)
    data_start = 40 + len(compression)
    for place in random.Random(4).sample(range(data_start, len(body)), 100):
        broken = bytearray(body)
        broken[place] ^= 0x10
        try:
            content, _ = expand_chunk(bytes(broken), LIMITS, Effort(0))
        except ChunkError:
            continue
        assert bytes(content) == CONTENT  # a byte of the compression's own that says nothing of the content


def test_a_wrong_crc_is_told_and_none_is_accepted() -> None:
    """A CRC of 0 means that the writer gave none."""
    with pytest.raises(ChunkError, match="its CRC is wrong"):
        expand_chunk(pack_chunk("zstd", CONTENT, crc=1), LIMITS, Effort(0))
    assert bytes(expand_chunk(pack_chunk("zstd", CONTENT, crc=0), LIMITS, Effort(0))[0]) == CONTENT


def test_another_size_than_the_declared_one_is_told() -> None:
    for size_bytes in (len(CONTENT) - 1, len(CONTENT) + 1, 1 << 60):
        with pytest.raises(ChunkError, match="bytes declared"):
            expand_chunk(pack_chunk("zstd", CONTENT, size_bytes), LIMITS, Effort(0))


@pytest.mark.parametrize("end", [0, 31, 35, 43, -1])
def test_a_body_that_contradicts_its_length_is_misframed(end: int) -> None:
    """Truncated in the head, or before the end of the data: the length of the record is what is wrong."""
    with pytest.raises(ChunkError) as told:
        expand_chunk(pack_chunk("zstd", CONTENT)[:end], LIMITS, Effort(0))
    assert told.value.is_misframed
    with pytest.raises(ChunkError) as told:
        expand_chunk(pack_chunk("zstd", CONTENT, crc=1), LIMITS, Effort(0))
    assert not told.value.is_misframed


def test_a_name_of_a_compression_without_an_end_is_misframed() -> None:
    head = struct.pack("<QQQII", 0, 0, 10, 0, 1 << 31)
    with pytest.raises(ChunkError, match="head is incomplete") as told:
        expand_chunk(head + bytes(100), LIMITS, Effort(0))
    assert told.value.is_misframed


@COMPRESSIONS
def test_of_a_truncated_chunk_a_prefix_comes_out_where_it_may(compression: str) -> None:
    body = pack_chunk(compression, CONTENT)
    for end in (len(body) - 1, len(body) * 2 // 3):
        content = expand_truncated_chunk(body[:end], LIMITS, may_be_prefix=True)
        assert CONTENT.startswith(bytes(content))
        with pytest.raises(ChunkError, match="it is incomplete"):
            expand_truncated_chunk(body[:end], LIMITS, may_be_prefix=False)


def test_where_all_data_of_a_truncated_chunk_are_there_the_crc_decides() -> None:
    for may_be_prefix in (False, True):
        content = expand_truncated_chunk(pack_chunk("lz4", CONTENT), LIMITS, may_be_prefix=may_be_prefix)
        assert bytes(content) == CONTENT
        with pytest.raises(ChunkError, match="its CRC is wrong"):
            expand_truncated_chunk(pack_chunk("lz4", CONTENT, crc=1), LIMITS, may_be_prefix=may_be_prefix)


def test_a_truncated_chunk_keeps_to_the_limit() -> None:
    body = pack_chunk("zstd", CONTENT)
    with pytest.raises(ChunkError, match="the limit is 1024"):
        expand_truncated_chunk(body[:-1], Limits(chunk_bytes=1024), may_be_prefix=True)

"""Expanding: what was compressed comes back to the byte, and nothing grows beyond what is declared."""

from __future__ import annotations

import random

import lz4.frame
import pytest
import zstandard

from svmdist.profile import Limits
from svmdist.recording.decompress import (
    STEP_BYTES,
    DecompressionError,
    decompress,
    decompress_message,
    decompress_prefix,
)

from .faults import COMPRESS

LIMITS = Limits()
CONTENT = random.Random(1).randbytes(50_000) + bytes(50_000)
COMPRESSIONS = pytest.mark.parametrize(
    "compression",
    [pytest.param("", id="none"), pytest.param("zstd", id="zstd"), pytest.param("lz4", id="lz4")],
)


@COMPRESSIONS
@pytest.mark.parametrize("size_bytes", [1, 100, STEP_BYTES, STEP_BYTES + 1])
def test_what_was_compressed_comes_back(compression: str, size_bytes: int) -> None:
    """Byte for byte, also where the content is one step of the loop or a byte more."""
    content = (CONTENT * 11)[:size_bytes]
    data = memoryview(COMPRESS[compression](content))
    assert bytes(decompress(compression, data, size_bytes, LIMITS)) == content


@COMPRESSIONS
@pytest.mark.parametrize("wrong_by", [-1, 1])
def test_another_size_than_the_declared_one_is_refused(compression: str, wrong_by: int) -> None:
    data = memoryview(COMPRESS[compression](CONTENT))
    with pytest.raises(DecompressionError, match="bytes declared, found"):
        decompress(compression, data, len(CONTENT) + wrong_by, LIMITS)


@COMPRESSIONS
def test_a_size_above_the_limit_is_refused_before_the_data_are_read(compression: str) -> None:
    """The data are no compressed ones, and that is not what the error tells: nothing was expanded."""
    limits = Limits(chunk_bytes=1024)
    for expand in (decompress, decompress_prefix):
        with pytest.raises(DecompressionError, match="1025 bytes declared, the limit is 1024"):
            expand(compression, memoryview(b"no frame"), 1025, limits)
    content = CONTENT[:1024]
    assert bytes(decompress(compression, memoryview(COMPRESS[compression](content)), 1024, limits)) == content


@COMPRESSIONS
def test_a_prefix_of_the_data_gives_a_prefix_of_the_content(compression: str) -> None:
    """At any place where the data may end; all of them give all."""
    data = COMPRESS[compression](CONTENT)
    for end in (0, 1, 10, len(data) // 3, len(data) - 1, len(data)):
        try:
            found = bytes(decompress_prefix(compression, memoryview(data)[:end], len(CONTENT), LIMITS))
        except DecompressionError:
            assert end < len(data)
            continue
        assert CONTENT.startswith(found)
        assert end < len(data) or found == CONTENT


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_what_is_no_frame_is_refused(compression: str) -> None:
    for expand in (decompress, decompress_prefix):
        with pytest.raises(DecompressionError, match=compression):
            expand(compression, memoryview(b"\xff" * 100), 1000, LIMITS)


def test_an_unknown_compression_is_refused_with_the_choices() -> None:
    with pytest.raises(DecompressionError, match="'br' is not known; the choices are zstd, lz4, none"):
        decompress("br", memoryview(b""), 0, LIMITS)


def test_data_behind_an_lz4_frame_are_refused() -> None:
    data = memoryview(lz4.frame.compress(CONTENT) + b"more")
    with pytest.raises(DecompressionError, match="data behind the end"):
        decompress("lz4", data, len(CONTENT), LIMITS)


def test_a_zstd_window_above_the_limit_is_refused() -> None:
    """A frame of a window of 2^22 bytes, which the limit allows or does not."""
    parameters = zstandard.ZstdCompressionParameters(window_log=22)
    compressor = zstandard.ZstdCompressor(compression_params=parameters).compressobj()
    data = memoryview(compressor.compress(CONTENT) + compressor.flush())
    assert bytes(decompress("zstd", data, len(CONTENT), Limits(window_bytes=1 << 22))) == CONTENT
    with pytest.raises(DecompressionError, match="zstd"):
        decompress("zstd", data, len(CONTENT), Limits(window_bytes=1 << 20))


def test_a_message_is_expanded_by_the_size_that_it_declares() -> None:
    data = zstandard.compress(CONTENT)
    assert bytes(decompress_message(data, len(CONTENT), LIMITS)) == CONTENT
    assert bytes(decompress_message(memoryview(data), len(CONTENT), LIMITS)) == CONTENT


def test_a_message_that_cannot_be_expanded_is_refused() -> None:
    """Too large, without a size, no zstd at all, or ended early."""
    data = zstandard.compress(CONTENT)
    sizeless = zstandard.ZstdCompressor(write_content_size=False).compress(CONTENT)
    refused = {
        f"a message of {len(CONTENT)} bytes declared, the limit is": (data, len(CONTENT) - 1),
        "does not declare its size": (sizeless, len(CONTENT)),
        "not compressed with zstd": (b"plain", 100),
        "bytes declared, found": (data[:-10], len(CONTENT)),
    }
    for reason, (broken, limit_bytes) in refused.items():
        with pytest.raises(DecompressionError, match=reason):
            decompress_message(broken, limit_bytes, LIMITS)

"""Expanding chunks: streaming, capped at the declared size, exact prefixes for truncated chunks."""

from __future__ import annotations

import zstandard

from svmdist.profile import Limits

STEP_BYTES = 1 << 20
ZSTD_HEAD_BYTES = 18


class DecompressionError(ValueError):
    """A chunk cannot be expanded to what it declares."""


def decompress(compression: str, data: memoryview, size_bytes: int, limits: Limits) -> memoryview:
    """Expand a whole chunk; it must give exactly the declared size.

    Raises DecompressionError for an unknown compression, a size above the limit, data that do not
    expand, and data that expand to another size. Never allocates more than the declared size allows.
    """
    expanded = _expand(compression, data, size_bytes, limits)
    if len(expanded) != size_bytes:
        raise DecompressionError(f"{size_bytes} bytes declared, found {len(expanded)}")
    return expanded


def decompress_prefix(compression: str, data: memoryview, size_bytes: int, limits: Limits) -> memoryview:
    """Expand as much of a truncated chunk as its first bytes tell: an exact prefix of what was compressed."""
    return _expand(compression, data, size_bytes, limits)


def decompress_message(data: bytes | memoryview, limit_bytes: int, limits: Limits) -> memoryview:
    """Expand one message that was compressed on its own with zstd; it must declare its size."""
    try:
        size_bytes = zstandard.frame_content_size(bytes(data[:ZSTD_HEAD_BYTES]))
    except zstandard.ZstdError as problem:
        raise DecompressionError(f"not compressed with zstd: {problem}") from None
    if size_bytes < 0:
        raise DecompressionError("a compressed message does not declare its size")
    if size_bytes > limit_bytes:
        raise DecompressionError(f"a message of {size_bytes} bytes declared, the limit is {limit_bytes}")
    return decompress("zstd", memoryview(data), size_bytes, limits)


def _expand(compression: str, data: memoryview, size_bytes: int, limits: Limits) -> memoryview:
    if size_bytes > limits.chunk_bytes:
        raise DecompressionError(f"{size_bytes} bytes declared, the limit is {limits.chunk_bytes}")
    try:
        match compression:
            case "":
                expanded = data
            case "zstd":
                expanded = _expand_zstd(data, size_bytes, limits)
            case "lz4":
                expanded = _expand_lz4(data, size_bytes)
            case _:
                raise DecompressionError(
                    f"compression {compression!r} is not known; the choices are zstd, lz4, none"
                )
    except (zstandard.ZstdError, RuntimeError, MemoryError, EOFError) as problem:
        raise DecompressionError(f"{compression}: {problem}") from None
    if len(expanded) > size_bytes:
        raise DecompressionError(f"{size_bytes} bytes declared, found more")
    return expanded


def _expand_zstd(data: memoryview, size_bytes: int, limits: Limits) -> memoryview:
    decompressor = zstandard.ZstdDecompressor(max_window_size=limits.window_bytes)
    # The memory is touched only as far as data arrive, so a false size costs nothing.
    target = memoryview(bytearray(size_bytes + 1))
    filled = 0
    with decompressor.stream_reader(data, read_across_frames=True) as reader:
        while filled <= size_bytes:
            count = reader.readinto(target[filled : filled + STEP_BYTES])
            if not count:
                break
            filled += count
    return target[:filled]


def _expand_lz4(data: memoryview, size_bytes: int) -> memoryview:
    import lz4.frame  # here, for few logs have it

    decompressor = lz4.frame.LZ4FrameDecompressor()
    expanded = bytearray()
    pending = data
    while len(expanded) <= size_bytes:
        piece = decompressor.decompress(pending, max_length=min(STEP_BYTES, size_bytes + 1 - len(expanded)))
        expanded += piece
        if decompressor.eof:
            if decompressor.unused_data:
                raise DecompressionError("lz4: data behind the end of the frame")
            break
        if not piece and (decompressor.needs_input or len(pending) == 0):
            break
        pending = memoryview(b"")
    return memoryview(expanded)

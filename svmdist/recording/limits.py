"""What a recording may ask of the reader: the caps that keep a hostile or broken file harmless."""

from __future__ import annotations

from dataclasses import dataclass

MIB = 1 << 20


@dataclass(frozen=True)
class Limits:
    """Upper bounds, checked before memory is allocated; beyond one, the part is refused and counted as a loss."""

    record_bytes: int = 256 * MIB
    """One record of the file; it may never reach beyond the file either."""
    chunk_bytes: int = 256 * MIB
    """One chunk after expansion; it must have exactly the size that it declares."""
    chunk_records: int = 1_000_000
    """Records inside one chunk."""
    window_bytes: int = 128 * MIB
    """Memory that a zstd frame may claim for its window, beside the expanded chunk."""
    definition_bytes: int = 32 * MIB
    """Schemas and channels of a whole file, which stay in memory while it is read."""
    metadata_bytes: int = 1 * MIB
    """One metadata or statistics record."""
    image_pixels: int = 16_000_000
    """One image, by the dimensions in its header, before it is decoded."""
    image_bytes: int = 32 * MIB
    """One compressed image."""
    message_bytes: int = 1 * MIB
    """One message that is no image: joints, transforms and the like hold a few kilobytes."""
    json_bytes: int = 16 * MIB
    """One JSON message; parsing can take thirty times its size in memory."""

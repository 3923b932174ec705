"""The part of a profile about the log: its topics, its frames, and what it may ask of the reader."""

from __future__ import annotations

from pydantic import Field

from svmdist.toml_model import MIB, Size, StrictModel


class Topics(StrictModel):
    """Topic names of a log; None means: the one topic whose schema fits.

    The right camera's topics and the true transforms must be named: their schemas fit others as well.
    """

    image: str | None = None
    camera_info: str | None = None
    right_image: str | None = None
    right_camera_info: str | None = None
    joints: str | None = None
    pose: str | None = None
    tf: str | None = None
    ground_truth_tf: str | None = None
    ground_truth_distance: str | None = None


class Frames(StrictModel):
    """Frame names of a log's transforms."""

    camera: str = "camera"
    base: str = "base"
    tool: str = "tool"
    tissue: str = "tissue"


class Limits(StrictModel):
    """What a log may ask of the reader, checked before memory is allocated; what asks for more is a loss."""

    record_bytes: Size = 256 * MIB
    """One record of the file; it may never reach beyond the file either."""
    chunk_bytes: Size = 256 * MIB
    """One chunk after expansion; it must have exactly the size that it declares."""
    chunk_records: int = Field(default=1_000_000, ge=1)
    """Records inside one chunk."""
    window_bytes: Size = 128 * MIB
    """Memory that a zstd frame may claim for its window, beside the expanded chunk."""
    definition_bytes: Size = 32 * MIB
    """Schemas and channels of a whole file, which stay in memory while it is read."""
    metadata_bytes: Size = 1 * MIB
    """One metadata or statistics record."""
    image_pixels: int = Field(default=16_000_000, ge=1, le=1 << 26)
    """One image, by the dimensions in its header, before it is decoded; OpenCV itself is held to 2^26."""
    image_bytes: Size = 32 * MIB
    """One compressed image."""
    message_bytes: Size = 1 * MIB
    """One message that is no image: joints, transforms and the like hold a few kilobytes."""
    json_bytes: Size = 16 * MIB
    """One JSON message; parsing can take thirty times its size in memory."""
    pair_tolerance_s: float = Field(default=5e-4, ge=0.0, le=0.5)
    """How far the stamps of the left and the right image of a pair may be apart. Cameras that are triggered together
    differ by less than half a millisecond, which is less than any exposure; others by up to half a frame."""

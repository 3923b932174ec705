"""Two fields of a frame, one after the other."""

from __future__ import annotations

from svmdist.samples import Image

FIELD_NS = 1e9 / 60.0
"""Between both fields of an interlaced frame (59.94 fields a second, ITU-R BT.601)."""


def interlaced(first_bgr: Image, *later_bgr: Image) -> Image:
    """A frame of its fields: even rows of the first image, odd rows of the second where there is one."""
    if not later_bgr:
        return first_bgr
    frame = first_bgr.copy()
    frame[1::2] = later_bgr[0][1::2]
    return frame

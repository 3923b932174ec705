"""Decoding compressed stills: checked before OpenCV sees them, and never a pixel that was not written."""

from __future__ import annotations

import os
import struct
import zlib
from typing import Literal

# OpenCV reads this once, when it is imported; the header check below holds in any case.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 26))

import cv2
import numpy as np
import simplejpeg

from svmdist.profile import Limits
from svmdist.samples import Image

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
JPEG_MAGIC = b"\xff\xd8\xff"
JPEG_END = b"\xff\xd9"
JPEG_SCAN = b"\xff\xda"
MAX_JPEG_SCANS = 100
"""A progressive JPEG has about ten; each costs a pass over the whole image, whatever few bytes it takes."""
JPEG_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
JPEG_BARE_MARKERS = frozenset({0x01, *range(0xD0, 0xD9)})


class ImageError(ValueError):
    """An image that cannot be decoded, or must not be."""


def decode_still(data: bytes | memoryview, limits: Limits) -> Image:
    """Decode a PNG or JPEG to BGR, shape (height, width, 3) of uint8; grey becomes BGR, alpha is dropped.

    Raises ImageError for another format, a size above the limits, truncated or corrupt data, and for
    16-bit images, which would lose half of their bits.
    """
    data = bytes(data)
    width_px, height_px = still_size(data, limits)
    if data.startswith(PNG_MAGIC):
        return _decode_by_opencv(data, (width_px, height_px))
    return _decode_jpeg(data, width_px, height_px)


def _decode_jpeg(data: bytes, width_px: int, height_px: int) -> Image:
    """Decode a JPEG strictly: OpenCV's decoder hides its warnings, and fills what is damaged with grey.

    The pixels are those of OpenCV to the last bit, for both are libjpeg-turbo.
    """
    try:
        _, _, colours, _ = simplejpeg.decode_jpeg_header(data)
        if colours in {"CMYK", "YCCK"}:
            simplejpeg.decode_jpeg(data, "CMYK", strict=True)  # whether it is whole; OpenCV knows its colours
            return _decode_by_opencv(data, (width_px, height_px))
        image = simplejpeg.decode_jpeg(data, "BGR", strict=True)
    except (ValueError, MemoryError) as problem:
        raise ImageError(" ".join(str(problem).split()) or "not enough memory") from None
    if image.shape != (height_px, width_px, 3):
        raise ImageError("its data do not decode")
    return np.asarray(image, np.uint8)


def _decode_by_opencv(data: bytes, size_px: tuple[int, int]) -> Image:
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except (cv2.error, MemoryError) as problem:
        raise ImageError(" ".join(str(problem).split())) from None
    if image is None or image.shape != (*size_px[::-1], 3):
        raise ImageError("its data do not decode")
    return np.asarray(image, np.uint8)


def still_format(data: bytes) -> Literal["png", "jpeg"] | None:
    """What Foxglove calls the format of a PNG or JPEG, by its first bytes; None for any other."""
    return "png" if data.startswith(PNG_MAGIC) else "jpeg" if data.startswith(JPEG_MAGIC) else None


def still_size(data: bytes, limits: Limits) -> tuple[int, int]:
    """Width and height of a PNG or JPEG in px, by its header; ImageError as from `decode_still`."""
    if len(data) > limits.image_bytes:
        raise ImageError(f"{len(data)} bytes, the limit is {limits.image_bytes}")
    match still_format(data):
        case "png":
            width_px, height_px = _check_png(data)
        case "jpeg":
            width_px, height_px = _check_jpeg(data)
        case None:
            raise ImageError(f"expected a PNG or JPEG, found {data[:8].hex(' ') or 'nothing'}")
    check_dimensions(width_px, height_px, limits)
    return width_px, height_px


def check_dimensions(width_px: int, height_px: int, limits: Limits) -> None:
    """Refuse an empty image and one of too many pixels with ImageError."""
    if width_px < 1 or height_px < 1:
        raise ImageError(f"an image of {width_px}x{height_px} px is empty")
    if width_px * height_px > limits.image_pixels:
        raise ImageError(f"{width_px}x{height_px} px, the limit is {limits.image_pixels} px")


def _check_png(data: bytes) -> tuple[int, int]:
    """Verify the CRC of every chunk, up to the end: OpenCV decodes truncated and corrupt PNGs without a word."""
    view = memoryview(data)
    position = len(PNG_MAGIC)
    size_px: tuple[int, int] | None = None
    while position + 12 <= len(view):
        (length,) = struct.unpack_from(">I", view, position)
        end = position + 12 + length
        if end > len(view):
            break
        kind = bytes(view[position + 4 : position + 8])
        (crc,) = struct.unpack_from(">I", view, end - 4)
        if zlib.crc32(view[position + 4 : end - 4]) != crc:
            raise ImageError(f"the CRC of PNG chunk {kind!r} is wrong")
        if kind == b"IHDR" and size_px is None and length == 13:
            width_px, height_px, bit_depth = struct.unpack_from(">IIB", view, position + 8)
            size_px = width_px, height_px
            if bit_depth > 8:
                raise ImageError(f"a PNG of {bit_depth} bits; 8 are expected")
        elif size_px is None:
            raise ImageError("a PNG without a header")
        if kind == b"acTL":
            raise ImageError("an animated PNG; a still is expected")
        if kind == b"IEND":
            return size_px
        position = end
    raise ImageError(f"a PNG that ends early, after {len(data)} bytes")


def _check_jpeg(data: bytes) -> tuple[int, int]:
    """Read the dimensions from the frame header, and see that the end marker is there."""
    if JPEG_END not in data[-64:]:  # some cameras pad with zeros behind it
        raise ImageError(f"a JPEG that ends early, after {len(data)} bytes")
    # Inside a scan a byte 0xFF is followed by 0, so that these two bytes begin one, here or in a thumbnail.
    if data.count(JPEG_SCAN) > MAX_JPEG_SCANS:
        raise ImageError(f"a JPEG of more than {MAX_JPEG_SCANS} scans")
    position = 2
    while position + 4 <= len(data):
        if data[position] != 0xFF:
            break
        marker = data[position + 1]
        if marker == 0xFF:  # a fill byte
            position += 1
            continue
        if marker in JPEG_BARE_MARKERS:
            position += 2
            continue
        (length,) = struct.unpack_from(">H", data, position + 2)
        if marker in JPEG_FRAME_MARKERS and length >= 8 and position + 9 <= len(data):
            bit_depth, height_px, width_px = struct.unpack_from(">BHH", data, position + 4)
            if bit_depth != 8:
                raise ImageError(f"a JPEG of {bit_depth} bits; 8 are expected")
            return width_px, height_px
        position += 2 + length
    raise ImageError("a JPEG without a frame header")

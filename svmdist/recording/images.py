"""Decoding images: compressed and raw ones, and frames of videos, checked before a decoder sees them."""

from __future__ import annotations

import os
import re
import struct
import zlib
from collections.abc import Iterator
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any, Literal

# OpenCV reads this once, when it is imported; the header check below holds in any case.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 26))

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from svmdist.errors import RecordingError, SourceError, optional_package, restated
from svmdist.files import read_regular, reading
from svmdist.profile import Limits
from svmdist.recording.source import cut
from svmdist.samples import Image

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"


class ImageError(ValueError):
    """An image that cannot be decoded, or must not be."""


def decode_still(data: bytes | memoryview, limits: Limits) -> Image:
    """A PNG or JPEG as BGR, shape (height, width, 3) of uint8, alpha dropped; ImageError for what must not be."""
    data = bytes(data)
    width_px, height_px = still_size(data, limits)
    is_jpeg = not data.startswith(PNG_MAGIC)
    is_cmyk = is_jpeg and _jpeg_header(data)[2] in {"CMYK", "YCCK"}
    try:
        if is_jpeg:
            # Strictly, to OpenCV's pixels: OpenCV itself fills what is damaged with grey, without a word.
            image = simplejpeg.decode_jpeg(data, "CMYK" if is_cmyk else "BGR", strict=True)
        if is_cmyk or not is_jpeg:  # whose colours OpenCV knows
            image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except (cv2.error, ValueError, MemoryError) as problem:
        raise ImageError(" ".join(str(problem).split()) or "not enough memory") from None
    if image is None or image.shape != (height_px, width_px, 3):
        raise ImageError("its data do not decode")
    return np.asarray(image, np.uint8)


def still_format(data: bytes) -> Literal["png", "jpeg"] | None:
    """What Foxglove calls the format of a PNG or JPEG, by its first bytes; None for any other."""
    return "png" if data.startswith(PNG_MAGIC) else "jpeg" if data.startswith(b"\xff\xd8\xff") else None


def still_size(data: bytes, limits: Limits) -> tuple[int, int]:
    """Width and height of a PNG or JPEG in px, by its header; ImageError as from `decode_still`."""
    if len(data) > limits.image_bytes:
        raise ImageError(f"{len(data)} bytes, the limit is {limits.image_bytes}")
    found = still_format(data)
    if found is None:
        raise ImageError(f"expected a PNG or JPEG, found {repr(data[:16]) if data else 'nothing'}")
    width_px, height_px = _check_png(data) if found == "png" else _jpeg_header(data)[:2]
    check_dimensions(width_px, height_px, limits)
    return width_px, height_px


def check_dimensions(width_px: int, height_px: int, limits: Limits) -> None:
    """ImageError for an empty image and one of too many pixels."""
    if width_px < 1 or height_px < 1:
        raise ImageError(f"an image of {width_px}x{height_px} px is empty")
    if width_px * height_px > limits.image_pixels:
        raise ImageError(f"{width_px}x{height_px} px, the limit is {limits.image_pixels} px")


def _check_png(data: bytes) -> tuple[int, int]:
    """Verify the CRC of every chunk, up to the end: OpenCV decodes truncated and corrupt PNGs without a word."""
    view, position = memoryview(data), len(PNG_MAGIC)
    size_px: tuple[int, int] | None = None
    while position + 12 <= len(view):
        length, kind = struct.unpack_from(">I4s", view, position)
        end = position + 12 + length
        if end > len(view):
            break
        if struct.pack(">I", zlib.crc32(view[position + 4 : end - 4])) != view[end - 4 : end]:
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


def _jpeg_header(data: bytes) -> tuple[int, int, str]:
    """Width and height in px, and the colour space; ImageError without the end marker."""
    if b"\xff\xd9" not in data.rstrip(b"\0")[-64:]:  # buffers of MJPEG end in zeros, others in a few bytes more
        raise ImageError(f"a JPEG that ends early, after {len(data)} bytes")
    with restated(ValueError, ImageError, "a JPEG that cannot be decoded: "):
        height_px, width_px, colours, _ = simplejpeg.decode_jpeg_header(data)
    return width_px, height_px, colours


# Channels, and the conversion to BGR. ROS names a Bayer pattern by its first two rows, OpenCV by the second and third
# pixel of the second row.
RAW_ENCODINGS: dict[str, tuple[int, int | None]] = {
    **dict.fromkeys(("bgr8", "8UC3"), (3, None)),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    **dict.fromkeys(("bgra8", "8UC4"), (4, cv2.COLOR_BGRA2BGR)),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    **dict.fromkeys(("mono8", "8UC1"), (1, cv2.COLOR_GRAY2BGR)),
    "bayer_rggb8": (1, cv2.COLOR_BayerBG2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerRG2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGB2BGR),
    **dict.fromkeys(("yuv422", "uyvy"), (2, cv2.COLOR_YUV2BGR_UYVY)),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), (2, cv2.COLOR_YUV2BGR_YUY2)),
}


def decode_raw(
    encoding: str, size_px: tuple[int, int], step_bytes: int, data: bytes | memoryview, limits: Limits
) -> Image:
    """Rows of `step_bytes` bytes as BGR, shape (height, width, 3), alpha dropped; ImageError where that cannot be."""
    if encoding not in RAW_ENCODINGS:
        choices = ", ".join(RAW_ENCODINGS)
        raise ImageError(f"image encoding {cut(encoding)!r} is not known; the choices are {choices}")
    width_px, height_px = size_px
    check_dimensions(width_px, height_px, limits)
    channels, conversion = RAW_ENCODINGS[encoding]
    row_bytes = width_px * channels
    if step_bytes < row_bytes or len(data) != step_bytes * height_px:
        found = f"{len(data)} bytes in rows of {step_bytes}"
        raise ImageError(f"{found} do not hold {width_px}x{height_px} px of {encoding}")
    rows: NDArray[np.uint8] = np.frombuffer(data, np.uint8).reshape(height_px, step_bytes)[:, :row_bytes]
    pixels = rows.reshape(height_px, width_px, channels)
    if conversion is None:
        return pixels.copy()
    with restated(cv2.error, ImageError):
        image = cv2.cvtColor(np.ascontiguousarray(pixels), conversion)
    return np.asarray(image, np.uint8)


NAL_UNIT = re.compile(rb"\x00\x00\x01(.)", re.DOTALL)
SLICE, IDR_SLICE, SPS, PPS = 1, 5, 7, 8
COLOUR_PROFILES = frozenset({44, 83, 86, 100, 110, 118, 122, 128, 134, 135, 138, 139, 244})  # which state their colours


def _number(bits: Iterator[str], count: int) -> int:
    """The next number of so many bits, of fewer at the end; ValueError behind it."""
    return int("".join(islice(bits, count)), 2) if count else 0


def _code(bits: Iterator[str]) -> int:
    """The next number in Exp-Golomb code, as if without sign; ValueError behind the end."""
    zeros = next((before for before, bit in enumerate(bits) if bit == "1"), None)
    if zeros is None:
        raise ValueError("the NAL unit ends")
    return int("1" + "".join(islice(bits, zeros)), 2) - 1


def _numbering(bits: Iterator[str]) -> tuple[int, tuple[int, bool]]:
    """Of a sequence parameter set its name, the bits of a frame's number, and whether numbers may be left out."""
    profile, name, chroma = _number(bits, 24) >> 16, _code(bits), 1
    if profile in COLOUR_PROFILES:
        chroma = _code(bits)
        _number(bits, chroma == 3), _code(bits), _code(bits), _number(bits, 1)
        for at in range(12 if chroma == 3 else 8) if _number(bits, 1) else ():
            left, scale = 16 if at < 6 else 64, 8
            left *= _number(bits, 1)
            while left and scale:  # a scaling list ends early at 0
                code, left = _code(bits), left - 1
                scale = (scale + (code + 1) // 2 * (1 if code % 2 else -1)) % 256
    bit_count, order = min(_code(bits), 12) + 4, _code(bits)
    if order == 0:
        _code(bits)
    elif order == 1:
        _number(bits, 1), _code(bits), _code(bits)
        for _ in range(_code(bits)):
            _code(bits)
    _code(bits)
    return name, (bit_count, _number(bits, 1) == 1)


class VideoDecoder:
    """Decodes one stream; each message is one frame in Annex B, without frames that refer to later ones.

    A frame refers to those before it, so that after a loss every picture would be wrong in places: nothing is delivered
    from there to the next key frame. That a log lacks a frame shows by the number of the next one; FFmpeg makes up for
    it without a word. It does not show where frames are missing by as many as there are numbers, 16 or more, where the
    number after a missing key frame fits all the same, and of a stream that says that it leaves out numbers.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._codec: Any = None
        self._needs_key_frame = True
        self._count = self._loss_count = 0
        self._numbering: dict[int, tuple[int, bool]] = {}  # by sequence parameter set
        self._sequence: dict[int, int] = {}  # by picture parameter set
        self._number = 0  # of the last frame that others refer to

    def decode(self, video_format: str, data: bytes, loss_count: int) -> Image:
        """The next frame as BGR; ImageError for a broken one, and up to a key frame where `loss_count` grew."""
        needs_key_frame = self._needs_key_frame or loss_count != self._loss_count
        self._loss_count = loss_count
        self._needs_key_frame = True  # until this frame has come out whole
        if video_format != "h264":
            raise ImageError(f"video format {cut(video_format)!r} is not known; h264 is expected")
        if len(data) > self._limits.image_bytes:
            raise ImageError(f"{len(data)} bytes, the limit is {self._limits.image_bytes}")
        try:
            is_key_frame, follows = self._look(data)
        except (KeyError, ValueError):  # which FFmpeg makes nothing of, either
            is_key_frame, follows = False, True
        if needs_key_frame and not is_key_frame:
            raise ImageError("no key frame yet, which this frame refers to")
        if not follows:
            raise ImageError("the log lacks a frame before this one, which it refers to")
        av = optional_package("av", "video", "an image in H.264", RecordingError)
        if needs_key_frame:
            self._codec = codec = av.CodecContext.create("h264", "r")
            codec.thread_count = 1  # threads hold frames back
            codec.flags |= av.codec.context.Flags.low_delay
            codec.options = {"max_pixels": str(self._limits.image_pixels), "err_detect": "explode"}
        packet = av.Packet(data)
        packet.pts, packet.time_base = self._count, Fraction(1, 1000)
        self._count += 1
        with restated((av.error.FFmpegError, ValueError, MemoryError), ImageError, "the video does not decode: "):
            frames = self._codec.decode(packet)
        if len(frames) != 1 or frames[0].is_corrupt or frames[0].pts != packet.pts:
            raise ImageError(f"the message holds {len(frames)} whole frames, one is expected")
        check_dimensions(frames[0].width, frames[0].height, self._limits)
        self._needs_key_frame = False
        return np.asarray(frames[0].to_ndarray(format="bgr24"), np.uint8)

    def _look(self, data: bytes) -> tuple[bool, bool]:
        """Whether a frame is a key frame, and whether its number follows that of the last one."""
        for unit in NAL_UNIT.finditer(data):
            kind, is_reference = unit[1][0] & 0x1F, unit[1][0] & 0x60 != 0
            start = data[unit.end() : unit.end() + 2048].replace(b"\0\0\3", b"\0\0")  # the 3 is not of the data
            bits = iter(bin(int.from_bytes(b"\1" + start))[3:])
            if kind == IDR_SLICE:
                self._number = 0
                return True, True
            if kind == SPS:
                name, self._numbering[name] = _numbering(bits)
            elif kind == PPS:
                name, self._sequence[name] = _code(bits), _code(bits)
            elif kind == SLICE:
                _, _, parameters = (_code(bits) for _ in range(3))
                bit_count, may_skip = self._numbering[self._sequence[parameters]]
                number = _number(bits, bit_count)
                step = (number - self._number) % (1 << bit_count)
                self._number = number if is_reference else self._number
                # One further; some encoders number frames that none refers to as the one before.
                return False, may_skip or step in (1, is_reference)
        return False, True


def read_file(path: Path, limits: Limits, *, decode: bool) -> tuple[bytes | Image, tuple[int, int]]:
    """The bytes of a PNG or JPEG, or pixels, BGR, with `decode` or of others; width and height in px. SourceError."""
    with reading(path, SourceError):
        data = read_regular(path, limits.image_bytes)
    with restated((cv2.error, ImageError), SourceError, f"{path}: "):
        if still_format(data):
            size_px = still_size(data, limits)
            return decode_still(data, limits) if decode else data, size_px
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
        if image is None:
            raise ImageError(f"not an image that can be decoded ({repr(data[:16]) if data else 'an empty file'})")
        if image.dtype != np.uint8:
            raise ImageError(f"an image of {8 * image.dtype.itemsize} bits; 8 are expected")
        size_px = image.shape[1], image.shape[0]
        check_dimensions(*size_px, limits)
    pixels = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image[..., :3]
    return np.asarray(pixels, np.uint8), size_px

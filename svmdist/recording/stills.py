"""Image files for a recording: PNG and JPEG as they are, other formats decoded."""

from __future__ import annotations

from pathlib import Path

from svmdist.errors import SourceError
from svmdist.input_file import read_regular, why
from svmdist.profile import Limits
from svmdist.recording.messages.images import ImageError, decode_still, still_format
from svmdist.samples import Image


def read_file(path: Path, limits: Limits) -> bytes | Image:
    """The bytes of a PNG or JPEG, or the pixels of another format; SourceError in one line where it is no image."""
    try:
        data = read_regular(path, limits.image_bytes)
    except OSError as problem:
        raise SourceError(f"{path}: cannot read: {why(problem)}") from None
    return data if still_format(data) else _decode_other(data, path, limits)


def decode_file(data: bytes, name: str, limits: Limits) -> Image:
    """The pixels of a PNG or JPEG, BGR; SourceError names the file where it cannot be decoded."""
    try:
        return decode_still(data, limits)
    except ImageError as problem:
        raise SourceError(f"{name}: {problem}") from None


def _decode_other(data: bytes, path: Path, limits: Limits) -> Image:
    """BMP, TIFF, WebP or PNM by OpenCV, which refuses images of too many pixels."""
    import cv2
    import numpy as np

    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as problem:
        raise SourceError(f"{path}: {' '.join(str(problem).split())}") from None
    if image is None:
        raise SourceError(f"{path}: no image that can be decoded ({data[:8].hex(' ') or 'an empty file'})")
    if image.dtype != np.uint8:
        raise SourceError(f"{path}: an image of {8 * image.dtype.itemsize} bits; 8 are expected")
    if image.shape[0] * image.shape[1] > limits.image_pixels:
        raise SourceError(
            f"{path}: {image.shape[1]}x{image.shape[0]} px, the limit is {limits.image_pixels} px"
        )
    if image.ndim == 2:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    return np.asarray(image[..., :3], np.uint8)

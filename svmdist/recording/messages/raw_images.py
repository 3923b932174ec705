"""Uncompressed images to BGR, by the encoding names that ROS and Foxglove share."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.profile import Limits
from svmdist.recording.messages.images import ImageError, check_dimensions
from svmdist.recording.names import cut
from svmdist.samples import Image

CHANNELS = {
    "bgr8": 3,
    "8UC3": 3,
    "rgb8": 3,
    "bgra8": 4,
    "8UC4": 4,
    "rgba8": 4,
    "mono8": 1,
    "8UC1": 1,
    "bayer_rggb8": 1,
    "bayer_bggr8": 1,
    "bayer_gbrg8": 1,
    "bayer_grbg8": 1,
    "yuv422": 2,
    "uyvy": 2,
    "yuv422_yuy2": 2,
    "yuyv": 2,
}

# ROS names a Bayer pattern by its first two rows, OpenCV by the second row's second and third pixel.
CONVERSIONS = {
    "rgb8": cv2.COLOR_RGB2BGR,
    "rgba8": cv2.COLOR_RGBA2BGR,
    "bgra8": cv2.COLOR_BGRA2BGR,
    "8UC4": cv2.COLOR_BGRA2BGR,
    "mono8": cv2.COLOR_GRAY2BGR,
    "8UC1": cv2.COLOR_GRAY2BGR,
    "bayer_rggb8": cv2.COLOR_BayerBG2BGR,
    "bayer_bggr8": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg8": cv2.COLOR_BayerGR2BGR,
    "bayer_grbg8": cv2.COLOR_BayerGB2BGR,
    "yuv422": cv2.COLOR_YUV2BGR_UYVY,
    "uyvy": cv2.COLOR_YUV2BGR_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUY2,
    "yuyv": cv2.COLOR_YUV2BGR_YUY2,
}


def decode_raw(
    encoding: str, size_px: tuple[int, int], step_bytes: int, data: bytes | memoryview, limits: Limits
) -> Image:
    """Convert rows of `step_bytes` bytes to BGR, shape (height, width, 3); alpha is dropped.

    Raises ImageError for an encoding that is not known, and sizes that contradict each other.
    """
    if encoding not in CHANNELS:
        raise ImageError(
            f"image encoding {cut(encoding)!r} is not known; the choices are {', '.join(CHANNELS)}"
        )
    width_px, height_px = size_px
    check_dimensions(width_px, height_px, limits)
    channels = CHANNELS[encoding]
    row_bytes = width_px * channels
    if step_bytes < row_bytes or len(data) != step_bytes * height_px:
        raise ImageError(
            f"{len(data)} bytes in rows of {step_bytes} do not hold {width_px}x{height_px} px of {encoding}"
        )
    rows: NDArray[np.uint8] = np.frombuffer(data, np.uint8).reshape(height_px, step_bytes)[:, :row_bytes]
    pixels = rows.reshape(height_px, width_px, channels)
    if encoding not in CONVERSIONS:
        return pixels.copy()
    try:
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels), CONVERSIONS[encoding]), np.uint8)
    except cv2.error as problem:
        raise ImageError(" ".join(str(problem).split())) from None

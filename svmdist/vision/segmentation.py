"""HSV segmentation: which pixels of an image have a region's colour (paper, sec. III.A)."""

from __future__ import annotations

import cv2
import numpy as np

from svmdist.profile import ColourRegion
from svmdist.samples import Image


def to_hsv(image_bgr: Image) -> Image:
    """Convert BGR, shape (h, w, 3), to OpenCV's 8-bit HSV: H in 0–179 (half degrees), S and V in 0–255."""
    return np.asarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2HSV), np.uint8)


def colour_mask(image_hsv: Image, region: ColourRegion) -> Image:
    """Mask, shape (h, w) with 0 or 255, of the pixels inside an HSV box whose hue may wrap around 0."""
    first, last = region.hue
    (s_low, s_high), (v_low, v_high) = region.saturation, region.value
    if first <= last:
        return _in_range(image_hsv, (first, s_low, v_low), (last, s_high, v_high))
    below = _in_range(image_hsv, (0, s_low, v_low), (last, s_high, v_high))
    above = _in_range(image_hsv, (first, s_low, v_low), (179, s_high, v_high))
    return np.asarray(cv2.bitwise_or(below, above), np.uint8)


def _in_range(image_hsv: Image, lower: tuple[int, int, int], upper: tuple[int, int, int]) -> Image:
    return np.asarray(cv2.inRange(image_hsv, np.array(lower), np.array(upper)), np.uint8)

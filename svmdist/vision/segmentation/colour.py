"""HSV segmentation: which pixels of an image have a region's colour (paper, sec. III.A)."""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np

from svmdist.profile import ColourRegion, HsvSegmentation
from svmdist.samples import Image
from svmdist.vision.segmentation.exposure import levelled
from svmdist.vision.segmentation.recent import RecentImages


class HsvMasks:
    """The masks of one image, shape (h, w) with 0 or 255, each made when it is first asked for."""

    def __init__(self, image_bgr: Image, rules: HsvSegmentation) -> None:
        self._image_hsv = to_hsv(image_bgr)
        self._rules = rules

    @cached_property
    def tissue(self) -> Image:
        """Pixels of the tissue's colour."""
        return colour_mask(self._image_hsv, self._rules.tissue)

    @cached_property
    def instrument(self) -> Image:
        """Pixels of the colour of the instrument's distal part."""
        return colour_mask(self._image_hsv, self._rules.instrument)

    @cached_property
    def shaft(self) -> Image | None:
        """Pixels as dark as the shaft; None where the profile knows no shaft."""
        return None if self._rules.shaft is None else colour_mask(self._image_hsv, self._rules.shaft)

    @property
    def black(self) -> Image | None:
        """None: what is as black as the border of the picture is dark enough for the shaft."""
        return None


class HsvSegmenter:
    """`method = "hsv"`: a box of colours for each part; with `level`, at the exposure that they were chosen at."""

    def __init__(self, rules: HsvSegmentation, level: bool = True) -> None:
        self._rules = rules
        self._level = level
        self._recent = RecentImages(self._boxes)

    def masks(self, image_bgr: Image) -> HsvMasks:
        """The masks of an image, shape (h, w, 3) in BGR."""
        return self._recent.of(image_bgr)

    def _boxes(self, image_bgr: Image) -> HsvMasks:
        return HsvMasks(levelled(image_bgr) if self._level else image_bgr, self._rules)


def to_hsv(image_bgr: Image) -> Image:
    """Convert BGR, shape (h, w, 3), to OpenCV's 8-bit HSV: H in 0–179 (half degrees), S and V in 0–255."""
    return np.asarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2HSV), np.uint8)


def to_grey(image_bgr: Image) -> Image:
    """Convert BGR, shape (h, w, 3), to grey, shape (h, w)."""
    return np.asarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY), np.uint8)


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

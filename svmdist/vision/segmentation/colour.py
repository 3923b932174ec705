"""HSV segmentation: which pixels of an image have a region's colour (paper, sec. III.A)."""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np

from svmdist.profile import ColourRegion, HsvSegmentation
from svmdist.samples import Image


class HsvMasks:
    """The masks of one image, shape (h, w) with 0 or 255, each made when it is first asked for."""

    def __init__(self, hsv: Image, rules: HsvSegmentation) -> None:
        self._hsv = hsv
        self._rules = rules

    @cached_property
    def tissue(self) -> Image:
        """Pixels of the tissue's colour."""
        return colour_mask(self._hsv, self._rules.tissue)

    @cached_property
    def instrument(self) -> Image:
        """Pixels of the colour of the instrument's distal part."""
        return colour_mask(self._hsv, self._rules.instrument)

    @cached_property
    def shaft(self) -> Image | None:
        """Pixels as dark as the shaft; None where the profile knows no shaft."""
        return None if self._rules.shaft is None else colour_mask(self._hsv, self._rules.shaft)

    @property
    def black(self) -> Image | None:
        """None: what is as black as the border of the view is dark enough for the shaft."""
        return None


class HsvSegmenter:
    """`method = "hsv"`: a box of colours for each part."""

    uses_colours = True

    def __init__(self, rules: HsvSegmentation) -> None:
        self._rules = rules

    def masks(self, bgr: Image, hsv: Image | None, /) -> HsvMasks:  # noqa: ARG002
        """The masks of an image as HSV, shape (h, w, 3); raises ValueError without it."""
        if hsv is None:
            raise ValueError("segmentation by colour needs the image as HSV")
        return HsvMasks(hsv, self._rules)


def colour_mask(image_hsv: Image, region: ColourRegion) -> Image:
    """Mask, shape (h, w) with 0 or 255, of the pixels inside an HSV box whose hue may wrap around 0."""
    first, last = region.hue
    (s_low, s_high), (v_low, v_high) = region.saturation, region.value
    if (first, last, s_low, s_high) == (0, 179, 0, 255):
        return np.asarray(cv2.inRange(cv2.extractChannel(image_hsv, 2), v_low, v_high), np.uint8)
    if first <= last:
        return _in_range(image_hsv, (first, s_low, v_low), (last, s_high, v_high))
    below = _in_range(image_hsv, (0, s_low, v_low), (last, s_high, v_high))
    above = _in_range(image_hsv, (first, s_low, v_low), (179, s_high, v_high))
    return np.asarray(cv2.bitwise_or(below, above), np.uint8)


def _in_range(image_hsv: Image, lower: tuple[int, int, int], upper: tuple[int, int, int]) -> Image:
    return np.asarray(cv2.inRange(image_hsv, np.array(lower), np.array(upper)), np.uint8)

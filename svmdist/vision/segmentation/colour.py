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
        self._channels = _Channels(hsv)
        self._rules = rules

    @cached_property
    def tissue(self) -> Image:
        """Pixels of the tissue's colour."""
        return _mask(self._channels, self._rules.tissue)

    @cached_property
    def instrument(self) -> Image:
        """Pixels of the colour of the instrument's distal part."""
        return _mask(self._channels, self._rules.instrument)

    @cached_property
    def shaft(self) -> Image | None:
        """Pixels as dark as the shaft; None where the profile knows no shaft."""
        return None if self._rules.shaft is None else _mask(self._channels, self._rules.shaft)

    @property
    def black(self) -> Image | None:
        """None: what is as black as the border of the view is dark enough for the shaft."""
        return None

    @property
    def picture(self) -> None:
        """None: what is black may be border or shaft."""
        return None

    @property
    def seen(self) -> None:
        """None: colours tell no instruments apart."""


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
    return _mask(_Channels(image_hsv), region)


class _Channels:
    """Hue, saturation and value of an image, shape (h, w) each; only those that a box bounds are taken out."""

    def __init__(self, image_hsv: Image) -> None:
        self._image_hsv = image_hsv

    @cached_property
    def hue(self) -> Image:
        return np.asarray(cv2.extractChannel(self._image_hsv, 0), np.uint8)

    @cached_property
    def saturation(self) -> Image:
        return np.asarray(cv2.extractChannel(self._image_hsv, 1), np.uint8)

    @cached_property
    def value(self) -> Image:
        return np.asarray(cv2.extractChannel(self._image_hsv, 2), np.uint8)


def _mask(channels: _Channels, region: ColourRegion) -> Image:
    """Channel by channel: a test of one channel takes an eighth of what one of three channels at once takes."""
    first, last = region.hue
    mask = cv2.inRange(channels.value, *region.value)
    if tuple(region.saturation) != (0, 255):
        cv2.bitwise_and(mask, cv2.inRange(channels.saturation, *region.saturation), mask)
    if first <= last:
        if (first, last) != (0, 179):
            cv2.bitwise_and(mask, cv2.inRange(channels.hue, first, last), mask)
    elif last + 1 < first:  # else the two ends meet, and every hue is inside
        between = cv2.inRange(channels.hue, last + 1, first - 1)
        cv2.bitwise_and(mask, cv2.bitwise_not(between, between), mask)
    return np.asarray(mask, np.uint8)

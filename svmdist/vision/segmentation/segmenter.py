"""One interface to segmentation, however it is done: an image in, a mask for each part out."""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import cv2
import numpy as np

from svmdist.profile import AutoSegmentation, HsvSegmentation, Segmentation
from svmdist.profile.settings import AutoSettings
from svmdist.samples import Image
from svmdist.vision.instruments.seen import SeenInstrument
from svmdist.vision.segmentation.auto import AutoSegmenter
from svmdist.vision.segmentation.colour import HsvSegmenter
from svmdist.vision.segmentation.network import OnnxSegmenter

DEFAULT_AUTO = AutoSettings()


class Masks(Protocol):
    """What is what in one image: masks of shape (h, w), uint8, 0 or 255; they may be combined by `&`."""

    @property
    def tissue(self) -> Image:
        """The tissue."""

    @property
    def instrument(self) -> Image:
        """The instrument's distal part, about the tool's origin."""

    @property
    def shaft(self) -> Image | None:
        """The instrument's shaft; None where the profile knows none."""

    @property
    def black(self) -> Image | None:
        """What may be border around the endoscope's view; None where the shaft's mask holds it already."""

    @property
    def picture(self) -> Image | None:
        """What is surely not border around the endoscope's view; None where a method does not tell."""

    @property
    def seen(self) -> tuple[SeenInstrument, ...] | None:
        """Whole instruments with their geometry, the surest first; None by a method that tells no instruments apart."""


class Segmenter(Protocol):
    """What every method of segmentation is: one image to its masks, at the image's own resolution."""

    @property
    def uses_colours(self) -> bool:
        """Whether it takes the image as HSV; a network takes BGR as recorded, as it did in its training."""

    def masks(self, bgr: Image, hsv: Image | None, /) -> Masks:
        """The masks of an image, shape (h, w, 3) in BGR as recorded; `hsv` is it as HSV, for one that uses colours."""


def make_segmenter(rules: Segmentation, auto: AutoSettings = DEFAULT_AUTO) -> Segmenter:
    """Make the segmenter that a profile asks for; raises ProfileError where its network cannot be used."""
    if isinstance(rules, AutoSegmentation):
        return AutoSegmenter(auto)
    return HsvSegmenter(rules) if isinstance(rules, HsvSegmentation) else OnnxSegmenter(rules)


class InstrumentMasks:
    """The masks of an image for one of several instruments: without the pixels of the others, shape (h, w)."""

    def __init__(self, masks: Masks, others: Image) -> None:
        self._masks = masks
        self._others = others

    @property
    def tissue(self) -> Image:
        """The tissue, which all instruments share."""
        return self._masks.tissue

    @cached_property
    def instrument(self) -> Image:
        """Its own distal part."""
        return _without(self._masks.instrument, self._others)

    @cached_property
    def shaft(self) -> Image | None:
        """Its own shaft."""
        return None if self._masks.shaft is None else _without(self._masks.shaft, self._others)

    @property
    def picture(self) -> Image | None:
        """What is not border, the instruments among it, which all share."""
        return self._masks.picture

    @cached_property
    def seen(self) -> tuple[SeenInstrument, ...] | None:
        """Those of which most is its own."""
        seen = self._masks.seen
        return None if seen is None else tuple(one for one in seen if _is_own(one.mask, self._others))

    @cached_property
    def black(self) -> Image | None:
        """What may be border, the other shafts among it: they cut the view no less than its own."""
        shaft, black = self._masks.shaft, self._masks.black
        return shaft if black is None or shaft is None else np.asarray(cv2.bitwise_or(shaft, black), np.uint8)


def _without(mask: Image, others: Image) -> Image:
    return np.asarray(cv2.bitwise_and(mask, cv2.bitwise_not(others)), np.uint8)


def _is_own(mask: Image, others: Image) -> bool:
    return 2 * cv2.countNonZero(cv2.bitwise_and(mask, others)) < cv2.countNonZero(mask)

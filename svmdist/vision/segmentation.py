"""One interface to segmentation, however it is done: an image in, a mask for each part out."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np

from svmdist.profile.segmentation import AutoSegmentation, HsvSegmentation, Segmentation
from svmdist.profile.settings import AutoSettings
from svmdist.samples import Image
from svmdist.vision.colour import HsvSegmenter, Masks

if TYPE_CHECKING:
    from svmdist.vision.instruments.find_instruments import SeenInstrument

DEFAULT = AutoSettings()


class Segmenter(Protocol):
    """What every method of segmentation is: one image to its masks, at the image's own resolution."""

    @property
    def uses_colours(self) -> bool:
        """Whether it takes the image as HSV; a network takes BGR as recorded, as it did in its training."""

    def masks(self, image: Image, /) -> Masks:
        """The masks of an image, shape (h, w, 3), as HSV for one that uses colours, else as BGR."""


def make_segmenter(rules: Segmentation, auto: AutoSettings = DEFAULT) -> Segmenter:
    """Make the segmenter that a profile asks for; raises ProfileError where its network cannot be used."""
    if isinstance(rules, HsvSegmentation):
        return HsvSegmenter(rules)
    if isinstance(rules, AutoSegmentation):
        from svmdist.vision.instruments.find_instruments import AutoSegmenter

        return AutoSegmenter(auto)
    from svmdist.vision.network import OnnxSegmenter

    return OnnxSegmenter(rules)


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
        return self._own(self._masks.instrument)

    @cached_property
    def shaft(self) -> Image | None:
        """Its own shaft."""
        return None if self._masks.shaft is None else self._own(self._masks.shaft)

    @property
    def picture(self) -> Image | None:
        """What is not border, the instruments among it, which all share."""
        return self._masks.picture

    @cached_property
    def seen(self) -> tuple[SeenInstrument, ...] | None:
        """Those of which most is its own."""
        if self._masks.seen is None:
            return None
        count = cv2.countNonZero
        return tuple(one for one in self._masks.seen if 2 * count(self._own(one.mask)) > count(one.mask))

    @cached_property
    def black(self) -> Image | None:
        """What may be border, the other shafts among it: they cut the view no less than its own."""
        shaft, black = self._masks.shaft, self._masks.black
        return shaft if black is None or shaft is None else np.asarray(cv2.bitwise_or(shaft, black), np.uint8)

    def _own(self, mask: Image) -> Image:
        return np.asarray(cv2.bitwise_and(mask, cv2.bitwise_not(self._others)), np.uint8)

"""One interface to segmentation, however it is done: an image in, a mask for each part out."""

from __future__ import annotations

from typing import Protocol

import cv2
import numpy as np

from svmdist.profile.segmentation import AutoSegmentation, HsvSegmentation, Segmentation
from svmdist.profile.settings import AutoSettings
from svmdist.samples import Image
from svmdist.vision.colour import HsvSegmenter, KnownMasks
from svmdist.vision.instruments.find_instruments import AutoMasks, AutoSegmenter
from svmdist.vision.network import OnnxSegmenter

DEFAULT = AutoSettings()
Masks = KnownMasks | AutoMasks


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
    return AutoSegmenter(auto) if isinstance(rules, AutoSegmentation) else OnnxSegmenter(rules)


def without(masks: Masks, others: Image) -> KnownMasks:
    """The masks of an image for one of several instruments: without the pixels of the others, shape (h, w).

    All share the tissue and the picture. What may be border has the other shafts in it: they cut the view no less than
    its own. `seen` are those of which most is its own.
    """
    count, not_others = cv2.countNonZero, cv2.bitwise_not(others)

    def own(mask: Image) -> Image:
        return np.asarray(cv2.bitwise_and(mask, not_others), np.uint8)

    shaft, black, seen = masks.shaft, masks.black, masks.seen
    if seen is not None:
        seen = tuple(one for one in seen if 2 * count(own(one.mask)) > count(one.mask))
    return KnownMasks(
        tissue=masks.tissue,
        instrument=own(masks.instrument),
        shaft=None if shaft is None else own(shaft),
        black=shaft if shaft is None or black is None else shaft | black,
        picture=masks.picture,
        seen=seen,
    )

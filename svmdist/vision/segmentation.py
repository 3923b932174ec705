"""One interface to segmentation, however it is done: an image in, a mask for each part out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from svmdist.profile.segmentation import AutoSegmentation, HsvSegmentation, Segmentation
from svmdist.profile.settings import AutoSettings
from svmdist.samples import Image
from svmdist.vision.colour import KnownMasks, masks_by_colours
from svmdist.vision.instruments.find_instruments import DEFAULT, AutoMasks
from svmdist.vision.network import OnnxSegmenter

Masks = KnownMasks | AutoMasks


@dataclass(frozen=True)
class Segmenter:
    """A method of segmentation: one image, shape (h, w, 3), to its `masks`, at the image's own resolution.

    One that `uses_colours` takes HSV; a network takes BGR as recorded, as it did in its training.
    """

    masks: Callable[[Image], Masks]
    uses_colours: bool = False


def make_segmenter(rules: Segmentation, auto: AutoSettings = DEFAULT) -> Segmenter:
    """Make the segmenter that a profile asks for; raises ProfileError where its network cannot be used."""
    if isinstance(rules, HsvSegmentation):
        return Segmenter(partial(masks_by_colours, rules), uses_colours=True)
    if isinstance(rules, AutoSegmentation):
        return Segmenter(partial(AutoMasks, settings=auto))
    return Segmenter(OnnxSegmenter(rules).masks)


def without(masks: Masks, others: Image) -> KnownMasks:
    """The masks of an image for one of several instruments: without the pixels of the others, shape (h, w).

    What may be border has the other shafts in it: they cut the view no less than its own.
    """
    count, not_others = cv2.countNonZero, cv2.bitwise_not(others)

    def own(mask: Image) -> Image:
        return np.asarray(cv2.bitwise_and(mask, not_others), np.uint8)

    shaft, black, seen = masks.shaft, masks.black, masks.seen
    if seen is not None:
        seen = tuple(one for one in seen if 2 * count(own(one.mask)) > count(one.mask))
    own_shaft = None if shaft is None else own(shaft)
    black = shaft if shaft is None or black is None else shaft | black
    return KnownMasks(masks.tissue, own(masks.instrument), own_shaft, black, masks.picture, seen)

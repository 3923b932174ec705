"""One interface to segmentation, however it is done: an image in, a mask for each part out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from svmdist.profile import HsvSegmentation, Segmentation
from svmdist.samples import Image
from svmdist.vision.segmentation.colour import HsvSegmenter
from svmdist.vision.segmentation.network import OnnxSegmenter


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
        """What may be border around the endoscope's picture; None where the shaft's mask holds it already."""


class Segmenter(Protocol):
    """What every method of segmentation is: one image to its masks, at the image's own resolution."""

    def masks(self, image_bgr: Image) -> Masks:
        """The masks of an image, shape (h, w, 3) in BGR; the work is done once an image."""


def make_segmenter(rules: Segmentation, level: bool = True) -> Segmenter:
    """Make the segmenter that a profile asks for; raises ProfileError where its network cannot be used.

    `level` brings dim and hazy images to a fair exposure before colours are told, which the paper does not. A network
    sees the image as it is, as it did in its training.
    """
    return HsvSegmenter(rules, level) if isinstance(rules, HsvSegmentation) else OnnxSegmenter(rules)


@dataclass(frozen=True, slots=True)
class OwnMasks:
    """The masks of an image as one of several instruments sees them: without `foreign` pixels, shape (h, w)."""

    masks: Masks
    foreign: Image

    @property
    def tissue(self) -> Image:
        """The tissue, which all instruments share."""
        return self.masks.tissue

    @property
    def instrument(self) -> Image:
        """Its own distal part."""
        return _without(self.masks.instrument, self.foreign)

    @property
    def shaft(self) -> Image | None:
        """Its own shaft."""
        return None if self.masks.shaft is None else _without(self.masks.shaft, self.foreign)

    @property
    def black(self) -> Image | None:
        """What may be border, the other shafts among it: they cut the picture no less than its own."""
        shaft, black = self.masks.shaft, self.masks.black
        return shaft if black is None or shaft is None else np.asarray(cv2.bitwise_or(shaft, black), np.uint8)


def own_masks(segmenter: Segmenter, image_bgr: Image, foreign: Image | None) -> Masks:
    """The masks of an image, without the pixels that are foreign to an instrument where there are any."""
    masks = segmenter.masks(image_bgr)
    return masks if foreign is None else OwnMasks(masks, foreign)


def _without(mask: Image, foreign: Image) -> Image:
    return np.asarray(cv2.bitwise_and(mask, cv2.bitwise_not(foreign)), np.uint8)

"""One interface to segmentation, however it is done: an image in, a mask for each part out."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, lru_cache
from typing import Protocol

import cv2
import numpy as np

from svmdist.profile import AutoSegmentation, HsvSegmentation, OnnxSegmentation, Segmentation
from svmdist.profile.segmentation import INSTRUMENTS, PREFIX
from svmdist.profile.settings import AutoSettings
from svmdist.samples import Image
from svmdist.vision.colour import HsvSegmenter, Masks
from svmdist.vision.find_instruments import (
    SeenInstrument,
    find_instruments,
    learnt_appearance,
    search_bars,
    seen_instrument,
)
from svmdist.vision.network import OnnxSegmenter
from svmdist.vision.working_image import Appearance, Floats, WorkingImage, tissue_of

MOST_RATIO = 4.0  # one pixel's texture says no more than its colour may, as a logarithm of odds


def network_hint(bgr: Image) -> Floats:
    """Log odds of instrument against all else, shape (h, w), of an image, shape (h, w, 3)."""
    scores = _network().scores(bgr)
    instrument = np.zeros(len(scores), np.bool_)
    for part in ("instrument", "shaft"):
        instrument[list(INSTRUMENTS[part]["class_ids"])] = True
    odds = np.logaddexp.reduce(scores[instrument]) - np.logaddexp.reduce(scores[~instrument])
    odds = np.clip(odds, -MOST_RATIO, MOST_RATIO).astype(np.float32)
    return np.asarray(cv2.resize(odds, bgr.shape[1::-1], interpolation=cv2.INTER_LINEAR), np.float32)


@lru_cache(maxsize=1)
def _network() -> OnnxSegmenter:
    return OnnxSegmenter(OnnxSegmentation.model_validate({"method": "onnx", "model": f"{PREFIX}instruments"}))


DEFAULT = AutoSettings()


class AutoMasks:
    """The masks of one image, shape (h, w) with 0 or 255, made when they are first asked for."""

    def __init__(self, bgr: Image, appearance: Appearance | None, settings: AutoSettings) -> None:
        self._size = bgr.shape[0], bgr.shape[1]
        self._image = WorkingImage.of(bgr, settings, network_hint)
        self._appearance = appearance

    @cached_property
    def seen(self) -> tuple[SeenInstrument, ...]:
        """The instruments, the surest first."""
        if self._appearance is None:  # no image that was learnt from shows one: this may
            appearance, sought = learnt_appearance([self._image]), search_bars(self._image)
        else:
            appearance, sought = self._appearance, []
        found = find_instruments(self._image, appearance, sought)
        return tuple(seen_instrument(one, self._image, self._size) for one in found)

    @cached_property
    def picture(self) -> Image:
        """What of the image is picture: not the black border around it."""
        return self._enlarged(self._image.picture)

    @cached_property
    def tissue(self) -> Image:
        """What of the picture is no instrument, or the red part of that where it is distinct."""
        return self._enlarged(tissue_of(self._image)) & ~self._union([one.mask for one in self.seen])

    @cached_property
    def instrument(self) -> Image:
        """Wrists and jaws of all instruments: what is beyond the end of each shaft."""
        return self._union([one.distal for one in self.seen])

    @cached_property
    def shaft(self) -> Image | None:
        """The shafts of all instruments, of any brightness."""
        return self._union([one.shaft for one in self.seen])

    @cached_property
    def black(self) -> Image | None:
        """What is not picture."""
        return np.asarray(cv2.bitwise_not(self.picture), np.uint8)

    def _union(self, masks: Sequence[Image]) -> Image:
        union = np.zeros(self._size, np.uint8)
        for mask in masks:
            cv2.bitwise_or(union, mask, union)
        return union

    def _enlarged(self, mask: Image) -> Image:
        large = cv2.resize(mask, (self._size[1], self._size[0]), interpolation=cv2.INTER_LINEAR)
        return np.asarray(cv2.threshold(large, 127, 255, cv2.THRESH_BINARY)[1], np.uint8)


class AutoSegmenter:
    """Finds instruments by straight edges, tells them from tissue by learnt colours and the network that ships."""

    uses_colours = False

    def __init__(self, settings: AutoSettings = DEFAULT, appearance: Appearance | None = None) -> None:
        self._settings = settings
        self._appearance = appearance

    @property
    def adapting_frames(self) -> int:
        """How many moments of a log it wants to learn from."""
        return self._settings.adapting_frames

    def adapted_to(self, images: Sequence[Image]) -> AutoSegmenter:
        """One that knows what instruments look like in these images, shape (h, w, 3) in BGR each."""
        working = [WorkingImage.of(image, self._settings, network_hint) for image in images]
        return AutoSegmenter(self._settings, learnt_appearance(working))

    def masks(self, bgr: Image, hsv: Image | None = None, /) -> AutoMasks:  # noqa: ARG002
        """The masks of an image, shape (h, w, 3) in BGR as recorded."""
        return AutoMasks(bgr, self._appearance, self._settings)


class Segmenter(Protocol):
    """What every method of segmentation is: one image to its masks, at the image's own resolution."""

    @property
    def uses_colours(self) -> bool:
        """Whether it takes the image as HSV; a network takes BGR as recorded, as it did in its training."""

    def masks(self, bgr: Image, hsv: Image | None, /) -> Masks:
        """The masks of an image, shape (h, w, 3) in BGR as recorded; `hsv` is it as HSV, for one that uses colours."""


def make_segmenter(rules: Segmentation, auto: AutoSettings = DEFAULT) -> Segmenter:
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

"""`method = "auto"`: instruments and tissue without a colour from the user (decision 22)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import cv2
import numpy as np

from svmdist.profile.settings import AutoSettings
from svmdist.samples import Image
from svmdist.vision.instruments.appearance import Appearance
from svmdist.vision.instruments.find import find_instruments, learnt_appearance, search_bars
from svmdist.vision.instruments.seen import SeenInstrument, seen_instrument
from svmdist.vision.instruments.tissue import tissue_of
from svmdist.vision.instruments.working import WorkingImage
from svmdist.vision.segmentation.hint import network_hint

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
    """Finds instruments by their straight edges, and tells them from tissue by colours that it learns.

    The network that ships is a second witness (decision 33). By itself it learns from each image alone; `adapted_to`
    makes one that has learnt from the images of a log.
    """

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

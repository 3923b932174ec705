"""One image in every form that detectors ask for, each computed when first asked for and kept.

No other module converts colours or normalises exposure: detectors take grey, HSV and masks from the context.
"""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np

from svmdist.profile.settings import ExposureSettings
from svmdist.samples import Image
from svmdist.vision.segmentation.exposure import Exposure, apply_exposure, exposure_of
from svmdist.vision.segmentation.segmenter import Masks, Segmenter

DEFAULT_EXPOSURE = ExposureSettings()


class FrameContext:
    """One camera image, shape (h, w, 3) in BGR, and what is derived from it.

    Forms without a suffix are at normalised exposure; `_as_recorded` ones are of the image as it is, which the
    paper's methods segment. Nothing that it keeps refers back to it: its images are freed with its last user, and do
    not wait for the collector.
    """

    def __init__(
        self, bgr: Image, segmenter: Segmenter, settings: ExposureSettings = DEFAULT_EXPOSURE
    ) -> None:
        self.bgr_as_recorded = bgr
        self._segmenter = segmenter
        self._settings = settings

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in px."""
        height, width = self.bgr_as_recorded.shape[:2]
        return height, width

    @cached_property
    def exposure(self) -> Exposure:
        """The map that normalises this image's exposure."""
        return exposure_of(self.bgr_as_recorded, self._settings)

    @cached_property
    def bgr(self) -> Image:
        """The image at normalised exposure; the same array where it is well exposed already."""
        return apply_exposure(self.bgr_as_recorded, self.exposure, self._settings)

    @cached_property
    def hsv_as_recorded(self) -> Image:
        """OpenCV's 8-bit HSV, shape (h, w, 3)."""
        return to_hsv(self.bgr_as_recorded)

    @cached_property
    def hsv(self) -> Image:
        """OpenCV's 8-bit HSV at normalised exposure."""
        return self.hsv_as_recorded if self.exposure.is_plain else to_hsv(self.bgr)

    @cached_property
    def brightness(self) -> Image:
        """The brightest channel of each pixel, HSV's value, shape (h, w)."""
        return np.asarray(cv2.extractChannel(self.hsv, 2), np.uint8)

    @cached_property
    def grey(self) -> Image:
        """Grey levels of the image as it is, shape (h, w): features and tags need no exposure."""
        return to_grey(self.bgr_as_recorded)

    @cached_property
    def masks(self) -> Masks:
        """What is what in the image, at normalised exposure."""
        if "masks_as_recorded" in self.__dict__ and self._is_one_segmentation:
            return self.masks_as_recorded
        return self._segmenter.masks(self.bgr_as_recorded, self.hsv if self._segmenter.uses_colours else None)

    @cached_property
    def masks_as_recorded(self) -> Masks:
        """What is what in the image as it is."""
        if "masks" in self.__dict__ and self._is_one_segmentation:
            return self.masks
        hsv = self.hsv_as_recorded if self._segmenter.uses_colours else None
        return self._segmenter.masks(self.bgr_as_recorded, hsv)

    @property
    def _is_one_segmentation(self) -> bool:
        """Whether exposure makes no difference to the masks."""
        return not self._segmenter.uses_colours or self.exposure.is_plain


def to_hsv(bgr: Image) -> Image:
    """Convert BGR, shape (h, w, 3), to OpenCV's 8-bit HSV: H in 0–179 (half degrees), S and V in 0–255."""
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV), np.uint8)


def to_grey(bgr: Image) -> Image:
    """Convert BGR, shape (h, w, 3), to grey, shape (h, w)."""
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), np.uint8)

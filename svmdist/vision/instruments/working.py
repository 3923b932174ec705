"""The working image of `auto`: small, with colours as logarithms of ratios, which shading does not change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.profile.settings import AutoSettings
from svmdist.samples import Image
from svmdist.vision.field_of_view import field_of_view

Floats = NDArray[np.float32]
Hint = Callable[[Image], Floats]
"""Gives log odds of instrument, shape (h, w), of an image, shape (h, w, 3)."""

SQUARE_3 = np.ones((3, 3), np.uint8)
SQUARE_5 = np.ones((5, 5), np.uint8)


@dataclass(frozen=True)
class WorkingImage:
    """A small image, shape (h, w, 3) in BGR, and the mask, shape (h, w), of what of it is picture.

    `scale` is its size over that of the image that it was made of; `hinting` gives log odds of instrument for pixels.
    """

    bgr: Image
    picture: Image
    scale: float
    settings: AutoSettings
    hinting: Hint | None = None

    @classmethod
    def of(cls, bgr: Image, settings: AutoSettings, hinting: Hint | None = None) -> WorkingImage:
        """Make it of an image of any size."""
        height, width = bgr.shape[:2]
        scale = settings.working_px / max(width, height)
        size = (round(scale * width), round(scale * height))
        how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
        small = np.asarray(cv2.resize(bgr, size, interpolation=how), np.uint8)
        return cls(small, picture_of(small, settings), scale, settings, hinting)

    @cached_property
    def hint(self) -> Floats:
        """Log odds of instrument that are known beside colours, shape (h, w); 0 without `hinting`."""
        if self.hinting is None or self.settings.network_weight == 0.0:
            return np.zeros(self.picture.shape, np.float32)
        return np.asarray(self.settings.network_weight * self.hinting(self.bgr), np.float32)

    @cached_property
    def core(self) -> Image:
        """The picture without its outermost 2 px, where the optics fade."""
        return np.asarray(cv2.erode(self.picture, SQUARE_5, borderValue=0), np.uint8)

    @cached_property
    def rim(self) -> Image:
        """The outermost pixels of the core, through which instruments come in."""
        return np.asarray(cv2.subtract(self.core, cv2.erode(self.core, SQUARE_3, borderValue=0)), np.uint8)

    @cached_property
    def inner(self) -> NDArray[np.bool_]:
        """What is so far from the rim that an outline there is a thing's own."""
        return np.asarray(cv2.erode(self.core, SQUARE_5, borderValue=0), np.uint8) > 0

    @cached_property
    def area_px(self) -> int:
        """Pixels of the core."""
        return max(int(cv2.countNonZero(self.core)), 1)

    @cached_property
    def colours(self) -> Floats:
        """log(R/G), log(G/B) and the mean of all three logarithms, shape (h, w, 3): light scales only the last."""
        return colour_logs(self._softened, self.settings.level_offset)

    @cached_property
    def warmth(self) -> Floats:
        """log(R/√(GB)), shape (h, w): high in tissue and blood, low in steel."""
        return np.asarray(self.colours[..., 0] + 0.5 * self.colours[..., 1], np.float32)

    @cached_property
    def channels(self) -> tuple[Floats, ...]:
        """What instruments may be low in, shape (h, w) each: warmth, twice, chroma, light, and darkness."""
        keen = colour_logs(self._softened, 0.5 * self.settings.level_offset)
        blunt = colour_logs(self._softened, 3.0 * self.settings.level_offset)
        light = self.colours[..., 2]
        return (
            keen[..., 0] + 0.5 * keen[..., 1],
            blunt[..., 0] + 0.5 * blunt[..., 1],
            np.hypot(blunt[..., 0], blunt[..., 1]),
            light,
            -light,
        )

    @cached_property
    def _softened(self) -> Image:
        return np.asarray(cv2.GaussianBlur(self.bgr, (0, 0), 0.8), np.uint8)


def picture_of(bgr: Image, settings: AutoSettings) -> Image:
    """Mask, shape (h, w), of the picture inside its border, whatever its shape; all of an image without a border.

    A border is the darkest thing in the image; haze lifts both alike. A shaft is brighter, if only by a little.
    """
    value = bgr.max(axis=2)
    floor = float(np.percentile(value, 0.5))
    level = max(floor + settings.border_levels, settings.border_floor_level)
    above = value[value > level]
    if not len(above) or floor > settings.border_fraction * float(np.median(above)):
        return np.full_like(value, 255)
    black = value <= level
    view = field_of_view(np.asarray(255 * black, np.uint8))
    return view if view.any() else np.full_like(view, 255)


def colour_logs(bgr: Image, offset: float) -> Floats:
    """log(R/G), log(G/B) and the mean logarithm of an image, shape (h, w, 3), with `offset` levels added to each."""
    table = np.log(np.arange(256, dtype=np.float32) + np.float32(offset))
    blue, green, red = (np.asarray(cv2.LUT(channel, table), np.float32) for channel in cv2.split(bgr))
    return np.asarray(cv2.merge([red - green, green - blue, (red + green + blue) / 3.0]), np.float32)

"""An image brought to the exposure that a profile's colours were chosen at: dim light raised, haze taken off.

Thresholds of colour are absolute, light is not. Haze adds a veil, I = J t + A (1 - t) (Koschmieder 1924), which the
darkest things in view show, as in the dark-channel prior (He, Sun and Tang 2009); dim light scales all channels
alike. Both are undone by one affine map of the whole image; an image that is neither dim nor veiled is returned as
it is, so that nothing moves where nothing is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from svmdist.samples import Image
from svmdist.vision.field_of_view import field_of_view

COARSE = 4
"""Levels are counted on every fourth row and column."""
BORDER_FRACTION = 0.2
"""Of the bright level: what is darker may be the black frame of an endoscope."""
BLACK_PERCENTILE, MIDDLE_PERCENTILE = 0.5, 50.0
"""A stub of a shaft is half a percent of the view."""
DARK = 45.0
"""Levels that the darkest things reach without a veil: a shaft has 20 to 40."""
DISTINCT = 0.7
"""Where the darkest is brighter than this part of the median, nothing dark is in view, and a veil cannot be told."""
FAIR = 110.0
"""Where automatic exposure puts the middle of a scene at least; less is dim light."""
NOISY_GAIN = 1.5
"""Dim light comes with shot noise: from this gain on, neighbouring pixels are averaged."""
NOISE_SIGMA_PX = 1.0


@dataclass(frozen=True, slots=True)
class Exposure:
    """The map I' = `gain` (I - `veil`), in levels of 255."""

    veil: float
    gain: float

    @property
    def is_plain(self) -> bool:
        """Whether the image is well exposed as it is."""
        return self.veil == 0.0 and self.gain == 1.0


def exposure_of(image_bgr: Image) -> Exposure:
    """The map that brings an image, shape (h, w, 3), to a fair exposure."""
    value = brightest_channel(np.ascontiguousarray(image_bgr[::COARSE, ::COARSE]))
    bright = float(np.percentile(value, 90.0))
    view = field_of_view(np.asarray(255 * (value <= BORDER_FRACTION * bright), np.uint8))
    seen = value[view > 0]
    if len(seen) == 0:
        return Exposure(0.0, 1.0)
    black, middle = np.percentile(seen, [BLACK_PERCENTILE, MIDDLE_PERCENTILE])
    veil = max(0.0, float(black) - DARK) if black < DISTINCT * middle else 0.0
    return Exposure(veil, max(1.0, FAIR / max(float(middle) - veil, 1.0)))


def levelled(image_bgr: Image) -> Image:
    """The image at a fair exposure, shape (h, w, 3); the same array where it is one already."""
    exposure = exposure_of(image_bgr)
    if exposure.is_plain:
        return image_bgr
    if exposure.gain > NOISY_GAIN:
        image_bgr = np.asarray(cv2.GaussianBlur(image_bgr, (0, 0), NOISE_SIGMA_PX), np.uint8)
    levels = exposure.gain * (np.arange(256) - exposure.veil)
    return np.asarray(cv2.LUT(image_bgr, np.clip(np.rint(levels), 0, 255).astype(np.uint8)), np.uint8)


def brightest_channel(image_bgr: Image) -> Image:
    """HSV's value, shape (h, w): NumPy's maximum along the short axis takes twenty times as long."""
    blue, green, red = cv2.split(image_bgr)
    return np.asarray(cv2.max(cv2.max(blue, green), red), np.uint8)

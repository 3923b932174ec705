"""Exposure normalisation: an image as bright and clear as those that a profile's colours were chosen on.

Thresholds of colour are absolute, light is not. Haze adds a veil, I = J t + A (1 - t) (Koschmieder 1924), which the
darkest things in view show, as in the dark-channel prior (He, Sun and Tang 2009); dim light scales all channels
alike. Both are undone by one affine map of the whole image; an image that is neither dim nor veiled is returned as
it is, so that nothing moves where nothing is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from svmdist.profile.settings import ExposureSettings
from svmdist.samples import Image
from svmdist.vision.field_of_view import field_of_view


@dataclass(frozen=True, slots=True)
class Exposure:
    """The map I' = `gain` (I - `veil`), in levels of 255."""

    veil: float
    gain: float

    @property
    def is_plain(self) -> bool:
        """Whether the image is well exposed as it is."""
        return self.veil == 0.0 and self.gain == 1.0


def exposure_of(bgr: Image, settings: ExposureSettings) -> Exposure:
    """The map that normalises the exposure of an image, shape (h, w, 3)."""
    step = settings.sampling_px
    value = brightest_channel(np.ascontiguousarray(bgr[::step, ::step]))
    bright = percentiles(value, (90.0,))[0]
    view = field_of_view(np.asarray(255 * (value <= settings.border_fraction * bright), np.uint8))
    if not view.any():
        return Exposure(0.0, 1.0)
    black, middle = percentiles(value, (settings.black_percentile, settings.middle_percentile), view)
    veil = max(0.0, black - settings.dark_level) if black < settings.distinct_fraction * middle else 0.0
    return Exposure(veil, max(1.0, settings.fair_level / max(middle - veil, 1.0)))


def apply_exposure(bgr: Image, exposure: Exposure, settings: ExposureSettings) -> Image:
    """The image at normalised exposure, shape (h, w, 3); the same array where it is well exposed already."""
    if exposure.is_plain:
        return bgr
    if exposure.gain > settings.noisy_gain:
        bgr = np.asarray(cv2.GaussianBlur(bgr, (0, 0), settings.noise_sigma_px), np.uint8)
    levels = exposure.gain * (np.arange(256) - exposure.veil)
    return np.asarray(cv2.LUT(bgr, np.clip(np.rint(levels), 0, 255).astype(np.uint8)), np.uint8)


def brightest_channel(bgr: Image) -> Image:
    """HSV's value, shape (h, w): NumPy's maximum along the short axis takes twenty times as long."""
    blue, green, red = cv2.split(bgr)
    return np.asarray(cv2.max(cv2.max(blue, green), red), np.uint8)


def percentiles(values: Image, wanted: Sequence[float], mask: Image | None = None) -> list[float]:
    """Percentiles of 8-bit values, shape (h, w), under a mask: NumPy's linear ones, counted and not sorted."""
    counts = cv2.calcHist([values], [0], mask, [256], [0, 256]).ravel()
    below = np.cumsum(counts, dtype=np.float64)
    places = np.asarray(wanted, np.float64) / 100.0 * (below[-1] - 1.0)
    low, high = (np.searchsorted(below, index, side="right") for index in (np.floor(places), np.ceil(places)))
    return [float(value) for value in low + (places - np.floor(places)) * (high - low)]

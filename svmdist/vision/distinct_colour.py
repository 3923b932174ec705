"""Whether instruments carry a mark whose colour nothing else in a log's images has, and the HSV box of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.samples import Image

HUES = range(0, 180, 10)
HALF_WIDTH = 10
"""A mark's hue varies by this much with light and shade."""
MIN_SATURATION, MIN_VALUE = 100, 60
SMALLEST, LARGEST = 1e-4, 1e-2
"""Share of the image that one mark may cover: a joint's ring or cap, neither a speck nor tissue."""
MIN_SHARE = 0.8
"""How much of a hue's pixels must belong to the marks: else something else has the hue."""
MIN_FRAMES = 0.8
MIN_MOTION = 0.01
"""What instruments carry moves, over the image's width."""


@dataclass(frozen=True, slots=True)
class DistinctColour:
    """A box in OpenCV's HSV, bounds included (a hue whose first is above its last wraps), and a mark's area in px."""

    hue: tuple[int, int]
    saturation: tuple[int, int]
    value: tuple[int, int]
    area_px: float


def find_distinct_colour(images: Sequence[Image], mark_count: int = 1) -> DistinctColour | None:
    """The colour of the marks of `mark_count` instruments in images of one log, BGR; None for no such colour.

    Of several candidates, the one with the largest marks.
    """
    if len(images) < 3:
        return None
    hsv = [np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2HSV), np.uint8) for image in images]
    candidates = [_marks(hsv, hue, mark_count) for hue in HUES]
    found = [candidate for candidate in candidates if candidate is not None]
    return max(found, key=lambda candidate: candidate.area_px, default=None)


def _marks(images: Sequence[Image], hue: int, mark_count: int) -> DistinctColour | None:
    areas, places, pixels = [], [], []
    good = 0
    for hsv in images:
        mask = _near(hsv, hue)
        _, labels, statistics, centres = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
        order = 1 + np.argsort(statistics[1:, cv2.CC_STAT_AREA])[::-1][:mark_count]
        total = int(mask.sum())
        if total == 0 or len(order) < mark_count:
            continue
        sizes = statistics[order, cv2.CC_STAT_AREA]
        fits = SMALLEST * mask.size <= sizes.min() and sizes.max() <= LARGEST * mask.size
        if fits and sizes.sum() >= MIN_SHARE * total:
            good += 1
            areas.append(float(sizes.mean()))
            places.append(centres[order][np.argsort(centres[order, 0])].ravel())
            pixels.append(hsv[np.isin(labels, order)])
    if good < MIN_FRAMES * len(images):
        return None
    motion_px = float(np.linalg.norm(np.std(places, axis=0))) / np.sqrt(mark_count)
    if motion_px < MIN_MOTION * images[0].shape[1]:
        return None
    values = np.concatenate(pixels).astype(np.float64)
    turned = (values[:, 0] - hue + 90.0) % 180.0
    low, high = np.percentile(turned, [2, 98]) - 90.0 + hue
    return DistinctColour(
        (round(low - 3) % 180, round(high + 3) % 180),
        (max(0, round(float(np.percentile(values[:, 1], 2)) - 20)), 255),
        (max(0, round(float(np.percentile(values[:, 2], 2)) - 20)), 255),
        float(np.median(areas)),
    )


def _near(hsv: Image, hue: int) -> NDArray[np.bool_]:
    off = np.abs((hsv[..., 0].astype(np.int16) - hue + 90) % 180 - 90)
    return np.asarray((off <= HALF_WIDTH) & (hsv[..., 1] >= MIN_SATURATION) & (hsv[..., 2] >= MIN_VALUE))

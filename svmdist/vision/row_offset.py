"""By how many rows the views of a rectified pair are apart, from points that both of them show.

A calibration, or its rectification, leaves a pixel or two between corresponding rows. Nothing measured along rows
notices, but what both views see then belongs to different places: an edge at 45° is shifted by as much along the row.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from svmdist.least_squares import median, scale_of
from svmdist.profile.settings import StereoSettings
from svmdist.samples import Image
from svmdist.transforms import Array

DEFAULT = StereoSettings()
POINTS, CONTRAST, EDGE = 1000, 0.015, 8.0
"""Of SIFT: wet tissue and paper have little contrast, and a point on an edge has no place along it."""
RATIO = 0.8
"""Of the distances to the nearest and the next descriptor (Lowe 2004)."""
PEAK_PX = 1.5
"""Differences of rows this near to the most frequent one are of points that do correspond."""
MIN_PEAK_SHARE = 0.3
"""Of all matches, those at the most frequent difference. Of differences that mean nothing it is a fifth."""
LEAST_STD_PX = 0.02


@dataclass(frozen=True, slots=True)
class RowOffset:
    """Row in the right view less that in the left one, in px, its standard deviation, and how many points tell it."""

    px: float
    std_px: float
    count: int


def row_differences(
    left_grey: Image, right_grey: Image, min_px: float, max_px: float, settings: StereoSettings = DEFAULT
) -> Array:
    """Row in the right view less that in the left one, shape (n,) in px, of points that look alike (SIFT, Lowe 2004).

    `min_px` and `max_px` bound their disparity; only differences within the settings' range are looked for.
    """
    sift = cv2.SIFT.create(POINTS, 3, CONTRAST, EDGE)
    (at_left, left), (at_right, right) = (
        sift.detectAndCompute(image, None) for image in (left_grey, right_grey)
    )
    if left is None or right is None or len(at_right) < 2:
        return np.zeros(0)
    left_px, right_px = (np.array([point.pt for point in points]) for points in (at_left, at_right))
    disparity_px = left_px[:, None, 0] - right_px[None, :, 0]
    rows_px = right_px[None, :, 1] - left_px[:, None, 1]
    allowed = (
        (disparity_px > min_px) & (disparity_px < max_px) & (np.abs(rows_px) <= settings.max_row_offset_px)
    )
    square = np.sum(left**2, 1)[:, None] + np.sum(right**2, 1)[None] - 2.0 * left @ right.T
    square = np.where(allowed, np.maximum(square, 0.0), np.inf)
    nearest, back = np.argmin(square, 1), np.argmin(square, 0)
    index = np.arange(len(left))
    best = square[index, nearest]
    square[index, nearest] = np.inf
    is_match = (back[nearest] == index) & np.isfinite(best) & (best < RATIO**2 * square.min(1))
    return np.asarray(rows_px[index[is_match], nearest[is_match]], np.float64)


def agreed_offset(differences_px: Array, settings: StereoSettings = DEFAULT) -> RowOffset | None:
    """The offset that most differences, shape (n,), agree on; None where too few do."""
    if len(differences_px) < settings.min_row_points:
        return None
    ordered = np.sort(differences_px)
    inside = np.searchsorted(ordered, ordered + 2.0 * PEAK_PX, "right") - np.arange(len(ordered))
    first = int(np.argmax(inside))
    peak = ordered[first : first + int(inside[first])]
    if len(peak) < max(settings.min_row_points, MIN_PEAK_SHARE * len(ordered)):
        return None
    middle_px = median(peak)
    # Points of one texture err alike: a tenth of them count.
    std_px = float(np.hypot(LEAST_STD_PX, scale_of(peak - middle_px) / np.sqrt(0.1 * len(peak))))
    return RowOffset(middle_px, std_px, len(peak))

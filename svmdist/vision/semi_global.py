"""Semi-global matching of a rectified pair (Hirschmüller 2008), on images as small as the search allows."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.profile.settings import StereoSettings
from svmdist.samples import Image
from svmdist.transforms import Array

SPECKLE_PX2 = 100
"""Patches of matches up to this area, in pixels of the original image, that stand alone are mistakes."""


@dataclass(frozen=True, slots=True)
class Matches:
    """Disparities on a grid of pixels of the left image: columns (w,), rows (h,), both in px, values (h, w) in px.

    A value stands for a cell of `step_px` squared about its pixel; `is_core`, shape (h, w), says which cells lie in
    the region. Values are NaN outside it and where nothing matched.
    """

    columns_px: Array
    rows_px: Array
    disparity_px: Array
    is_core: NDArray[np.bool_]
    step_px: int


def match_region(
    left_grey: Image, right_grey: Image, core: Image, min_px: int, max_px: int, settings: StereoSettings
) -> Matches | None:
    """Matches in the region's core, on images reduced until the search spans the settings' number of disparities."""
    # Matching costs most of all; only the region's rows, and the columns that its matches can lie in, are needed.
    x, y, width, height = cv2.boundingRect(core)
    step = max(1, round((max_px - min_px) / settings.matched_disparities))
    low, high = int(np.floor(min_px / step)), int(np.ceil(max_px / step))
    least_px = step * _least_width_px(low, high, settings.block_px)
    left_px = max(0, min(x - max(max_px, 0), core.shape[1] - least_px))
    right_px = min(max(x + width - min(min_px, 0), left_px + least_px), core.shape[1])
    shape = (height // step, (right_px - left_px) // step)
    if min(shape) == 0:
        return None
    window = np.s_[y : y + step * shape[0], left_px : left_px + step * shape[1]]
    left, right = (_reduced(image[window], step) for image in (left_grey, right_grey))
    disparity_px = step * _match(left, right, low, high, settings.block_px, max(1, SPECKLE_PX2 // step**2))
    middle = (step - 1) // 2
    is_core = core[window][middle::step, middle::step] > 0
    columns_px, rows_px = (
        first + step * np.arange(count, dtype=np.float64) + 0.5 * (step - 1)
        for first, count in ((left_px, shape[1]), (y, shape[0]))
    )
    return Matches(columns_px, rows_px, np.where(is_core, disparity_px, np.nan), is_core, step)


def _match(
    left_grey: Image,
    right_grey: Image,
    min_px: int,
    max_px: int,
    block_px: int,
    speckle_px2: int,
) -> Array:
    """Disparity of every left pixel, shape (h, w) in px; NaN where there is none.

    `min_px` and `max_px` bound the search; OpenCV searches a multiple of 16.
    """
    if left_grey.shape[1] < _least_width_px(min_px, max_px, block_px):
        return np.full(left_grey.shape, np.nan)
    count = 16 * int(np.ceil((max_px - min_px) / 16))
    matcher = cv2.StereoSGBM.create(
        minDisparity=min_px,
        numDisparities=count,
        blockSize=block_px,
        P1=8 * block_px**2,
        P2=64 * block_px**2,
        disp12MaxDiff=2,
        uniquenessRatio=3,
        speckleWindowSize=speckle_px2,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    fixed_point = np.asarray(matcher.compute(left_grey, right_grey), np.float64)
    return np.where(fixed_point >= 16 * min_px, fixed_point / 16.0, np.nan)


def _least_width_px(min_px: int, max_px: int, block_px: int) -> int:
    """Width below which OpenCV's matcher has no column with all disparities in it, and fails."""
    return max(abs(min_px), abs(max_px)) + (max_px - min_px) + 16 + 2 * block_px


def _reduced(image: Image, step: int) -> Image:
    """An image of which each pixel is the mean of `step` squared ones; its sides are multiples of that."""
    size = (image.shape[1] // step, image.shape[0] // step)
    return image if step == 1 else np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)

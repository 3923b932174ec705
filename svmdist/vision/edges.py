"""Sub-pixel edges: where brightness changes fastest across a rough line.

An edge blurred by a symmetric kernel has its steepest point where the sharp edge was, whatever the two
levels beside it. The steepest point of a sampled profile lies between samples; the logarithm of a Gaussian
is a parabola, so three samples of the slope place it exactly for a Gaussian blur (Fisher & Naidu 1996).
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.profile.settings import ShaftSettings
from svmdist.samples import Image
from svmdist.transforms import Array

DEFAULT = ShaftSettings()
STEP_PX = 0.5
"""Between samples across the edge: half a pixel loses nothing of what the pixels hold."""
BLUR_PLACES, BLUR_STRIPS = 8, 7
"""An edge's blur is the median over so many places, each the mean of so many neighbouring profiles."""


def edge_points(
    brightness: Image,
    start_px: Array,
    end_px: Array,
    outward: Array,
    reach_px: float,
    settings: ShaftSettings = DEFAULT,
    blur_px: float = 0.0,
) -> Array:
    """Points of a dark-to-bright edge near the segment from `start_px` to `end_px`, shape (n, 2) in px.

    `brightness` has shape (h, w); `outward` (2,) points from dark to bright. Profiles stand 1 px apart and
    reach `reach_px` to both sides; a profile whose edge is lower than the settings' contrast, or which
    ends before the edge does, gives no point. `blur_px` is the standard deviation of the edge's own blur.
    """
    length_px = float(np.linalg.norm(end_px - start_px))
    if length_px < 2.0:
        return np.zeros((0, 2))
    sigma_px = slope_sigma_px(blur_px, settings)
    at = np.arange(0.5, length_px, 1.0)
    feet_px, across = _feet(start_px, end_px, outward, at)
    profiles, offsets, inside = profiles_across(brightness, feet_px, across, reach_px + 3.0 * sigma_px)
    slope = profiles @ slope_filter(len(offsets), sigma_px)
    searched = (np.abs(offsets) <= reach_px) & inside
    slope = np.where(searched, slope, -np.inf)
    peak = np.argmax(slope, axis=1)
    rows = np.arange(len(peak))
    good = (peak > 0) & (peak < len(offsets) - 1)
    peak = np.clip(peak, 1, len(offsets) - 2)
    before, top, after = slope[rows, peak - 1], slope[rows, peak], slope[rows, peak + 1]
    good &= (top > _min_slope(settings.min_contrast_levels, sigma_px)) & (before > 0) & (after > 0)
    good &= (top >= before) & (top > after)
    log_before, log_top, log_after = (np.log(np.maximum(value, 1e-9)) for value in (before, top, after))
    bend = log_before - 2.0 * log_top + log_after
    good &= bend < -1e-9
    shift = 0.5 * (log_before - log_after) / np.where(good, bend, -1.0)
    found = offsets[peak] + np.clip(shift, -1.0, 1.0) * STEP_PX
    return np.asarray((feet_px + found[:, None] * across)[good])


def edge_blur_px(
    brightness: Image,
    start_px: Array,
    end_px: Array,
    outward: Array,
    reach_px: float,
    settings: ShaftSettings = DEFAULT,
) -> float:
    """The blur of an edge near a segment: the deviation in px of the Gaussian as wide at half its height as its slope.

    0 for an edge as sharp as the derivative's own scale, and where none is found; arguments as in `edge_points`.
    """
    length_px = float(np.linalg.norm(end_px - start_px))
    if length_px < 2.0 * BLUR_STRIPS:
        return 0.0
    sigma_px = settings.slope_sigma_px
    middles = np.linspace(0.5 * BLUR_STRIPS, length_px - 0.5 * BLUR_STRIPS, BLUR_PLACES)
    at = (middles[:, None] + np.arange(BLUR_STRIPS) - BLUR_STRIPS // 2).ravel()
    feet_px, across = _feet(start_px, end_px, outward, at)
    profiles, offsets, inside = profiles_across(brightness, feet_px, across, reach_px + 3.0 * sigma_px)
    whole = inside.all(1).reshape(BLUR_PLACES, BLUR_STRIPS).all(1)
    mean = profiles.reshape(BLUR_PLACES, BLUR_STRIPS, -1).mean(1)[whole]
    slope = (mean @ slope_filter(len(offsets), sigma_px))[:, np.abs(offsets) <= reach_px]
    rows, columns = np.arange(len(slope)), np.arange(slope.shape[1])
    peak = np.argmax(slope, axis=1)
    top = slope[rows, peak]
    low = slope < 0.5 * top[:, None]
    before, after = low & (columns < peak[:, None]), low & (columns >= peak[:, None])
    # A ramp of the contrast over the whole reach is the slowest rise that counts.
    found = (top >= settings.min_contrast_levels / (2.0 * reach_px)) & before.any(1) & after.any(1)
    if not found.any():
        return 0.0
    last_before = slope.shape[1] - 1 - np.argmax(before[:, ::-1], axis=1)
    widths_px = ((np.argmax(after, axis=1) - last_before - 1) * STEP_PX)[found]
    # A Gaussian's width at half its height is √(8 ln 2) of its deviation.
    edge_sigma_px = float(np.median(widths_px)) / np.sqrt(8.0 * np.log(2.0))
    return float(np.sqrt(max(0.0, edge_sigma_px**2 - sigma_px**2)))


def slope_sigma_px(blur_px: float, settings: ShaftSettings = DEFAULT) -> float:
    """Scale of the derivative that finds an edge of a blur: as wide as usual optics, or nearly as the blur."""
    return max(settings.slope_sigma_px, settings.slope_sigma_per_blur * blur_px)


def _feet(start_px: Array, end_px: Array, outward: Array, at: Array) -> tuple[Array, Array]:
    """Points on a segment at distances `at`, shape (n,), from its start, and the unit vector across it outward."""
    along = (end_px - start_px) / np.linalg.norm(end_px - start_px)
    across = np.array([-along[1], along[0]])
    return start_px + at[:, None] * along, across if across @ outward > 0 else -across


def profiles_across(
    brightness: Image, feet_px: Array, across: Array, half_px: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Brightness across an edge, shape (n, k), at offsets, shape (k,) in px, and whether each is in the image."""
    offsets = np.arange(-half_px, half_px + STEP_PX / 2, STEP_PX)
    x = feet_px[:, 0, None] + offsets * across[0]
    y = feet_px[:, 1, None] + offsets * across[1]
    height, width = brightness.shape
    left, right, top, bottom = x.min(), x.max(), y.min(), y.max()
    if left >= 0 and top >= 0 and right <= width - 1 and bottom <= height - 1:
        inside = np.ones(x.shape, np.bool_)
    else:
        inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    # Only what the profiles cross is turned into floats; cubic interpolation reads two pixels beyond.
    column, row = (int(np.clip(least - 2, 0, size - 1)) for least, size in ((left, width), (top, height)))
    window = brightness[row : max(int(bottom) + 4, row + 1), column : max(int(right) + 4, column + 1)]
    return _sampled(window, x, y, column, row), offsets, inside


def _min_slope(min_contrast: float, sigma_px: float) -> float:
    """A step of height c smoothed by σ has slope c / (σ √(2π)) at its steepest; the image's blur doubles σ."""
    return float(min_contrast / (np.sqrt(2.0 * np.pi) * 2.0 * sigma_px))


def _sampled(window: Image, x: Array, y: Array, column: int, row: int) -> Array:
    """Brightness at places, shape (n, k) in px, with cubic interpolation; the border is repeated.

    `window` is the part of the image that begins at a column and a row.
    """
    # Subtracted in single precision, where the difference is exact: the image's own coordinates decide.
    places = (x.astype(np.float32) - np.float32(column), y.astype(np.float32) - np.float32(row))
    values = cv2.remap(window.astype(np.float32), *places, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, np.float64)


@lru_cache(maxsize=16)
def slope_filter(count: int, sigma_px: float) -> Array:
    """Matrix, shape (count, count), that turns profiles into their slopes per px, smoothed."""
    offset = (np.arange(count)[:, None] - np.arange(count)[None, :]) * STEP_PX
    kernel = np.exp(-0.5 * (offset / sigma_px) ** 2) * STEP_PX / (np.sqrt(2.0 * np.pi) * sigma_px)
    matrix = np.asarray(kernel * offset / sigma_px**2)
    matrix.flags.writeable = False
    return matrix

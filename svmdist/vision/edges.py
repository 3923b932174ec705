"""Sub-pixel edges: where brightness changes fastest across a rough line, what shading does to that, and discs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.least_squares import huber_weights, median, scale_of
from svmdist.profile.settings import ShaftSettings
from svmdist.samples import Image
from svmdist.transforms import Array

SLOPE_SIGMA_PX = 1.2  # of the derivative of Gaussian: as wide as usual optics blur
SLOPE_SIGMA_PER_BLUR = 0.8  # a blurred edge is sought at this scale over its own
MIN_CHROMA = 25.0  # levels between inside and outside below which there is no border to find
MIN_AGREEING_FRACTION = 0.5  # of rays on the border's circle: with less the circle is a guess

RoughEdge = tuple[Array, Array, Array]  # both ends in px, and a vector from dark to bright, (2,) each
STEP_PX = 0.5  # between samples across the edge: half a pixel loses nothing of what the pixels hold
BLUR_PLACES, BLUR_STRIPS = 8, 7  # a blur is the median over places, each the mean of neighbouring profiles


def edge_points(
    brightness: Image, rough: RoughEdge, reach_px: float, settings: ShaftSettings, blur_px: float = 0.0
) -> Array:
    """Points of an edge, shape (n, 2) in px, near a rough one in an image of shape (h, w).

    Profiles stand 1 px apart and reach `reach_px` to both sides; one whose edge is lower than the settings' contrast,
    or which ends before the edge does, gives no point. `blur_px` is the standard deviation of the edge's own blur.
    """
    length_px = float(np.linalg.norm(rough[1] - rough[0]))
    if length_px < 2.0:
        return np.zeros((0, 2))
    sigma_px = slope_sigma_px(blur_px)
    feet_px, across = _feet(rough, np.arange(0.5, length_px, 1.0))
    profiles, offsets, inside = profiles_across(brightness, feet_px, across, reach_px + 3.0 * sigma_px)
    slope = profiles @ slope_filter(len(offsets), sigma_px)
    slope = np.where((np.abs(offsets) <= reach_px) & inside, slope, -np.inf)
    peak = np.argmax(slope, axis=1)
    rows = np.arange(len(peak))
    good = (peak > 0) & (peak < len(offsets) - 1)
    peak = np.clip(peak, 1, len(offsets) - 2)
    before, top, after = slope[rows, peak - 1], slope[rows, peak], slope[rows, peak + 1]
    good &= (top > least_slope(settings.min_contrast_levels, sigma_px)) & (before > 0) & (after > 0)
    good &= (top >= before) & (top > after)
    found = offsets[peak] + peak_shift_px(before, top, after, good)
    return np.asarray((feet_px + found[:, None] * across)[good & np.isfinite(found)])


def peak_shift_px(before: Array, top: Array, after: Array, good: NDArray[np.bool_]) -> Array:
    """How far the peak of a Gaussian through three samples is off the middle one, (n,); NaN where it is none."""
    log_before, log_top, log_after = (np.log(np.maximum(value, 1e-9)) for value in (before, top, after))
    bend = log_before - 2.0 * log_top + log_after
    good = good & (bend < -1e-9)
    shift = 0.5 * (log_before - log_after) / np.where(good, bend, -1.0)
    return np.where(good, np.clip(shift, -1.0, 1.0) * STEP_PX, np.nan)


def edge_blur_px(brightness: Image, rough: RoughEdge, reach_px: float, settings: ShaftSettings) -> float:
    """An edge's blur: the deviation in px of the Gaussian as wide at half its height as the edge's slope."""
    length_px = float(np.linalg.norm(rough[1] - rough[0]))
    if length_px < 2.0 * BLUR_STRIPS:
        return 0.0
    middles = np.linspace(0.5 * BLUR_STRIPS, length_px - 0.5 * BLUR_STRIPS, BLUR_PLACES)
    at = (middles[:, None] + np.arange(BLUR_STRIPS) - BLUR_STRIPS // 2).ravel()
    feet_px, across = _feet(rough, at)
    profiles, offsets, inside = profiles_across(brightness, feet_px, across, reach_px + 3.0 * SLOPE_SIGMA_PX)
    whole = inside.all(1).reshape(BLUR_PLACES, BLUR_STRIPS).all(1)
    mean = profiles.reshape(BLUR_PLACES, BLUR_STRIPS, -1).mean(1)[whole]
    slope = (mean @ slope_filter(len(offsets), SLOPE_SIGMA_PX))[:, np.abs(offsets) <= reach_px]
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
    return float(np.sqrt(max(0.0, edge_sigma_px**2 - SLOPE_SIGMA_PX**2)))


def slope_sigma_px(blur_px: float) -> float:
    """Scale of the derivative that finds an edge of a blur: as wide as usual optics, or nearly as the blur."""
    return max(SLOPE_SIGMA_PX, SLOPE_SIGMA_PER_BLUR * blur_px)


def _feet(rough: RoughEdge, at: Array) -> tuple[Array, Array]:
    start_px, end_px, outward = rough
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
    inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    # Only what the profiles cross is turned into floats; cubic interpolation reads two pixels beyond.
    column, row = (int(np.clip(least - 2, 0, size - 1)) for least, size in ((left, width), (top, height)))
    window = brightness[row : max(int(bottom) + 4, row + 1), column : max(int(right) + 4, column + 1)]
    # Subtracted in single precision, where the difference is exact: the image's own coordinates decide.
    places = (x.astype(np.float32) - np.float32(column), y.astype(np.float32) - np.float32(row))
    values = cv2.remap(window.astype(np.float32), *places, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, np.float64), offsets, inside


def least_slope(min_contrast: float, sigma_px: float) -> float:
    """A step of height c smoothed by σ has slope c / (σ √(2π)) at its steepest; the image's blur doubles σ."""
    return float(min_contrast / (np.sqrt(2.0 * np.pi) * 2.0 * sigma_px))


@lru_cache(maxsize=16)
def slope_filter(count: int, sigma_px: float) -> Array:
    """Matrix, shape (count, count), that turns profiles into their slopes per px, smoothed."""
    offset = (np.arange(count)[:, None] - np.arange(count)[None, :]) * STEP_PX
    kernel = np.exp(-0.5 * (offset / sigma_px) ** 2) * STEP_PX / (np.sqrt(2.0 * np.pi) * sigma_px)
    matrix = np.asarray(kernel * offset / sigma_px**2)
    matrix.flags.writeable = False
    return matrix


SHADE_FROM_PX, SHADE_FROM_BLUR, SHADE_LENGTH_PX = 1.0, 2.0, 6.0
"""Shades beside an edge are read from so far off it, two deviations of its blur, over such a length."""
MAX_SHIFT = 0.25  # by shading, over the slope's scale: beyond, the first order is not enough


def shading_shift_px(brightness: Image, points_px: Array, outward: Array, blur_px: float = 0.0) -> float:
    """How far outward shading beside an edge drew its points, shape (n, 2) in px, as `edge_points` found them.

    A step of height c under an even kernel k, between shades that change by g per px inside and outside, has the
    slope c k(x) + g_in (1 - K(x)) + g_out K(x), with K the integral of k. It is steepest where

        x = (g_out - g_in) / c · k(0) / -k''(0)

    and k(0) / -k''(0), for a Gaussian its variance, is read off the slope's own peak. `outward` (2,) has length 1.
    The shades are those of the median profile beyond the blur; 0 where it is no such edge.
    """
    sigma_px = slope_sigma_px(blur_px)
    clear_px = SHADE_FROM_PX + SHADE_FROM_BLUR * blur_px
    profiles, offsets, inside = profiles_across(brightness, points_px, outward, clear_px + SHADE_LENGTH_PX)
    profiles = profiles[inside.all(1)]
    if len(profiles) == 0:
        return 0.0
    profile = np.median(profiles, axis=0)
    slope = profile @ slope_filter(len(offsets), sigma_px)
    middle = len(offsets) // 2
    before, top, after = slope[middle - 1], slope[middle], slope[middle + 1]
    bend = before - 2.0 * top + after
    dark, bright = offsets <= -clear_px, offsets >= clear_px
    g_in, level_in = _line_through(offsets[dark], profile[dark])
    g_out, level_out = _line_through(offsets[bright], profile[bright])
    contrast = level_out - level_in
    if not (bend < 0.0 < top and contrast > 0.0):
        return 0.0
    shift_px = (g_out - g_in) / contrast * top / -bend * STEP_PX**2
    return float(np.clip(shift_px, -MAX_SHIFT * sigma_px, MAX_SHIFT * sigma_px))


def _line_through(x: Array, y: Array) -> tuple[float, float]:
    """Slope, and height at 0, of the line of least squares."""
    middle, height = x.mean(), y.mean()
    slope = float((x - middle) @ (y - height) / ((x - middle) @ (x - middle)))
    return slope, float(height - slope * middle)


RAYS = 64
STEP_PX_DISC = 0.25
# Where the strength within and without is read, over the radius: clear of the border's blur
INSIDE, OUTSIDE = (0.4, 0.7), (1.25, 1.7)
BORDER_FROM = 0.6  # of the radius: the border is sought from here outward
FIT_STEPS, HUBER = 6, 1.5


@dataclass(frozen=True, slots=True)
class Disc:
    """Centre (2,) and radius in px, the deviation of the border's points, and the border's blur."""

    centre_px: Array
    radius_px: float
    scatter_px: float
    blur_px: float


def fit_disc(image_hsv: Image, mask: Image, centre_px: Array, radius_px: float) -> Disc | None:
    """The disc near a rough one; None where its border is not to be found. `mask`, shape (h, w), has its colour."""
    half = int(np.ceil(2.0 * radius_px)) + 2
    x0, y0 = (np.floor(centre_px).astype(int) - half).tolist()
    height, width = mask.shape
    rows = slice(max(y0, 0), min(y0 + 2 * half + 1, height))
    columns = slice(max(x0, 0), min(x0 + 2 * half + 1, width))
    window, inside = image_hsv[rows, columns], mask[rows, columns] > 0
    if np.count_nonzero(inside) < 8:
        return None
    turns = window[..., 0][inside] * (np.pi / 90.0)
    hue = float(np.arctan2(np.sin(turns).mean(), np.cos(turns).mean()) * 90.0 / np.pi)
    # Chroma along the hue: 0 for grey, negative for the opposite hue.
    hsv = window.astype(np.float32)
    angle = (hsv[..., 0] - hue) * np.float32(np.pi / 90.0)
    strength = (hsv[..., 1] * hsv[..., 2] / 255.0 * np.cos(angle)).astype(np.float32)
    origin_px = np.array([columns.start, rows.start], np.float64)
    centre_px = centre_px - origin_px
    angles = np.linspace(0.0, 2.0 * np.pi, RAYS, endpoint=False)
    directions = np.stack([np.cos(angles), np.sin(angles)], -1)
    reach_px = np.arange(0.0, OUTSIDE[1] * radius_px, STEP_PX_DISC)
    places = (centre_px + reach_px[None, :, None] * directions[:, None, :]).astype(np.float32)
    ways = cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE
    values = np.asarray(cv2.remap(strength, places[..., 0], places[..., 1], *ways), np.float64)
    within = (reach_px >= INSIDE[0] * radius_px) & (reach_px <= INSIDE[1] * radius_px)
    # Along each ray: one side of a sphere is in shade.
    high = np.asarray(np.median(values[:, within], axis=1), np.float64)
    low = np.asarray(np.median(values[:, reach_px >= OUTSIDE[0] * radius_px], axis=1), np.float64)
    # From outside of a highlight on, which is as pale as what is around the marker.
    outer = reach_px >= BORDER_FROM * radius_px
    values, reach_px = values[:, outer], reach_px[outer]
    half_px = _crossing(values, reach_px, 0.5 * (high + low))
    usable = np.isfinite(half_px) & (high - low > MIN_CHROMA)
    if np.count_nonzero(usable) < MIN_AGREEING_FRACTION * RAYS:
        return None
    outer_px = _crossing(values, reach_px, 0.16 * high + 0.84 * low)
    spread_px = outer_px - _crossing(values, reach_px, 0.84 * high + 0.16 * low)
    blur_px = float(np.nanmedian(spread_px[usable])) / 2.0 if np.isfinite(spread_px[usable]).any() else 0.0
    points_px = centre_px + half_px[usable, None] * directions[usable]
    return _circle(points_px, centre_px, max(blur_px, 0.0), origin_px)


def _crossing(values: Array, reach_px: Array, level: Array) -> Array:
    """Where each profile, shape (n, k), first falls below its level, shape (n,); NaN where it does not."""
    below = values < level[:, None]
    index = np.argmax(below, axis=1)
    found = below.any(axis=1) & (index > 0)
    index = np.maximum(index, 1)
    rows = np.arange(len(values))
    before, after = values[rows, index - 1], values[rows, index]
    part = (before - level) / np.where(before > after, before - after, 1.0)
    return np.where(found, reach_px[index - 1] + part * STEP_PX_DISC, np.nan)


def _circle(points_px: Array, centre_px: Array, blur_px: float, origin_px: Array) -> Disc | None:
    """The circle through most points, shape (n, 2), by Gauss-Newton with Huber's weights."""
    radius_px = median(np.linalg.norm(points_px - centre_px, axis=1))
    for _ in range(FIT_STEPS):
        offset = points_px - centre_px
        distance_px = np.linalg.norm(offset, axis=1)
        residual_px = distance_px - radius_px
        scale_px = max(scale_of(residual_px), 0.1)
        weight = huber_weights(residual_px, HUBER * scale_px) ** 2
        J = np.column_stack([offset / distance_px[:, None], np.ones(len(offset))])
        step = np.linalg.solve(J.T @ (weight[:, None] * J) + 1e-9 * np.eye(3), J.T @ (weight * residual_px))
        centre_px, radius_px = centre_px + step[:2], radius_px + float(step[2])
    agreeing = np.count_nonzero(np.abs(residual_px) < 3.0 * scale_px)
    if not radius_px > 1.0 or agreeing < MIN_AGREEING_FRACTION * RAYS:
        return None
    # Blur of deviation σ draws the level of one half inwards by σ² / 2R on a border of radius R.
    whole_px = radius_px + blur_px**2 / (2.0 * radius_px)
    return Disc(centre_px + origin_px, whole_px, scale_px, blur_px)

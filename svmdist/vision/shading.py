"""What shading beside a sub-pixel edge does to its place: a limb that darkens draws the steepest point outward."""

from __future__ import annotations

import numpy as np

from svmdist.profile.settings import ShaftSettings
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.edges import STEP_PX, profiles_across, slope_filter, slope_sigma_px

DEFAULT = ShaftSettings()
SHADE_FROM_PX, SHADE_FROM_BLUR, SHADE_LENGTH_PX = 1.0, 2.0, 6.0
"""Shades beside an edge are read from so far off it, two deviations of its blur, over such a length."""
MAX_SHIFT = 0.25
"""Of the slope's scale: a larger shift by shading is no small one, and its first order is not enough."""


def shading_shift_px(
    brightness: Image,
    points_px: Array,
    outward: Array,
    settings: ShaftSettings = DEFAULT,
    blur_px: float = 0.0,
) -> float:
    """How far outward shading beside an edge drew its points, shape (n, 2) in px, as `edge_points` found them.

    A step of height c under an even kernel k, between shades that change by g per px inside and outside, has the
    slope c k(x) + g_in (1 - K(x)) + g_out K(x), with K the integral of k. It is steepest where

        x = (g_out - g_in) / c · k(0) / -k''(0)

    and k(0) / -k''(0), for a Gaussian its variance, is read off the slope's own peak. `outward` (2,) has length 1.
    The shades are those of the median profile beyond the blur; 0 where it is no such edge.
    """
    sigma_px = slope_sigma_px(blur_px, settings)
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

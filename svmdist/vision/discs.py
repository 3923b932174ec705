"""The disc that a sphere shows: its border where the strength of its colour falls to one half."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from svmdist.least_squares import huber_weights, median, scale_of
from svmdist.samples import Image
from svmdist.transforms import Array

MIN_CHROMA = 25.0  # levels between inside and outside below which there is no border to find
MIN_INLIER_FRACTION = 0.5  # of rays on the border's circle: with less the circle is a guess
INLIER_RADIUS = 0.06  # of the radius: what is farther off the circle is another thing's border
OF_LIGHT = 0.75
"""Power of value in the strength of a colour: chroma (1) falls off with the light towards a limb, which makes discs up
to 15% too small where the light is at the endoscope; saturation (0) is noise in the dark."""
RAYS = 64
STEP_PX = 0.25
SLOPE_STEPS = 3  # to either side, over which a slope is taken
STEEP_PX = 2.5  # from the border, where the steepest place is sought
# Where the strength within and without is read, over the radius: clear of the border's blur
INSIDE, OUTSIDE = (0.4, 0.7), (1.25, 1.7)
BORDER_FROM = 0.6  # of the radius: the border is sought from here outward
FIT_STEPS, HUBER = 12, 1.5
INSIDE_STDS = 2.0  # at which a point inside of the circle counts a quarter
LEAST_SCATTER_PX = 0.25  # of the border: it is sampled no finer


@dataclass(frozen=True, slots=True)
class Disc:
    """Centre (2,) and radius in px, the deviation of the border's points from it, and the doubt where the border is.

    The doubt is how far the place where half of the strength is left is from the steepest one: shade, haze, neighbours
    of like colour and blocks of a codec part them, and blur does not.
    """

    centre_px: Array
    radius_px: float
    scatter_px: float
    doubt_px: float


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
    # Colour along the hue: 0 for grey, negative for the opposite hue.
    hsv = window.astype(np.float32)
    angle = (hsv[..., 0] - hue) * np.float32(np.pi / 90.0)
    strength = (hsv[..., 1] * (hsv[..., 2] / 255.0) ** OF_LIGHT * np.cos(angle)).astype(np.float32)
    origin_px = np.array([columns.start, rows.start], np.float64)
    centre_px = centre_px - origin_px
    angles = np.linspace(0.0, 2.0 * np.pi, RAYS, endpoint=False)
    directions = np.stack([np.cos(angles), np.sin(angles)], -1)
    reach_px = np.arange(0.0, OUTSIDE[1] * radius_px, STEP_PX)
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
    if np.count_nonzero(usable) < MIN_INLIER_FRACTION * RAYS:
        return None
    outer_px = _crossing(values, reach_px, 0.16 * high + 0.84 * low)
    spread_px = outer_px - _crossing(values, reach_px, 0.84 * high + 0.16 * low)
    blur_px = float(np.nanmedian(spread_px[usable])) / 2.0 if np.isfinite(spread_px[usable]).any() else 0.0
    points_px = centre_px + half_px[usable, None] * directions[usable]
    doubt_px = median(np.abs(_steepest(values, reach_px, half_px) - half_px)[usable])
    return _circle(points_px, centre_px, max(blur_px, 0.0), doubt_px, origin_px)


def _crossing(values: Array, reach_px: Array, level: Array) -> Array:
    """Where each profile, shape (n, k), first falls below its level, shape (n,); NaN where it does not."""
    index = np.argmax(values < level[:, None], axis=1)
    rows = np.arange(len(values))
    before, after = values[rows, index - 1], values[rows, index]
    part = (before - level) / np.where(before > after, before - after, 1.0)
    return np.where(index > 0, reach_px[index - 1] + part * STEP_PX, np.nan)


def _steepest(values: Array, reach_px: Array, near_px: Array) -> Array:
    """Where each profile, shape (n, k), falls off most near a place, shape (n,)."""
    at = np.arange(len(reach_px))
    slope = values[:, np.maximum(at - SLOPE_STEPS, 0)] - values[:, np.minimum(at + SLOPE_STEPS, at[-1])]
    is_near = np.abs(reach_px - near_px[:, None]) <= STEEP_PX
    return np.asarray(reach_px[np.argmax(np.where(is_near, slope, -np.inf), axis=1)])


def _circle(points_px: Array, centre_px: Array, blur_px: float, doubt_px: float, origin_px: Array) -> Disc | None:
    """The circle that points, shape (n, 2), bound, by Gauss-Newton with Huber's weights outside of it.

    What hides a part of a disc has its own border inside of the disc's: the further inside, the less that counts.
    """
    radius_px = median(np.linalg.norm(points_px - centre_px, axis=1))
    for _ in range(FIT_STEPS):
        offset = points_px - centre_px
        distance_px = np.linalg.norm(offset, axis=1)
        residual_px = distance_px - radius_px
        outside = residual_px > 0.0
        scale_px = max(scale_of(residual_px[outside]), LEAST_SCATTER_PX) if outside.any() else LEAST_SCATTER_PX
        inside = 1.0 / (1.0 + (residual_px / (INSIDE_STDS * scale_px)) ** 2)
        weight = np.where(outside, huber_weights(residual_px, HUBER * scale_px), inside) ** 2
        J = np.column_stack([offset / distance_px[:, None], np.ones(len(offset))])
        step = np.linalg.solve(J.T @ (weight[:, None] * J) + 1e-9 * np.eye(3), J.T @ (weight * residual_px))
        centre_px, radius_px = centre_px + step[:2], radius_px + float(step[2])
    inlier_count = np.count_nonzero(np.abs(residual_px) < max(2.0 * LEAST_SCATTER_PX, INLIER_RADIUS * radius_px))
    if not radius_px > 1.0 or inlier_count < MIN_INLIER_FRACTION * RAYS:
        return None
    # Blur of deviation σ draws the level of one half inwards by σ² / 2R on a border of radius R.
    whole_px = radius_px + blur_px**2 / (2.0 * radius_px)
    return Disc(centre_px + origin_px, whole_px, scale_px, doubt_px)

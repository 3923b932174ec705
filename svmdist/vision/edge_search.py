"""Edges near a segment of an image: profiles of colour across it, and the straight line that most of them change at."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.least_squares import median
from svmdist.profile.settings import SilhouetteSettings
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.edges import STEP_PX, slope_filter

BLOCK, MIN_BLOCKS = 8, 2
"""Neighbouring profiles that vote as one, and the least number of such votes."""
FAINT = 0.3
"""The slope of a point of an edge over that of most of them, below which it is none."""


@dataclass(frozen=True, slots=True)
class Profiles:
    """Slopes of three channels across a segment, shape (3, n, k), at `offsets`, shape (k,) in px, and what is seen.

    `seen`, shape (n, k), says which samples are in the picture; `sigma_px` is the scale of the slopes.
    """

    slopes: Array
    offsets: Array
    seen: NDArray[np.bool_]
    sigma_px: float

    def first(self, count: int) -> Profiles:
        """Those of the segment's first part."""
        return Profiles(self.slopes[:, :count], self.offsets, self.seen[:count], self.sigma_px)


@dataclass(frozen=True, slots=True)
class LineAcross:
    """A line across profiles: its offset in the side's middle and how much more at its end, px, and how distinct.

    `part` is how much of the side it goes along.
    """

    offset_px: float
    slant_px: float
    support: float
    part: float

    def at(self, where: Array) -> Array:
        """Its offsets at fractions of the side, shape (n,)."""
        return self.offset_px + self.slant_px * (2.0 * where - 1.0)


def profiles_across(
    bgr: Image, feet_px: Array, across: Array, half_px: float, sigma_px: float, picture: Image | None
) -> Profiles:
    """The profiles of an image, shape (h, w, 3), through points, shape (n, 2), along a unit vector `across`, (2,).

    They reach `half_px` to both sides, and beyond by what the slope's scale takes.
    """
    half_px += 3.0 * sigma_px
    half_px = np.ceil(half_px / STEP_PX) * STEP_PX
    offsets = np.arange(-half_px, half_px + STEP_PX / 2, STEP_PX)
    x = feet_px[:, 0, None] + offsets * across[0]
    y = feet_px[:, 1, None] + offsets * across[1]
    height, width = bgr.shape[:2]
    seen = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    if picture is not None:
        column, row = (np.clip(np.rint(v), 0, size - 1).astype(int) for v, size in ((x, width), (y, height)))
        seen &= picture[row, column] > 0
    # A slope is made of samples to both sides: all of them must be picture.
    wide = np.ones((1, 2 * int(2.0 * sigma_px / STEP_PX) + 1), np.uint8)
    seen = cv2.erode(np.asarray(seen, np.uint8), wide, borderValue=1) > 0
    left, top = (
        int(np.clip(least, 0, size - 1)) for least, size in ((x.min() - 1, width), (y.min() - 1, height))
    )
    window = bgr[top : max(int(y.max()) + 3, top + 1), left : max(int(x.max()) + 3, left + 1)]
    places = ((x - left).astype(np.float32), (y - top).astype(np.float32))
    values = cv2.remap(window.astype(np.float32), *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    kernel = slope_filter(len(offsets), sigma_px).astype(np.float32)
    slopes = np.ascontiguousarray(np.moveaxis(values, 2, 0)) @ kernel
    return Profiles(np.asarray(slopes, np.float64), offsets, seen, sigma_px)


def straightest(
    profiles: Profiles, where: Array, reach_px: float, turn_px: float, settings: SilhouetteSettings
) -> LineAcross | None:
    """The most distinct line within a reach of the segment, turned by so much at its ends; None without any.

    `where`, shape (n,), says how far along the segment each profile is, from 0 to 1. Neighbouring profiles vote as one,
    by their common change of colour: an edge goes on, texture does not.
    """
    slopes, offsets, seen, sigma_px = profiles.slopes, profiles.offsets, profiles.seen, profiles.sigma_px
    count = len(where) // BLOCK
    if count < 2:
        return None
    common = slopes[:, : count * BLOCK].reshape(3, count, BLOCK, -1).mean(2)
    strength = np.sqrt(np.sum(common * common, 0))
    # A step of height c, smoothed, has slope c / (σ √(2π)); what is common in the neighbourhood is no step.
    half = max(
        settings.full_contrast_levels / (np.sqrt(2.0 * np.pi) * 1.4 * sigma_px),
        settings.texture_factor * float(np.median(strength)),
    )
    blocks = strength / (strength + half)
    blocks[~seen[: count * BLOCK].reshape(count, BLOCK, -1).all(1)] = 0.0
    middle = where[: count * BLOCK].reshape(count, BLOCK).mean(1)
    step_px = max(STEP_PX, 0.5 * sigma_px)
    slants = np.arange(-turn_px, turn_px + step_px / 2, step_px)
    candidates = np.flatnonzero(np.abs(offsets) <= reach_px)
    steps = np.rint(slants[:, None] * (2.0 * middle - 1.0) / STEP_PX).astype(int)  # (slants, blocks)
    columns = np.clip(candidates[None, None, :] + steps[:, :, None], 0, len(offsets) - 1)
    # Wrist and jaws may make the rough side too long: the edge goes as far as it gains by that.
    gain = np.cumsum(blocks[np.arange(count)[None, :, None], columns] - settings.min_support, axis=1)
    gain[:, : min(MIN_BLOCKS, count) - 1] = -np.inf
    last = np.argmax(gain, axis=1)
    total = np.take_along_axis(gain, last[:, None], 1)[:, 0]  # (slants, offsets)
    slant, offset = np.unravel_index(int(np.argmax(total)), total.shape)
    best, reached = float(total[slant, offset]), int(last[slant, offset]) + 1
    if not best > 0.0:
        return None
    support = best / reached + settings.min_support
    return LineAcross(
        float(offsets[candidates[offset]]), float(slants[slant]), support, float(reached / count)
    )


def points_near(profiles: Profiles, place: Array, reach_px: float, min_slope: float) -> Array:
    """Sub-pixel offset of each profile's edge near a line at offsets `place`, shape (n,); NaN where there is none.

    Colours are projected on what most of the neighbourhood changes by, so that a step has one sign.
    """
    slopes, offsets, seen = profiles.slopes, profiles.offsets, profiles.seen
    rows = np.arange(len(place))
    column = np.rint((place - offsets[0]) / STEP_PX).astype(int)
    reach = int(reach_px / STEP_PX)
    columns = np.clip(column[:, None] + np.arange(-reach, reach + 1), 1, len(offsets) - 2)
    change = slopes[:, rows[:, None], columns].sum(2)  # (3, n)
    kernel = np.ones((1, 4 * BLOCK + 1))
    change = np.asarray(cv2.filter2D(change, -1, kernel, borderType=cv2.BORDER_REPLICATE), np.float64)
    change = change / np.maximum(np.linalg.norm(change, axis=0), 1e-9)
    slope = np.einsum("cn,cnk->nk", change, slopes)
    window = slope[rows[:, None], columns]
    best = np.argmax(window, 1)
    peak = columns[rows, best]
    before, top, after = slope[rows, peak - 1], slope[rows, peak], slope[rows, peak + 1]
    inside = (best > 0) & (best < 2 * reach) & seen[rows, peak]
    good = inside & (before > 0.0) & (after > 0.0) & (top >= before) & (top >= after) & (top > min_slope)
    # What is much fainter than most of the edge is texture beside it.
    good &= top > FAINT * (median(top[good]) if good.any() else 0.0)
    log_before, log_top, log_after = (np.log(np.maximum(value, 1e-9)) for value in (before, top, after))
    bend = log_before - 2.0 * log_top + log_after
    good &= bend < -1e-9
    shift = 0.5 * (log_before - log_after) / np.where(good, bend, -1.0)
    return np.where(good, offsets[peak] + np.clip(shift, -1.0, 1.0) * STEP_PX, np.nan)

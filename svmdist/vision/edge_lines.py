"""A shaft's straight edge near a side that is nearly right, whatever colours meet there, to where it ends.

Where the shaft's own shadow lies beside it, its edge is within: a shadow keeps the colour of what it falls on.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.least_squares import median, scale_of
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.shaft_segmentation import Side

SLOPE_SIGMA_PX = 1.2  # of the derivative of Gaussian: as wide as usual optics blur
STEP_PX = 0.5  # between samples across the edge: half a pixel loses nothing of what the pixels hold
MIN_FOUND = 0.7  # of the profiles that show an edge, on the line: texture shows most beside it
MIN_SEEN = 0.3  # of all profiles across an edge: a dark shaft before dark tissue has none for a while
STRAIGHT_PX = 0.6  # of an edge's point off the shaft's line: the wrist goes on a pixel or two beside it
STRAIGHT_WIDTHS = 0.02  # the same over the shaft's width, where that is more
END_SHARE = 0.6  # the cylinder ends where less than this part of the points beyond lie on its line
END_REACH_WIDTHS = 2.0  # how far beyond a rough side its continuation is followed, over the shaft's width
NEIGHBOURS = 33  # profiles whose common change of colour says which way an edge goes
SCATTER_STDS = 2.5  # of the points' scatter, within which they are on the line
FAINT = 0.3  # the slope of a point of an edge over that of most of them, below which it is none
SLOPE_OFFSETS_PX = STEP_PX * np.arange(-9.0, 10.0)
SLOPE_FILTER = SLOPE_OFFSETS_PX * np.exp(-0.5 * (SLOPE_OFFSETS_PX / SLOPE_SIGMA_PX) ** 2)
SLOPE_FILTER *= STEP_PX / (np.sqrt(2.0 * np.pi) * SLOPE_SIGMA_PX**3)  # in levels per px, as OpenCV correlates
# Shades beside an edge are read from so far off it, clear of the filter and of its blur, over so many samples
SHADE_FROM_PX, SHADE_FROM_BLUR, SHADE_STEPS = 3.0, 2.0, 8
MAX_SHIFT = 0.25  # by shading, over the scale of the slope: beyond, the first order is not enough
SPACING_PX, MOST_PROFILES = 1.5, 100  # between profiles; and along a rough side, where that would be more
PEAK_REACH_PX = 2.0  # from a line to a profile's own edge, at least
ROUGH_PX = 1.5  # of a rough side off its edge, in pixels of the working image that it was found in
END_PROFILES = 5  # beyond an end, of which most must be seen
REFINEMENTS, END_STEPS, ROBUST_STEPS = 3, 2, 5  # how often the line, its end and its weights are looked at
WINDOW = 3.0  # where an edge is sought, over how far it may be off: of texture a third is that near, of an edge all
MIN_POINTS = 8
START_PART = 0.8  # of a rough side, what is surely shaft: the rest may be wrist already
UNSEEN_SHARE = 0.15  # against a line by a profile without an edge, where one beside the line counts `END_SHARE`

Profiles = tuple[NDArray[np.float32], Array, NDArray[np.bool_]]
"""Slopes of three channels across a segment (3, n, k), at offsets (k,) in px, and what is seen (n, k)."""


def _profiles_across(bgr: Image, feet_px: Array, across: Array, half_px: float, picture: Image | None) -> Profiles:
    """The profiles of an image, shape (h, w, 3), through points, shape (n, 2), along a unit vector `across`, (2,)."""
    half_px = np.ceil((half_px + 3.0 * SLOPE_SIGMA_PX) / STEP_PX) * STEP_PX
    offsets = np.arange(-half_px, half_px + STEP_PX / 2, STEP_PX)
    x, y = (feet_px[:, axis, None] + offsets * across[axis] for axis in (0, 1))
    last_x, last_y = bgr.shape[1] - 1, bgr.shape[0] - 1
    seen = (x >= 0) & (y >= 0) & (x <= last_x) & (y <= last_y)
    if picture is not None:
        seen &= picture[np.rint(y).clip(0, last_y).astype(int), np.rint(x).clip(0, last_x).astype(int)] > 0
    # A slope is made of samples to both sides: all of them must be picture.
    wide = np.ones((1, 2 * int(2.0 * SLOPE_SIGMA_PX / STEP_PX) + 1), np.uint8)
    seen = cv2.erode(np.asarray(seen, np.uint8), wide, borderValue=1) > 0
    left, top = int(np.clip(x.min() - 1, 0, last_x)), int(np.clip(y.min() - 1, 0, last_y))
    window = bgr[top : max(int(y.max()) + 3, top + 1), left : max(int(x.max()) + 3, left + 1)].astype(np.float32)
    places = (x - left).astype(np.float32), (y - top).astype(np.float32)
    values = cv2.remap(window, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    slopes = cv2.filter2D(values, -1, SLOPE_FILTER[None].astype(np.float32), borderType=cv2.BORDER_REPLICATE)
    return np.ascontiguousarray(np.moveaxis(slopes, 2, 0)), offsets, seen


def _points_near(
    profiles: Profiles, column: NDArray[np.intp], reach_px: float, least_levels: float
) -> tuple[Array, Array]:
    """Sub-pixel offsets of the profiles' edges near a line in these columns, (n,), NaN without; variances in px²."""
    slopes, offsets, seen = profiles
    rows, reach = np.arange(len(column)), int(reach_px / STEP_PX)
    columns = np.clip(column[:, None] + np.arange(-reach, reach + 1), 1, len(offsets) - 2)
    around = slopes[:, rows[:, None], columns]
    change = cv2.filter2D(around.sum(2), -1, np.ones((1, NEIGHBOURS)), borderType=cv2.BORDER_REPLICATE)  # (3, n)
    change = change / np.maximum(np.linalg.norm(change, axis=0), 1e-9)
    best = np.argmax((change[:, :, None] * around).sum(0), 1)
    peak = columns[rows, best]
    before, top, after = ((change * slopes[:, rows, peak + off]).sum(0) for off in (-1, 0, 1))
    inside = (best > 0) & (best < 2 * reach) & seen[rows, peak]
    good = inside & (before > 0.0) & (after > 0.0) & (top >= before) & (top >= after)
    # A step of height c has slope c / (σ √(2π)) at its steepest; the image's blur doubles σ.
    good &= top > least_levels / (2.0 * SLOPE_SIGMA_PX * np.sqrt(2.0 * np.pi))
    # What is much fainter than most of the edge is texture beside it.
    good &= top > FAINT * (median(top[good]) if good.any() else 0.0)
    # The width and the peak of a Gaussian through these samples.
    ratio = np.where(good, before * after, 0.25) / np.where(good, top * top, 1.0)
    width_px2 = -(STEP_PX**2) / np.log(np.clip(ratio, 1e-9, 1.0 - 1e-3))
    log_before, log_top, log_after = (np.log(np.maximum(value, 1e-9)) for value in (before, top, after))
    bend = log_before - 2.0 * log_top + log_after
    good &= bend < -1e-9
    shift = 0.5 * (log_before - log_after) / np.where(good, bend, -1.0)
    return np.where(good, offsets[peak] + np.clip(shift, -1.0, 1.0) * STEP_PX, np.nan), width_px2


@dataclass(frozen=True, slots=True)
class EdgeLine(Side):
    """An edge from the border to where it stops being straight.

    `points_px`, shape (n, 2), are its sub-pixel points from the border to the end, most of them within `within_px` of
    the line between both ends. `ends` is False where it goes on as far as was looked, or to where nothing can be seen.
    Of an edge that is not sharp the line is known by the `covariance`, (2, 2) in px², of its offsets at both ends;
    without points no edge is seen. `blur_px` is the deviation of the edge's own blur.
    """

    points_px: Array
    ends: bool
    within_px: float = 0.0
    covariance: Array | None = None
    blur_px: float = 0.0


def edge_line(
    bgr: Image, rough: Array, width_px: float, rough_px: float, picture: Image | None, least_levels: float
) -> EdgeLine | None:
    """The edge, a step of at least so many levels, near a side, (2, 2) from start to end, that is off by `rough_px`."""
    start, end = rough
    length_px = float(np.linalg.norm(end - start))
    if length_px < MIN_POINTS * SPACING_PX:
        return None
    along = (end - start) / length_px
    across = np.array([-along[1], along[0]])
    spacing_px = max(SPACING_PX, length_px / MOST_PROFILES)
    at = np.arange(0.5 * spacing_px, length_px + END_REACH_WIDTHS * width_px, spacing_px)
    within_px = max(STRAIGHT_PX, STRAIGHT_WIDTHS * width_px)
    bounds_px = within_px, max(within_px, ROUGH_PX * rough_px)
    fine_px = max(PEAK_REACH_PX, WINDOW * within_px)
    wide_px = max(WINDOW * ROUGH_PX * rough_px, fine_px)
    profiles = _profiles_across(bgr, start + at[:, None] * along, across, wide_px + fine_px, picture)
    slopes, offsets, seen = profiles
    offset_px, slope, end_at, looked_at = 0.0, 0.0, length_px, (0.0, 0.0, b"")
    for reach_px in (wide_px, *[fine_px] * (REFINEMENTS - 1)):
        column = np.rint((offset_px + slope * at - offsets[0]) / STEP_PX).astype(int)
        before, looked_at = looked_at, (reach_px, end_at, column.tobytes())
        if looked_at == before:  # it would find the same
            break
        off_px, width_px2 = _points_near(profiles, column, reach_px, least_levels)
        found = _ending_line(at, off_px, end_at, bounds_px)
        if found is None:
            return None
        offset_px, slope, end_at, within_px = found
    is_before = at <= end_at
    used = np.isfinite(off_px) & is_before
    on_line = used & (np.abs(np.where(used, off_px, np.inf) - (offset_px + slope * at)) < within_px)
    # A line through texture has its points here and there: most of what is seen beside it is not on it.
    count, least = np.count_nonzero(on_line), MIN_SEEN * np.count_nonzero(is_before)
    if count < max(MIN_POINTS, least, MIN_FOUND * np.count_nonzero(used)):
        return None
    beyond = (at > end_at) & (at < end_at + END_PROFILES * spacing_px)
    column = np.rint((offset_px + slope * at - offsets[0]) / STEP_PX).clip(0, len(offsets) - 1).astype(int)
    shown = seen[np.arange(len(at)), column]
    ends = bool(end_at < at[-1] - 2.0 * spacing_px and shown[beyond].mean() > 0.5)
    blur_px = float(np.sqrt(max(median(width_px2[on_line]) - SLOPE_SIGMA_PX**2, 0.0)))
    shift_px = _shading_shift_px(slopes[:, on_line], column[on_line], blur_px) * across
    at = np.append([0.0, end_at], at[used])  # both ends, and the points
    off_px = np.append(offset_px + slope * at[:2], off_px[used])
    points_px = start + at[:, None] * along + off_px[:, None] * across - shift_px
    return EdgeLine(points_px[0], points_px[1], points_px[2:], ends, within_px, None, blur_px)


def _shading_shift_px(slopes: NDArray[np.float32], column: NDArray[np.intp], blur_px: float) -> float:
    """How far shading beside an edge draws its points, by slopes (3, n, k) of profiles and their columns at it, (n,).

    A step of height c under an even kernel k, between shades that change by g per px before and behind, has the slope
    c k(x) + g_before (1 - K(x)) + g_behind K(x), with K the integral of k. It is steepest where

        x = (g_behind - g_before) / c · k(0) / -k''(0)

    and k(0) / -k''(0), for a Gaussian its variance, is read off the slope's own peak. 0 where it is no such edge.
    """
    clear = int(np.ceil((SHADE_FROM_PX + SHADE_FROM_BLUR * blur_px) / STEP_PX))
    columns = column[:, None] + np.arange(-clear - SHADE_STEPS, clear + SHADE_STEPS + 1)
    rows = ((columns >= 0) & (columns < slopes.shape[2])).all(1)
    if not rows.any():
        return 0.0
    around = slopes[:, np.flatnonzero(rows)[:, None], columns[rows]]
    change = around[:, :, SHADE_STEPS:-SHADE_STEPS].sum((1, 2))
    profile = np.median(np.tensordot(change / max(float(np.linalg.norm(change)), 1e-9), around, 1), axis=0)
    middle = len(profile) // 2
    g_before, g_behind = float(profile[:SHADE_STEPS].mean()), float(profile[-SHADE_STEPS:].mean())
    top, bend = profile[middle], profile[middle - 1] - 2.0 * profile[middle] + profile[middle + 1]
    contrast = STEP_PX * (profile[SHADE_STEPS:-SHADE_STEPS].sum() - (clear + 0.5) * (g_before + g_behind))
    if not (bend < 0.0 < top and contrast > 0.0):
        return 0.0
    shift_px = (g_behind - g_before) / contrast * top / -bend * STEP_PX**2
    most_px = MAX_SHIFT * float(np.hypot(SLOPE_SIGMA_PX, blur_px))
    return float(np.clip(shift_px, -most_px, most_px))


def _ending_line(
    at: Array, off_px: Array, length_px: float, bounds_px: tuple[float, float]
) -> tuple[float, float, float, float] | None:
    """The straight part from the border on, of offsets, shape (n,), at places, shape (n,); NaN is no edge.

    Gives its offset at the segment's start, its slope, the place where it ends, and how far off it its points may be:
    as their scatter is, between two bounds.
    """
    end_at = START_PART * length_px
    found = np.isfinite(off_px)
    for _ in range(END_STEPS):
        part = found & (at <= max(end_at, 0.3 * length_px))
        if np.count_nonzero(part) < MIN_POINTS:
            return None
        offset_px, slope = _robust_line(at[part], off_px[part])
        residual = np.where(found, np.abs(off_px - offset_px - slope * at), np.inf)
        within_px = float(np.clip(SCATTER_STDS * scale_of(residual[part]), *bounds_px))
        on_line = residual < within_px
        # The sum is largest where the part with more points on the line than off it ends. Where nothing is seen, as
        # of a dark shaft before dark tissue, little is said.
        total = np.cumsum(np.where(on_line, 1.0 - END_SHARE, np.where(found, -END_SHARE, -UNSEEN_SHARE)))
        best = int(np.argmax(total))
        if not total[best] > 0.0:
            return None
        end_at = float(at[best])
    return offset_px, slope, end_at, within_px


def _robust_line(x: Array, y: Array) -> tuple[float, float]:
    """Offset and slope of the line through most points, by Tukey's biweight from a median start."""
    half = len(x) // 2
    slopes = (y[half : 2 * half] - y[:half]) / np.maximum(x[half : 2 * half] - x[:half], 1e-9)
    slope = median(slopes)
    offset = median(y - slope * x)
    for _ in range(ROBUST_STEPS):
        residual = y - offset - slope * x
        scale = max(scale_of(residual), 0.08) * 4.0
        weight = np.square(np.maximum(1.0 - np.square(residual / scale), 0.0))
        total = weight.sum()
        if not total > 0.0:
            break
        centre, height = float(weight @ x) / total, float(weight @ y) / total
        spread = max(float(weight @ np.square(x - centre)), 1e-9)
        slope = float(weight @ ((x - centre) * (y - height))) / spread
        offset = height - slope * centre
    return offset, slope


PENUMBRA_RATIO = 1.6  # of the edges' blurs; beyond, one is a shadow's border: both edges are equally far
PENUMBRA_BLUR_PX = 1.0  # blur that any edge may have, px: below it the ratio of two blurs is noise
SHADOW_REACH = 0.45  # of the width, shadow included, how far inside of its border the shaft's edge is sought
CORE = (0.4, 0.6)  # from one edge to the other, where the shaft's own colour is looked at
BORDER_PX = 3.0  # to either side of a shadow's border, where its colour is looked at
BESIDE_PX = (6.0, 14.0)  # outside of it, where what is beside it is
LEAST_SHADOW_PX = 3.0  # between both edges: nearer, they are one
MIN_COLOUR = 0.08  # by which colours differ at least, in logarithms of ratios: 8 % of red over green
MIN_DARKER = 0.1  # logarithm of levels: 10 %
FAINT_STEP = 0.2  # of an edge within over the border's own: less is grain of the shaft, edges have 0.6 and more
DARK_LEVEL = 4.0  # added to levels, so that the colour of black is grey
COLOUR_STD_PX = 2.0  # of a line by colours: images keep half of their resolution
SIDE = 6  # samples to either side of an edge, where brightness is compared
STARTS = 30  # points of which each two give a line to be tried


def edge_within(
    bgr: Image, outer: EdgeLine, other: EdgeLine, picture: Image | None, least_levels: float
) -> EdgeLine | None:
    """The shaft's edge, where a side of a silhouette is that of its shadow; None where it is its own.

    Both edges of a shaft are equally far, and as sharp. Within the one that is less so there is a shadow, if what is
    there is darker than what is beside it, and has its ratios of red, green and blue (Gevers and Smeulders 1999), up to
    a line from which on they are the shaft's. Where the image has an edge of brightness along that line, too, it is
    sharper than the shadow's border; it must be there where that is hardly less sharp than the other side.
    """
    sharp_px, start_px, length_px = most_blur_px(other), outer.start_px, outer.length_px
    is_sharp, is_blurred = outer.covariance is None, outer.blur_px > sharp_px
    is_sharpest = is_sharp and PENUMBRA_RATIO * outer.blur_px <= sharp_px
    if is_sharpest or length_px < MIN_POINTS * SPACING_PX:
        return None
    along = outer.direction
    across = np.array([-along[1], along[0]])
    width_px = float(np.mean((np.stack([other.start_px, other.end_px]) - start_px) @ across))
    across, width_px = across * np.sign(width_px), abs(width_px)
    at = np.arange(0.5, length_px, max(SPACING_PX, length_px / MOST_PROFILES))
    offsets = np.arange(-BESIDE_PX[1], CORE[1] * width_px, STEP_PX)
    x, y = np.moveaxis((start_px + at[:, None, None] * along + offsets[:, None] * across).astype(np.float32), 2, 0)
    levels = cv2.remap(bgr, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
    logs = cv2.GaussianBlur(np.log(levels + DARK_LEVEL), (0, 0), SLOPE_SIGMA_PX / STEP_PX).astype(float)
    ratios = logs[..., ::2] - logs[..., 1:2]
    # How far colours are from the shaft's on the way to that at the shadow's border; NaN where both are alike.
    shaft = np.median(ratios[:, offsets >= min(CORE[0] * width_px, offsets[-1])], axis=(0, 1))
    border = np.median(ratios[:, np.abs(offsets) < BORDER_PX], axis=1)
    away = cv2.blur(border, (1, NEIGHBOURS)) - shaft
    square = (away**2).sum(1, keepdims=True)
    share = ((ratios - shaft) @ away[..., None])[..., 0] / np.where(square > MIN_COLOUR**2, square, np.nan)
    # From outside on, where the shaft's own colour is nearer.
    is_shaft = (share < 0.5) & (offsets > 0.0) & (offsets < SHADOW_REACH * width_px)
    off_px = np.where(is_shaft.any(1), offsets[np.argmax(is_shaft, axis=1)] - 0.5 * STEP_PX, np.nan)
    within_px = max(STRAIGHT_PX, STRAIGHT_WIDTHS * width_px)
    off_px = _without_stains(at, off_px, within_px)
    found = _ending_line(at, off_px, length_px, (within_px, WINDOW * within_px))
    if found is None:
        return None
    offset_px, slope, end_at, within_px = found
    shadow_px = offset_px + slope * at
    is_on = (np.abs(off_px - shadow_px) < within_px) & (at <= end_at)
    in_shadow = (offsets > BORDER_PX) & (offsets < (shadow_px - 0.5 * BORDER_PX)[:, None]) & is_on[:, None]
    if np.count_nonzero(is_on) < MIN_POINTS or not in_shadow.any():
        return None
    green, is_beside = logs[..., 1], offsets < -BESIDE_PX[0]
    darker = median(green[is_on][:, is_beside].ravel()) - median(green[in_shadow])
    # The dark side of a shaft that reflects tissue is of another colour.
    beside = np.median(ratios[is_on][:, is_beside], axis=(0, 1))
    changed = float(np.linalg.norm(np.median(ratios[in_shadow], axis=0) - beside))
    if median(shadow_px[is_on]) < LEAST_SHADOW_PX or darker < MIN_DARKER or changed > MIN_COLOUR:
        return None
    ends_at = np.array([[0.0], [end_at]])
    rough = start_px + ends_at * along + (offset_px + slope * ends_at) * across
    sharp = edge_line(bgr, rough, width_px, COLOUR_STD_PX, picture, least_levels)
    if sharp is not None and sharp.blur_px <= (min(sharp_px, outer.blur_px) if is_sharp else sharp_px):
        ends = np.stack([sharp.start_px, sharp.end_px]) - start_px
        apart_px = ends @ across - offset_px - slope * (ends @ along)
        column = np.searchsorted(offsets, np.interp(at, ends @ along, ends @ across))
        sides = (column + off for off in (SIDE, -SIDE))
        inside, outside = (green[np.arange(len(at)), side.clip(0, len(offsets) - 1)] for side in sides)
        rise = median((inside - outside)[is_on])
        # Colours run into the dark: where the edge of brightness is outside of theirs, the shaft is the darker one.
        is_theirs = abs(apart_px.mean()) < COLOUR_STD_PX or apart_px.mean() * rise > 0.0
        if is_theirs and abs(rise) > FAINT_STEP * darker and np.ptp(apart_px) < COLOUR_STD_PX * np.sqrt(2.0):
            return sharp
    seen_px = start_px + at[is_on, None] * along + off_px[is_on, None] * across
    by_colours = EdgeLine(rough[0], rough[1], seen_px, False, within_px, COLOUR_STD_PX**2 * np.eye(2), COLOUR_STD_PX)
    # Where nothing is sharp there may be anything, and of a border as sharp as the other side colours alone say little.
    return by_colours if is_sharp and is_blurred else None


def most_blur_px(other: EdgeLine) -> float:
    """The blur of an edge beyond which it is a shadow's border, by the shaft's other one."""
    return PENUMBRA_RATIO * max(PENUMBRA_BLUR_PX, other.blur_px if other.covariance is None else 0.0)


def _without_stains(at: Array, off_px: Array, within_px: float) -> Array:
    """Offsets of an edge, (n,), with NaN for those farther inward than the line that most of them allow.

    Blood on a shaft is of the tissue's colour, and so are its reflections: they draw points inward, never outward.
    """
    some = np.flatnonzero(np.isfinite(off_px))[:: max(1, len(at) // STARTS)]
    first, second = (some[index] for index in np.triu_indices(len(some), max(1, len(some) // 4)))
    if not len(first):
        return off_px
    slope = (off_px[second] - off_px[first]) / (at[second] - at[first])
    inward_px = off_px - off_px[first, None] - slope[:, None] * (at - at[first, None])
    votes = (np.abs(inward_px) < within_px).sum(1) - (inward_px < -within_px).sum(1)
    return np.where(inward_px[int(np.argmax(votes))] < within_px, off_px, np.nan)

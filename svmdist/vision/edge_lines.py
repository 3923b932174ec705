"""A straight edge in an image near a rough one, whatever colours meet there, from the border to where it ends."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.least_squares import median, scale_of
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.edges import SLOPE_SIGMA_PX, STEP_PX, least_slope, peak_shift_px, slope_filter

EDGE_REACH_FRACTION = 0.012  # how far from a rough side the image's edge is searched, over the image's width
# The same over the shaft's width, where that is more: jaws and ears lead a rough side astray
EDGE_REACH_WIDTHS = 0.3
EDGE_TURN_WIDTHS = 0.35  # of an edge's ends in opposite directions, over the shaft's width
SEARCH_SCALE_WIDTHS = 0.04  # of the slope that is sought first: texture of tissue is finer
TEXTURE_FACTOR = (
    1.5  # a slope of so many times the neighbourhood's median counts half as much as the largest one
)
FULL_CONTRAST_LEVELS = 16.0  # counts half as much as the largest step: straightness matters, not strength
MIN_CONTRAST_LEVELS = 12.0  # least step of colour at an edge's point, of 255: compression leaves less
MIN_FOUND = 0.7  # of the profiles that show an edge, on the line: texture shows most beside it
MIN_SEEN = 0.3  # of all profiles across an edge: a dark shaft before dark tissue has none for a while
MIN_SUPPORT = 0.4  # mean response below which there is no edge of an instrument
STRAIGHT_PX = 0.6  # of an edge's point off the shaft's line: the wrist goes on a pixel or two beside it
STRAIGHT_WIDTHS = 0.02  # the same over the shaft's width, where that is more
END_SHARE = 0.6  # the cylinder ends where less than this part of the points beyond lie on its line
END_REACH_WIDTHS = 2.0  # how far beyond a rough side its continuation is followed, over the shaft's width

BLOCK, MIN_BLOCKS = 8, 2  # neighbouring profiles that vote as one, and the least number of such votes
FAINT = 0.3  # the slope of a point of an edge over that of most of them, below which it is none


@dataclass(frozen=True, slots=True)
class Profiles:
    """Slopes of three channels across a segment (3, n, k) at `offsets` (k,) px, what is seen (n, k), their scale."""

    slopes: Array
    offsets: Array
    seen: NDArray[np.bool_]
    sigma_px: float


def _profiles_across(
    bgr: Image, feet_px: Array, across: Array, half_px: float, sigma_px: float, picture: Image | None
) -> Profiles:
    """The profiles of an image, shape (h, w, 3), through points, shape (n, 2), along a unit vector `across`, (2,)."""
    half_px = np.ceil((half_px + 3.0 * sigma_px) / STEP_PX) * STEP_PX
    offsets = np.arange(-half_px, half_px + STEP_PX / 2, STEP_PX)
    x, y = (feet_px[:, axis, None] + offsets * across[axis] for axis in (0, 1))
    height, width = bgr.shape[:2]
    seen = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    if picture is not None:
        column, row = (np.clip(np.rint(v), 0, size - 1).astype(int) for v, size in ((x, width), (y, height)))
        seen &= picture[row, column] > 0
    # A slope is made of samples to both sides: all of them must be picture.
    wide = np.ones((1, 2 * int(2.0 * sigma_px / STEP_PX) + 1), np.uint8)
    seen = cv2.erode(np.asarray(seen, np.uint8), wide, borderValue=1) > 0
    left, top = (int(np.clip(v.min() - 1, 0, size - 1)) for v, size in ((x, width), (y, height)))
    window = bgr[top : max(int(y.max()) + 3, top + 1), left : max(int(x.max()) + 3, left + 1)]
    places = ((x - left).astype(np.float32), (y - top).astype(np.float32))
    values = cv2.remap(window.astype(np.float32), *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    kernel = slope_filter(len(offsets), sigma_px).astype(np.float32)
    slopes = np.ascontiguousarray(np.moveaxis(values, 2, 0)) @ kernel
    return Profiles(np.asarray(slopes, np.float64), offsets, seen, sigma_px)


def _straightest(
    profiles: Profiles, where: Array, reach_px: float, turn_px: float
) -> tuple[float, float, float] | None:
    """The most distinct line near a side, by the common change of colour of neighbouring profiles at fractions (n,).

    Its offset in the side's middle and how much more it is at its end, px, and the part of the side it goes along.
    """
    slopes, offsets, seen, sigma_px = profiles.slopes, profiles.offsets, profiles.seen, profiles.sigma_px
    count = len(where) // BLOCK
    if count < 2:
        return None
    common = slopes[:, : count * BLOCK].reshape(3, count, BLOCK, -1).mean(2)
    strength = np.sqrt(np.sum(common * common, 0))
    # A step of height c, smoothed, has slope c / (σ √(2π)); what is common in the neighbourhood is no step.
    full = FULL_CONTRAST_LEVELS / (np.sqrt(2.0 * np.pi) * 1.4 * sigma_px)
    blocks = strength / (strength + max(full, TEXTURE_FACTOR * float(np.median(strength))))
    blocks[~seen[: count * BLOCK].reshape(count, BLOCK, -1).all(1)] = 0.0
    middle = where[: count * BLOCK].reshape(count, BLOCK).mean(1)
    step_px = max(STEP_PX, 0.5 * sigma_px)
    slants = np.arange(-turn_px, turn_px + step_px / 2, step_px)
    candidates = np.flatnonzero(np.abs(offsets) <= reach_px)
    steps = np.rint(slants[:, None] * (2.0 * middle - 1.0) / STEP_PX).astype(int)  # (slants, blocks)
    columns = np.clip(candidates[None, None, :] + steps[:, :, None], 0, len(offsets) - 1)
    # Wrist and jaws may make the rough side too long: the edge goes as far as it gains by that.
    gain = np.cumsum(blocks[np.arange(count)[None, :, None], columns] - MIN_SUPPORT, axis=1)
    gain[:, : min(MIN_BLOCKS, count) - 1] = -np.inf
    last = np.argmax(gain, axis=1)
    total = np.take_along_axis(gain, last[:, None], 1)[:, 0]  # (slants, offsets)
    slant, offset = np.unravel_index(int(np.argmax(total)), total.shape)
    if not total[slant, offset] > 0.0:
        return None
    place, part = offsets[candidates[offset]], (last[slant, offset] + 1) / count
    return float(place), float(slants[slant]), float(part)


def _points_near(profiles: Profiles, place: Array, reach_px: float) -> Array:
    """Sub-pixel offset of each profile's edge near a line at offsets `place`, shape (n,); NaN where there is none."""
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
    good = inside & (before > 0.0) & (after > 0.0) & (top >= before) & (top >= after)
    good &= top > least_slope(MIN_CONTRAST_LEVELS, profiles.sigma_px)
    # What is much fainter than most of the edge is texture beside it.
    good &= top > FAINT * (median(top[good]) if good.any() else 0.0)
    return np.asarray(offsets[peak] + peak_shift_px(before, top, after, good))


SPACING_PX = 1.5  # between profiles
PEAK_REACH_PX = 2.0  # from a line to a profile's own edge, at least
REFINEMENTS = 2  # how often the line is looked at anew
WINDOW = 3.0
"""Where a profile's own edge is sought, over how far it may be off: of texture a third is that near, of an edge all."""
REFINED_PER_SCALE = 1.5  # how far from the rough line the fine one is sought, over the rough one's scale
MIN_POINTS = 8
START_PART = 0.8  # of an edge that was found roughly, what is surely shaft: the rest may be wrist already
END_STEPS = 3
UNSEEN_SHARE = (
    0.15  # against a line by a profile without an edge, where one beside the line counts `END_SHARE`
)


@dataclass(frozen=True, slots=True)
class EdgeLine:
    """An edge from the border to where it stops being straight.

    `points_px`, shape (n, 2), are its sub-pixel points from the border to the end; `start_px` and `end_px`, shape (2,),
    are on the line through them. `ends` is False where it goes on as far as was looked.
    """

    start_px: Array
    end_px: Array
    points_px: Array
    ends: bool

    @property
    def direction(self) -> Array:
        """Unit vector towards the tip, shape (2,)."""
        return np.asarray((self.end_px - self.start_px) / self.length_px)

    @property
    def length_px(self) -> float:
        """Distance of both ends."""
        return float(np.linalg.norm(self.end_px - self.start_px))


@dataclass(frozen=True, slots=True)
class _Segment:
    """A rough side, continued: start, unit vectors along and across it, (2,), length, and places on it, (n,)."""

    start_px: Array
    along: Array
    across: Array
    length_px: float
    at: Array

    @staticmethod
    def of(rough: Array, beyond_px: float) -> _Segment | None:
        """That of a side, shape (2, 2) from start to end, and what follows it; None of one that is too short."""
        start, end = rough
        length_px = float(np.linalg.norm(end - start))
        if length_px < 2.0 * BLOCK * SPACING_PX:
            return None
        along = (end - start) / length_px
        at = np.arange(0.5 * SPACING_PX, length_px + beyond_px, SPACING_PX)
        return _Segment(start, along, np.array([-along[1], along[0]]), length_px, at)

    def points(self, at: Array, off_px: Array) -> Array:
        """Pixels, shape (n, 2), at places along it and offsets from it, shape (n,)."""
        return np.asarray(self.start_px + at[:, None] * self.along + off_px[:, None] * self.across)


_Line = tuple[float, float, float]
"""A straight part of an edge: its offset at the segment's start, its slope, and the place where it ends."""


def edge_line(bgr: Image, rough: Array, width_px: float, picture: Image | None = None) -> EdgeLine | None:
    """The edge of an image, shape (h, w, 3), near a rough side, shape (2, 2) from start to end; None without one."""
    segment = _Segment.of(rough, END_REACH_WIDTHS * width_px)
    line = None if segment is None else _first_line(bgr, segment, width_px, picture)
    if segment is None or line is None:
        return None
    at, across = segment.at, segment.across
    straight_px = max(STRAIGHT_PX, STRAIGHT_WIDTHS * width_px)
    reach_px = max(PEAK_REACH_PX, WINDOW * straight_px)
    off_px = np.full(len(at), np.nan)
    # Its points are sought about the line through them, which may lie beyond what was looked at before, farther on.
    for _ in range(REFINEMENTS):
        place = line[0] + line[1] * at
        feet_px = segment.points(at, place)
        profiles = _profiles_across(bgr, feet_px, across, reach_px, SLOPE_SIGMA_PX, picture)
        off_px = place + _points_near(profiles, np.zeros(len(at)), reach_px)
        line = _ending_line(at, off_px, line[2], straight_px)
        if line is None:
            return None
    offset_px, slope, end_at = line
    before = at <= end_at
    used = np.isfinite(off_px) & before
    on_line = used & (np.abs(np.where(used, off_px, np.inf) - (offset_px + slope * at)) < straight_px)
    # A line through texture has its points here and there: most of what is seen beside it is not on it.
    count, least = np.count_nonzero(on_line), MIN_SEEN * np.count_nonzero(before)
    if count < max(MIN_POINTS, least, MIN_FOUND * np.count_nonzero(used)):
        return None
    ends_at = np.array([0.0, end_at])
    first, last = segment.points(ends_at, offset_px + slope * ends_at)
    ends = end_at < at[-1] - 2.0 * SPACING_PX
    return EdgeLine(first, last, segment.points(at[used], off_px[used]), bool(ends))


def _first_line(bgr: Image, segment: _Segment, width_px: float, picture: Image | None) -> _Line | None:
    """The edge roughly: at a scale that tissue's texture is small against, then at the scale of the optics."""
    at, across = segment.at, segment.across
    side = int(np.count_nonzero(at <= segment.length_px))
    where = at / segment.length_px
    coarse_px = max(SLOPE_SIGMA_PX, SEARCH_SCALE_WIDTHS * width_px)
    reach_px = max(EDGE_REACH_FRACTION * bgr.shape[1], EDGE_REACH_WIDTHS * width_px)
    turn_px = max(reach_px, EDGE_TURN_WIDTHS * width_px)
    feet_px = segment.points(at[:side], np.zeros(side))
    profiles = _profiles_across(bgr, feet_px, across, reach_px + turn_px, coarse_px, picture)
    rough = _straightest(profiles, where[:side], reach_px, turn_px)
    if rough is None:
        return None
    place, reach_px = rough[0] + rough[1] * (2.0 * where - 1.0), REFINED_PER_SCALE * coarse_px
    profiles = _profiles_across(
        bgr, segment.points(at, place), across, 2.0 * reach_px, SLOPE_SIGMA_PX, picture
    )
    first = replace(profiles, slopes=profiles.slopes[:, :side], seen=profiles.seen[:side])
    fine = _straightest(first, where[:side], reach_px, reach_px)
    if fine is None:
        return None
    offset_px, slant_px, part = fine
    near_px = offset_px + slant_px * (2.0 * where - 1.0)
    off_px = place + _points_near(profiles, near_px, max(PEAK_REACH_PX, coarse_px))
    straight_px = max(STRAIGHT_PX, STRAIGHT_WIDTHS * width_px)
    return _ending_line(at, off_px, part * segment.length_px, straight_px)


def _ending_line(at: Array, off_px: Array, length_px: float, straight_px: float) -> _Line | None:
    """The straight part from the border on, of offsets, shape (n,), at places, shape (n,); NaN is no edge."""
    end_at = START_PART * length_px
    found = np.isfinite(off_px)
    line = (0.0, 0.0)
    for _ in range(END_STEPS):
        part = found & (at <= max(end_at, 0.3 * length_px))
        if np.count_nonzero(part) < MIN_POINTS:
            return None
        line = _robust_line(at[part], off_px[part])
        residual = np.where(found, np.abs(off_px - line[0] - line[1] * at), np.inf)
        on_line = residual < straight_px
        # The sum is largest where the part with more points on the line than off it ends. Where nothing is seen, as
        # of a dark shaft before dark tissue, little is said.
        total = np.cumsum(np.where(on_line, 1.0 - END_SHARE, np.where(found, -END_SHARE, -UNSEEN_SHARE)))
        best = int(np.argmax(total))
        if not total[best] > 0.0:
            return None
        end_at = float(at[best])
    return *line, end_at


def _robust_line(x: Array, y: Array) -> tuple[float, float]:
    """Offset and slope of the line through most points, by Tukey's biweight from a median start."""
    half = len(x) // 2
    slopes = (y[half : 2 * half] - y[:half]) / np.maximum(x[half : 2 * half] - x[:half], 1e-9)
    slope = median(slopes)
    offset = median(y - slope * x)
    for _ in range(8):
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

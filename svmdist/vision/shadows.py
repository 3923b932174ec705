"""Which edge is the shaft's, where its own shadow lies beside it: a shadow keeps the colour of what it falls on."""

from __future__ import annotations

import cv2
import numpy as np

from svmdist.least_squares import median
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision import edge_lines as edges

PENUMBRA_RATIO = 1.6  # of the edges' blurs; beyond, one is a shadow's border: both edges are equally far
PENUMBRA_BLUR_PX = 1.0  # blur that any edge may have, px: below it the ratio of two blurs is noise
SHADOW_REACH = 0.45  # of the width, shadow included, how far inside of its border the shaft's edge is sought
CORE = (0.4, 0.6)  # from one edge to the other, where the shaft's own colour is looked at
BORDER_PX = 3.0  # to either side of a shadow's border, where its colour is looked at
BESIDE_PX = (6.0, 14.0)  # outside of it, where what is beside it is
LEAST_SHADOW_PX = 3.0  # between both edges: nearer, they are one
MIN_COLOUR = 0.08  # by which colours differ at least, in logarithms of ratios: 8 % of red over green
MIN_DARKER = 0.1  # logarithm of levels: 10 %
DARK_LEVEL = 4.0  # added to levels, so that the colour of black is grey
COLOUR_STD_PX = 2.0  # of a line by colours: images keep half of their resolution
SIDE = 6  # samples to either side of an edge, where brightness is compared
STARTS = 30  # points of which each two give a line to be tried


def edge_within(
    bgr: Image, outer: edges.EdgeLine, other: edges.EdgeLine, picture: Image | None, least_levels: float
) -> edges.EdgeLine | None:
    """The shaft's edge, where a side of a silhouette is that of its shadow; None where it is its own.

    Both edges of a shaft are equally far, and as sharp. Within the one that is less so there is a shadow, if what is
    there is darker than what is beside it, and has its ratios of red, green and blue (Gevers and Smeulders 1999), up to
    a line from which on they are the shaft's. Where the image has an edge of brightness along that line, too, it is
    sharper than the shadow's border; it must be there where that is hardly less sharp than the other side.
    """
    sharp_px, start_px, length_px = most_blur_px(other), outer.start_px, outer.length_px
    is_sharp, is_blurred = outer.covariance is None, outer.blur_px > sharp_px
    is_sharpest = is_sharp and PENUMBRA_RATIO * outer.blur_px <= sharp_px
    if is_sharpest or length_px < edges.MIN_POINTS * edges.SPACING_PX:
        return None
    along = outer.direction
    across = np.array([-along[1], along[0]])
    width_px = float(np.mean((np.stack([other.start_px, other.end_px]) - start_px) @ across))
    across, width_px = across * np.sign(width_px), abs(width_px)
    at = np.arange(0.5, length_px, max(edges.SPACING_PX, length_px / edges.MOST_PROFILES))
    offsets = np.arange(-BESIDE_PX[1], CORE[1] * width_px, edges.STEP_PX)

    def points(at: Array, off_px: Array) -> Array:
        return np.asarray(start_px + at[:, None] * along + off_px[:, None] * across)

    places = (start_px + at[:, None, None] * along + offsets[:, None] * across).astype(np.float32)
    maps = places[..., 0], places[..., 1]
    levels = cv2.remap(bgr, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
    logs = cv2.GaussianBlur(np.log(levels + DARK_LEVEL), (0, 0), edges.SLOPE_SIGMA_PX / edges.STEP_PX).astype(float)
    ratios = logs[..., ::2] - logs[..., 1:2]
    # From outside on, where the shaft's own colour is nearer.
    is_shaft = (_shares(ratios, offsets, width_px) < 0.5) & (offsets > 0.0) & (offsets < SHADOW_REACH * width_px)
    off_px = np.where(is_shaft.any(1), offsets[np.argmax(is_shaft, axis=1)] - 0.5 * edges.STEP_PX, np.nan)
    within_px = max(edges.STRAIGHT_PX, edges.STRAIGHT_WIDTHS * width_px)
    off_px = _without_stains(at, off_px, within_px)
    found = edges.ending_line(at, off_px, length_px, (within_px, edges.WINDOW * within_px))
    if found is None:
        return None
    (offset_px, slope, end_at), within_px = found
    shadow_px = offset_px + slope * at
    is_on = (np.abs(off_px - shadow_px) < within_px) & (at <= end_at)
    in_shadow = (offsets > BORDER_PX) & (offsets < (shadow_px - 0.5 * BORDER_PX)[:, None]) & is_on[:, None]
    if np.count_nonzero(is_on) < edges.MIN_POINTS or not in_shadow.any():
        return None
    green, is_beside = logs[..., 1], offsets < -BESIDE_PX[0]
    darker = median(green[is_on][:, is_beside].ravel()) - median(green[in_shadow])
    # The dark side of a shaft that reflects tissue is of another colour.
    beside, shadow = ratios[is_on][:, is_beside].reshape(-1, 2), ratios[in_shadow]
    changed = float(np.linalg.norm(np.median(shadow, axis=0) - np.median(beside, axis=0)))
    if median(shadow_px[is_on]) < LEAST_SHADOW_PX or darker < MIN_DARKER or changed > MIN_COLOUR:
        return None
    ends_at = np.array([0.0, end_at])
    rough = points(ends_at, offset_px + slope * ends_at)
    sharp = edges.edge_line(bgr, rough, width_px, COLOUR_STD_PX, picture, least_levels)
    if sharp is not None and sharp.blur_px <= (min(sharp_px, outer.blur_px) if is_sharp else sharp_px):
        ends = np.stack([sharp.start_px, sharp.end_px]) - start_px
        apart_px = ends @ across - offset_px - slope * (ends @ along)
        column = np.searchsorted(offsets, np.interp(at, ends @ along, ends @ across))
        sides = (column + off for off in (SIDE, -SIDE))
        inside, outside = (green[np.arange(len(at)), side.clip(0, len(offsets) - 1)] for side in sides)
        rise = median((inside - outside)[is_on])
        # Colours run into the dark: where the edge of brightness is outside of theirs, the shaft is the darker one.
        is_theirs = abs(apart_px.mean()) < COLOUR_STD_PX or apart_px.mean() * rise > 0.0
        if is_theirs and abs(apart_px[1] - apart_px[0]) < COLOUR_STD_PX * np.sqrt(2.0):
            return sharp
    seen_px, covariance = points(at, off_px)[is_on], COLOUR_STD_PX**2 * np.eye(2)
    by_colours = edges.EdgeLine(rough[0], rough[1], seen_px, False, within_px, covariance, COLOUR_STD_PX)
    # Where nothing is sharp there may be anything, and of a border as sharp as the other side colours alone say little.
    return by_colours if is_sharp and is_blurred else None


def most_blur_px(other: edges.EdgeLine) -> float:
    """The blur of an edge beyond which it is a shadow's border, by the shaft's other one."""
    return PENUMBRA_RATIO * max(PENUMBRA_BLUR_PX, other.blur_px if other.covariance is None else 0.0)


def _shares(ratios: Array, offsets: Array, width_px: float) -> Array:
    """How far colours are from the shaft's on the way to that at a shadow's border, (n, k); NaN where both are alike.

    `ratios`, (n, k, 2), are logarithms of blue and red over green at `offsets` (k,) from that border inward.
    """
    shaft = np.median(ratios[:, offsets >= min(CORE[0] * width_px, offsets[-1])], axis=(0, 1))
    border = np.median(ratios[:, np.abs(offsets) < BORDER_PX], axis=1)
    away = cv2.blur(border, (1, edges.NEIGHBOURS)) - shaft
    square = (away**2).sum(1, keepdims=True)
    return np.asarray(((ratios - shaft) @ away[..., None])[..., 0] / np.where(square > MIN_COLOUR**2, square, np.nan))


def _without_stains(at: Array, off_px: Array, within_px: float) -> Array:
    """Offsets of an edge, (n,), with NaN for those farther inward than the line that most of them allow.

    Blood on a shaft is of the tissue's colour, and so are its reflections: some points are too far inward, none too far
    outward.
    """
    some = np.flatnonzero(np.isfinite(off_px))[:: max(1, len(at) // STARTS)]
    first, second = (some[index] for index in np.triu_indices(len(some), max(1, len(some) // 4)))
    if not len(first):
        return off_px
    slope = (off_px[second] - off_px[first]) / (at[second] - at[first])
    inward_px = off_px - off_px[first, None] - slope[:, None] * (at - at[first, None])
    votes = (np.abs(inward_px) < within_px).sum(1) - (inward_px < -within_px).sum(1)
    return np.where(inward_px[int(np.argmax(votes))] < within_px, off_px, np.nan)

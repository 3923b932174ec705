"""A shaft's edge beside its own shadow: which of two edges is the shaft's, by brightness and colour."""

from __future__ import annotations

import numpy as np

from svmdist.least_squares import median
from svmdist.profile.settings import ShaftSettings
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.edge_lines import ROUGH_PX, WINDOW, EdgeLine, edge_line
from svmdist.vision.edges import RoughEdge, edge_blur_px, edge_points, slope_sigma_px
from svmdist.vision.shaft_segmentation import ShaftRegion

MIN_LINE_POINTS = 5  # of an edge: fewer lie on a line by chance
PENUMBRA_RATIO = 1.6  # of the edges' blurs; beyond, one is a shadow's border: both edges are equally far
PENUMBRA_BLUR_PX = 1.0  # blur that any edge may have, px: below it the ratio of two blurs is noise


def in_view(points_px: Array, region: ShaftRegion) -> Array:
    """The points, shape (n, 2), about which the endoscope shows something."""
    column, row = np.round(points_px).astype(np.intp).T
    return np.asarray(points_px[region.field_of_view[row, column] > 0])


# Of the region's width, shadow included, how far inside its border the shaft's edge is sought
SHADOW_REACH = 0.45
SHADOW_INLIER_PX, SHADOW_STD_PX = 0.7, 0.3  # a limb reflects what is around it, and fades or shines
MIN_EDGE_SHARE = 0.6  # of the profiles along a side that must show an edge there


def edge_before_shadow(
    brightness: Image,
    rough: RoughEdge,
    across: Array,
    region: ShaftRegion,
    settings: ShaftSettings,
    blur_px: float,
    *,
    is_brighter: bool = False,
) -> Array | None:
    """Points of the shaft's edge, shape (n, 2), where its own shadow lies beside it; None where none does.

    A lamp at the camera lights the shaft and not its shadow: going outward, brightness falls at the shaft's edge and
    rises at the shadow's, which is the edge of what is dark. Of a dark shaft the shadow may be the brighter one.
    """
    start_px, end_px, outward = rough
    to_bright = outward if is_brighter else -outward
    width_px = 2.0 * float(np.abs((region.middle_px - start_px) @ across))
    half_px = 0.5 * SHADOW_REACH * width_px
    inside = half_px + 1.5 * slope_sigma_px(blur_px)
    shifted = start_px - inside * across, end_px - inside * across, to_bright
    points_px = in_view(edge_points(brightness, shifted, half_px, settings, blur_px), region)
    length_px = float(np.linalg.norm(end_px - start_px))
    if len(points_px) < max(MIN_LINE_POINTS, MIN_EDGE_SHARE * length_px):
        return None
    # An edge is as sharp as the optics show the other one; a highlight on the shaft fades.
    off_px = median((points_px - start_px) @ across)
    at = start_px + off_px * across, end_px + off_px * across, to_bright
    fall_px = edge_blur_px(brightness, at, 4.0 + 2.0 * PENUMBRA_BLUR_PX, settings)
    if fall_px > PENUMBRA_RATIO * max(blur_px, PENUMBRA_BLUR_PX):
        return None
    return points_px


MIN_COLOUR = 0.08  # least difference of colours, in logarithms of ratios: 8 % of red over green
MAX_SHADOW = 0.5  # of the way from the shaft's colour to that beside it
INSIDE_PX, OUTSIDE_PX = (5.0, 9.0), (5.0, 14.0)  # strips beside an edge whose colours are compared


def is_of_shaft(
    bgr: Image, points_px: Array, across: Array, region: ShaftRegion, blur_px: float, inner_px: Array | None
) -> bool | None:
    """Whether what ends at points, (n, 2), is of the shaft's colour and not of that beside it; None of one colour.

    A shadow keeps the colour of what it falls on: ratios of red, green and blue (Gevers and Smeulders 1999). It is
    looked at between these points and `inner_px`, shape (k, 2), where the shaft may end before.
    """
    clear_px = 1.0 + blur_px
    inside = INSIDE_PX
    if inner_px is not None:
        gap_px = median(points_px @ across) - median(inner_px @ across)
        inside = clear_px, max(gap_px - clear_px, clear_px + 1.0)

    def colour(strip_px: tuple[float, float], sign: float) -> Array:
        return _median_colour(bgr, points_px[:, None] + sign * np.arange(*strip_px)[:, None] * across)

    first, second = region.first, region.second
    start_px, end_px = 0.5 * (first.start_px + second.start_px), 0.5 * (first.end_px + second.end_px)
    shaft = _median_colour(bgr, start_px + np.linspace(0.06, 0.94, 40)[:, None] * (end_px - start_px))
    away, beside = colour(OUTSIDE_PX, 1.0) - shaft, colour(inside, -1.0) - shaft
    square = float(away[:2] @ away[:2])
    # Without an edge between them a darker strip is the shaft's own limb.
    if square < MIN_COLOUR**2 or (inner_px is None and beside[2] < MIN_BRIGHTER):
        return None
    return bool(beside[:2] @ away[:2] < MAX_SHADOW * square)


MIN_BRIGHTER = 0.1  # logarithm of levels: 10 %
DARK_LEVEL = 4.0  # added to levels, so that the colour of black is grey


def _median_colour(bgr: Image, places_px: Array) -> Array:
    """Logarithms of red and blue over green, and of green, shape (3,): the median at pixels, shape (..., 2)."""
    column, row = np.round(places_px).reshape(-1, 2).astype(np.intp).T
    height, width = bgr.shape[:2]
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    if not inside.any():
        return np.zeros(3)
    blue, green, red = np.log(bgr[row[inside], column[inside]].astype(np.float64) + DARK_LEVEL).T
    return np.asarray(np.median([red - green, blue - green, green], axis=1))


CORE = np.array([0.4, 0.5, 0.6])  # from one edge to the other, where the shaft's own colour is looked at
WITHIN, BESIDE = np.array([0.35, 0.5, 0.65]), np.array([1.5, 2.0, 2.5])
"""From a shaft's edge to its shadow's, where the shadow is looked at, and what is beside it."""
LEAST_SHADOW_PX = 3.0  # between both edges: nearer, they are one


def edge_within(
    bgr: Image, outer: Array, blur_px: float, other: Array, other_blur_px: float, picture: Image | None
) -> EdgeLine | None:
    """The shaft's edge, where a side of a silhouette is that of its shadow; None where it is its own.

    Sides are (2, 2) in px from the border on; the blur of one without a sharp edge is infinite. Both edges of a shaft
    are equally far, and as sharp. The one that is less so is a shadow's, if there is a sharp edge within, and what lies
    between is darker than beside both, and not of the shaft's colour.
    """
    sharp_px = PENUMBRA_RATIO * max(PENUMBRA_BLUR_PX, other_blur_px if np.isfinite(other_blur_px) else 0.0)
    if blur_px <= sharp_px:
        return None
    along = (outer[1] - outer[0]) / max(float(np.linalg.norm(outer[1] - outer[0])), 1e-9)
    across = np.array([-along[1], along[0]])
    width_px = float(np.mean((other - outer[0]) @ across))
    across, width_px = across * np.sign(width_px), abs(width_px)
    reach_px = 0.5 * SHADOW_REACH * width_px
    inner = edge_line(bgr, outer + reach_px * across, width_px, reach_px / (WINDOW * ROUGH_PX), picture)
    if inner is None or inner.blur_px > sharp_px:
        return None
    feet_px = inner.start_px + np.linspace(0.1, 0.9, 24)[:, None] * (inner.end_px - inner.start_px)
    shadow_px, shaft_px = (feet_px - outer[0]) @ across, (other.mean(0) - feet_px) @ across
    if median(shadow_px) < LEAST_SHADOW_PX:
        return None

    def colour(shares: Array, of_px: Array) -> Array:
        return _median_colour(bgr, feet_px[:, None] + (shares * of_px[:, None])[..., None] * across)

    shaft, beside = colour(CORE, shaft_px), colour(-BESIDE, shadow_px)
    away, within = beside - shaft, colour(-WITHIN, shadow_px) - shaft
    square = float(away[:2] @ away[:2])
    is_of_shaft = square > MIN_COLOUR**2 and within[:2] @ away[:2] < MAX_SHADOW * square
    return None if is_of_shaft or away[2] - within[2] < MIN_BRIGHTER else inner

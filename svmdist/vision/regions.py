"""Regions of a mask: connected parts above an area gate, the completed outline of a smooth convex object, and discs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.least_squares import huber_weights, median, scale_of
from svmdist.profile.segmentation import AreaGate
from svmdist.profile.settings import OutlineSettings
from svmdist.samples import Image
from svmdist.transforms import Array, polygon_centroid

SPECK_FRACTION = 0.02  # of the largest part; specks of colour elsewhere would pull the convex hull
SAMPLE_STEP_PX = 2.0  # distance of the hull's samples; whole pixels resolve no finer ones
MAX_SAMPLE_COUNT = 480  # upper bound of the samples of one hull: longer hulls are sampled at a larger step
GAP_DISC = cv2.circle(np.zeros((5, 5), np.uint8), (2, 2), 2, 1, cv2.FILLED)
"""A sample of the hull further than 2 px from any visible pixel bridges a gap."""
STRAIGHT_LENGTH_PER_ROOT_PX = 4.5  # tested stretch c √R: a chord of a circle is c² / 8 = 2.5 px off its middle
STRAIGHT_WITHIN_PX = 0.8  # of the chord: flatter than a circle of three times the radius, so an instrument's edge
SHOULDER_SAMPLES = 4  # dropped on both sides of a hidden one: the corners of the cut lie there
HARMONICS = 6  # number of harmonics of the Fourier series r(θ)
HIDDEN_STD = 0.3  # of the hull's centroid over the radius, where the hull is used as it is
MAX_ITERATIONS = 8  # upper bound of the moves of the centre; one to three suffice on the golden logs
CORRELATION_SAMPLES = 3.0  # neighbouring samples with a common error: steps of a border in whole pixels
MASK_STD_PX = 0.3  # standard deviation of a mask's border: that of rounding to whole pixels, 1 / √12
OUTSIDE_DEVIATIONS = 3.0  # samples this many standard deviations outside the curve lose weight
INSIDE_DEVIATIONS = 2.0  # less than outside: what covers an object can only cut its outline short

DEFAULT = OutlineSettings()
CURVE_POINTS = 360
BORDER_PX = 3  # samples closer than this to the image's border may be cut by it
CENTRE_TOLERANCE_PX = 0.01


@dataclass(frozen=True, slots=True)
class CompletedOutline:
    """A whole outline in px: centroid (2,), covariance (2, 2), curve (n, 2); the hull's where too little is visible."""

    centroid_px: Array
    covariance_px2: Array
    curve_px: Array


def complete_outline(
    mask: NDArray[np.uint8], hull: NDArray[np.int32], settings: OutlineSettings = DEFAULT
) -> CompletedOutline:
    """Fit the outline of a partly hidden object to its mask (h, w) and hull; the image's border is no outline."""
    corners = hull.reshape(-1, 2).astype(np.float64)
    closed = np.concatenate([corners, corners[:1]])
    edges = closed[1:] - closed[:-1]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(edges[:, 0], edges[:, 1]))])
    count = int(min(max(along[-1] / SAMPLE_STEP_PX, 3), MAX_SAMPLE_COUNT))
    step_px = float(along[-1]) / count
    points_px = np.stack([np.interp(step_px * np.arange(count), along, values) for values in closed.T], -1)
    centroid_px = polygon_centroid(corners)
    radius_px = float(np.sqrt(cv2.contourArea(hull) / np.pi))
    visible = _is_outline(points_px, step_px, mask, radius_px)
    visible_count = np.count_nonzero(visible)
    if visible_count < 4 * HARMONICS + 2 or visible_count / len(points_px) < settings.min_visible_fraction:
        return CompletedOutline(centroid_px, (HIDDEN_STD * radius_px) ** 2 * np.eye(2), corners)
    return _fit(points_px[visible], centroid_px, step_px, settings)


def _is_outline(points_px: Array, step_px: float, mask: NDArray[np.uint8], radius_px: float) -> NDArray[np.bool_]:
    """Which points, shape (n,), of the hull lie at visible pixels, off straight edges and inside the image."""
    height, width = mask.shape
    column, row = np.rint(points_px.T).astype(np.intp)
    left, top = column.min(), row.min()  # all that matters lies inside the hull's bounding box
    near = cv2.dilate(mask[top : row.max() + 1, left : column.max() + 1], GAP_DISC)
    hidden = near[row - top, column - left] == 0
    hidden |= _is_straight(points_px, round(STRAIGHT_LENGTH_PER_ROOT_PX * np.sqrt(radius_px) / step_px))
    shoulder = min(SHOULDER_SAMPLES, (len(hidden) - 1) // 2)
    outline = ~_any_of(hidden, shoulder, shoulder) & (column >= BORDER_PX) & (column < width - BORDER_PX)
    return np.asarray(outline & (row >= BORDER_PX) & (row < height - BORDER_PX))


def _is_straight(points_px: Array, length: int) -> NDArray[np.bool_]:
    """Which points, shape (n,), of a closed curve lie on a stretch of `length` samples that stays at its chord."""
    count = len(points_px)
    if length < 3 or length >= count // 2:
        return np.zeros(count, np.bool_)
    x, y = np.concatenate([points_px, points_px[:length]]).T
    chord_x, chord_y = x[length:] - x[:count], y[length:] - y[:count]
    bound = STRAIGHT_WITHIN_PX * np.hypot(chord_x, chord_y)
    # Most stretches leave their chord in the middle; only those that do not are looked at in full.
    middle = slice(length // 2, length // 2 + count)
    off = chord_x * (y[middle] - y[:count]) - chord_y * (x[middle] - x[:count])
    start = np.flatnonzero(np.abs(off) < bound)
    within = start[:, None] + np.arange(1, length)
    along_x, along_y = x[within] - x[start, None], y[within] - y[start, None]
    off = chord_x[start, None] * along_y - chord_y[start, None] * along_x
    straight = np.zeros(count, np.bool_)
    straight[start] = (np.abs(off) < bound[start, None]).all(1)
    return _any_of(straight, length, 0)


def _any_of(flags: NDArray[np.bool_], before: int, after: int) -> NDArray[np.bool_]:
    """Whether any flag of a closed sequence, shape (n,), is set from `before` places before to `after` behind."""
    wrapped = np.concatenate([flags[len(flags) - before :], flags, flags[:after]])
    counts = np.concatenate([[0], np.cumsum(wrapped)])
    return np.asarray(counts[before + after + 1 :] > counts[: len(flags)])


def _fit(points_px: Array, centre_px: Array, step_px: float, settings: OutlineSettings) -> CompletedOutline:
    """Fit r(θ) about a centre, move the centre to the curve's centroid, and repeat until it rests."""
    x, y = np.ascontiguousarray(points_px.T)
    correlation = max(1.0, CORRELATION_SAMPLES * SAMPLE_STEP_PX / step_px)
    # Standard deviation of each coefficient over the radius; size and place are free.
    order = np.repeat(np.arange(1, HARMONICS + 1), 2)
    prior = np.append(1.0, np.where(order == 1, 1.0, settings.irregularity * (2.0 / order) ** 3))
    weight = np.ones(len(x))
    for _ in range(MAX_ITERATIONS):
        offset = (x - centre_px[0]) + 1j * (y - centre_px[1])
        radius_px = np.abs(offset)
        terms = _series(offset / radius_px)
        prior_information = np.diag((median(radius_px) * prior) ** -2.0)
        std_px = MASK_STD_PX
        for _ in range(2):  # the deviation and the weights follow from the residual, and it from them
            weighted = terms * (weight / (correlation * std_px**2))
            information = weighted @ terms.T
            coefficients = np.linalg.solve(information + prior_information, weighted @ radius_px)
            residual_px = radius_px - coefficients @ terms
            std_px = max(MASK_STD_PX, scale_of(residual_px))
            bound_px = np.where(residual_px < 0.0, INSIDE_DEVIATIONS * std_px, OUTSIDE_DEVIATIONS * std_px)
            weight = huber_weights(residual_px, bound_px) ** 2
        fitted_about_px = centre_px
        moved_px, J = _centroid(coefficients)
        centre_px = centre_px + moved_px
        if np.hypot(moved_px[0], moved_px[1]) < CENTRE_TOLERANCE_PX:
            break
    posterior = np.linalg.inv(information + prior_information)
    shift_px = np.zeros(len(coefficients))
    shift_px[:5] = settings.border_std_px / np.sqrt(3.0)
    follows = posterior @ information  # how the fit follows a shift of the visible border
    covariance = posterior + (follows * shift_px**2) @ follows.T
    on_curve = (coefficients @ CIRCLE_SERIES) * CIRCLE
    curve_px = np.stack([on_curve.real, on_curve.imag], -1) + fitted_about_px
    return CompletedOutline(centre_px, J @ covariance @ J.T, curve_px)


def _series(unit: NDArray[np.complex128]) -> Array:
    """The terms 1, cos θ, sin θ, cos 2θ, …, shape (2 HARMONICS + 1, n), of points e^(iθ), shape (n,)."""
    terms, power = np.ones((2 * HARMONICS + 1, len(unit))), unit
    for order in range(1, HARMONICS + 1):
        terms[2 * order - 1], terms[2 * order] = power.real, power.imag
        power = power * unit
    return terms


CIRCLE = np.exp(1j * np.linspace(-np.pi, np.pi, CURVE_POINTS, endpoint=False))
# As many corners of the curve as the mean of degree 3 HARMONICS + 1 needs, and the corner next to each
CORNERS = np.exp(2j * np.pi * np.arange(3 * HARMONICS + 2) / (3 * HARMONICS + 2))
NEXT_CORNERS = CORNERS * np.exp(2j * np.pi / CURVE_POINTS)
CIRCLE_SERIES, CORNER_SERIES, NEXT_SERIES = _series(CIRCLE), _series(CORNERS), _series(NEXT_CORNERS)


def _centroid(coefficients: Array) -> tuple[Array, Array]:
    """Centroid, shape (2,), of the polygon that the curve r(θ) is given as, and its Jacobian, shape (2, n).

    It is Σ r r' (r u + r' u') / (3 Σ r r') over neighbouring corners r u and r' u'. Both sums are of trigonometric
    polynomials, of degree 3 k + 1 where r has k harmonics, and have the same mean over a few corners as over all.
    """
    radius, next_radius = coefficients @ CORNER_SERIES, coefficients @ NEXT_SERIES
    product = radius * next_radius
    twice_area = product.sum()
    middle = radius * CORNERS + next_radius * NEXT_CORNERS
    centroid = (product @ middle) / (3.0 * twice_area)
    # Of d(product) and of d(middle), by the quotient rule.
    by_product = (middle / 3.0 - centroid) / twice_area
    third = product / (3.0 * twice_area)
    jacobian = CORNER_SERIES @ (next_radius * by_product + third * CORNERS)
    jacobian += NEXT_SERIES @ (radius * by_product + third * NEXT_CORNERS)
    return np.array([centroid.real, centroid.imag]), np.stack([jacobian.real, jacobian.imag])


@dataclass(frozen=True, slots=True)
class Region:
    """One segmented object: how many pixels it has, its centroid (2,), and the convex hull of its parts, (n, 1, 2)."""

    area_px: int
    centroid_px: Array
    hull: NDArray[np.int32]
    part_count: int


def find_region(mask: Image, rule: AreaGate, settings: OutlineSettings = DEFAULT) -> Region | None:
    """Find the region of a mask, shape (h, w), that passes the rule's area gate; None where there is none."""
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    # Of those whose box is large enough: specks may be thousands.
    large = [np.asarray(one, np.int32) for one in found if np.prod(cv2.boundingRect(one)[2:]) > rule.min_area_px]
    parts = [(one, cv2.countNonZero(_inside(mask, [one])[0])) for one in large]
    least_px = SPECK_FRACTION * max((area_px for _, area_px in parts), default=0)
    parts = [part for part in parts if part[1] > rule.min_area_px and part[1] >= least_px]
    if not parts:
        return None
    if rule.components == "largest":
        parts = [max(parts, key=lambda part: part[1])]
    contours = [contour for contour, _ in parts]
    hull = np.asarray(cv2.convexHull(np.concatenate(contours)), np.int32)
    if rule.occlusion == "outline":
        centroid_px = complete_outline(mask, hull, settings).centroid_px
    elif rule.occlusion == "hull":
        centroid_px = polygon_centroid(hull)
    else:  # mean of the coordinates of the parts' pixels: eqs. (1), (2)
        pixels, (x, y) = _inside(mask, contours)
        moments = cv2.moments(pixels, binaryImage=True)
        count = moments["m00"]
        centroid_px = np.array([moments["m10"] + x * count, moments["m01"] + y * count]) / count
    return Region(sum(area_px for _, area_px in parts), centroid_px, hull, len(parts))


def _inside(mask: Image, contours: Sequence[NDArray[np.int32]]) -> tuple[Image, tuple[int, int]]:
    """Pixels of a mask inside of contours, (n, 1, 2) each, in the box around these, and the box's first pixel."""
    x, y, width, height = cv2.boundingRect(np.concatenate(contours))
    inside = np.zeros((height, width), np.uint8)
    cv2.drawContours(inside, contours, -1, 255, cv2.FILLED, offset=(-x, -y))
    return inside & mask[y : y + height, x : x + width], (x, y)


MIN_CHROMA = 25.0  # levels between inside and outside below which there is no border to find
MIN_INLIER_FRACTION = 0.5  # of rays on the border's circle: with less the circle is a guess
INLIER_RADIUS = 0.06  # of the radius: what is farther off the circle is another thing's border
# Power of value in the strength of a colour: chroma (1) falls off with the light towards a limb, which makes discs up
# to 15% too small where the light is at the endoscope; saturation (0) is noise in the dark.
OF_LIGHT = 0.75
RAYS = 64
RAY_STEP_PX = 0.25
SLOPE_STEPS = 3  # to either side, over which a slope is taken
STEEP_PX = 2.5  # from the border, where the steepest place is sought
# Where the strength within and without is read, over the radius: clear of the border's blur
INSIDE, OUTSIDE = (0.4, 0.7), (1.25, 1.7)
BORDER_FROM = 0.6  # of the radius: the border is sought from here outward
DISC_STEPS, HUBER = 12, 1.5
INSIDE_STDS = 2.0  # at which a point inside of the circle counts a quarter
LEAST_SCATTER_PX = 0.25  # of the border: it is sampled no finer


@dataclass(frozen=True, slots=True)
class Disc:
    """Centre (2,) and radius in px, the deviation of the border's points from it, and the doubt where the border is.

    That is how far the place where half of the strength is left is from the steepest one: shade, haze, neighbours of
    like colour and blocks of a codec part them, and blur does not.
    """

    centre_px: Array
    radius_px: float
    scatter_px: float
    doubt_px: float


def fit_disc(image_hsv: Image, mask: Image, centre_px: Array, radius_px: float) -> Disc | None:
    """The disc near a rough one; None where its border is not to be found. `mask`, shape (h, w), has its colour."""
    half = int(np.ceil(2.0 * radius_px)) + 2
    x0, y0 = (np.floor(centre_px).astype(int) - half).tolist()
    near = np.s_[max(y0, 0) : y0 + 2 * half + 1, max(x0, 0) : x0 + 2 * half + 1]
    window, inside = image_hsv[near], mask[near] > 0
    if np.count_nonzero(inside) < 8:
        return None
    turns = window[..., 0][inside] * (np.pi / 90.0)
    hue = float(np.arctan2(np.sin(turns).mean(), np.cos(turns).mean()) * 90.0 / np.pi)
    # Colour along the hue: 0 for grey, negative for the opposite hue.
    hsv = window.astype(np.float32)
    angle = (hsv[..., 0] - hue) * np.float32(np.pi / 90.0)
    strength = (hsv[..., 1] * (hsv[..., 2] / 255.0) ** OF_LIGHT * np.cos(angle)).astype(np.float32)
    origin_px = np.maximum([float(x0), float(y0)], 0.0)
    centre_px = centre_px - origin_px
    angles = np.linspace(0.0, 2.0 * np.pi, RAYS, endpoint=False)
    directions = np.stack([np.cos(angles), np.sin(angles)], -1)
    reach_px = np.arange(0.0, OUTSIDE[1] * radius_px, RAY_STEP_PX)
    x, y = np.moveaxis((centre_px + reach_px[None, :, None] * directions[:, None, :]).astype(np.float32), 2, 0)
    values = cv2.remap(strength, x, y, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE).astype(np.float64)
    within = (reach_px >= INSIDE[0] * radius_px) & (reach_px <= INSIDE[1] * radius_px)
    # Along each ray: one side of a sphere is in shade.
    high = np.median(values[:, within], axis=1)
    low = np.median(values[:, reach_px >= OUTSIDE[0] * radius_px], axis=1)
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
    at = np.arange(len(reach_px))
    slope = values[:, np.maximum(at - SLOPE_STEPS, 0)] - values[:, np.minimum(at + SLOPE_STEPS, at[-1])]
    is_near = np.abs(reach_px - half_px[:, None]) <= STEEP_PX
    steepest_px = reach_px[np.argmax(np.where(is_near, slope, -np.inf), axis=1)]
    doubt_px = median(np.abs(steepest_px - half_px)[usable])
    return _circle(points_px, centre_px, max(blur_px, 0.0), doubt_px, origin_px)


def _crossing(values: Array, reach_px: Array, level: Array) -> Array:
    """Where each profile, shape (n, k), first falls below its level, shape (n,); NaN where it does not."""
    index = np.argmax(values < level[:, None], axis=1)
    rows = np.arange(len(values))
    before, after = values[rows, index - 1], values[rows, index]
    part = (before - level) / np.where(before > after, before - after, 1.0)
    return np.where(index > 0, reach_px[index - 1] + part * RAY_STEP_PX, np.nan)


def _circle(points_px: Array, centre_px: Array, blur_px: float, doubt_px: float, origin_px: Array) -> Disc | None:
    """The circle that points, shape (n, 2), bound, by Gauss-Newton with Huber's weights outside of it."""
    radius_px = median(np.linalg.norm(points_px - centre_px, axis=1))
    for _ in range(DISC_STEPS):
        offset = points_px - centre_px
        distance_px = np.linalg.norm(offset, axis=1)
        residual_px = distance_px - radius_px
        outside = residual_px > 0.0
        scale_px = max(scale_of(residual_px[outside]), LEAST_SCATTER_PX) if outside.any() else LEAST_SCATTER_PX
        # What hides a part of a disc has its own border inside of the disc's: the further inside, the less it counts.
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

"""The outline of a smooth convex object of which an instrument hides a part, and its centroid.

Where an instrument crosses the object, the convex hull of the visible part bridges the gap by a straight
edge; where it covers a side, its own straight edge becomes the hull's. Long straight edges are therefore
not the object's outline. The rest is: a closed curve r(θ) about its own centroid, a Fourier series of
few terms, is fitted to it and fills the gaps smoothly.

The series' coefficients are Gaussian before the fit, as large as outlines of organs have them, and the fit is their
posterior (Rasmussen and Williams 2006, sec. 2.1): where the outline is hidden, the prior's doubt stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.transforms import Array

SAMPLE_STEP_PX = 2.0
MAX_SAMPLES = 480
GAP_REACH_PX = 2.0
"""Points of the hull further than this from a visible pixel bridge a gap."""
STRAIGHT_PER_ROOT_RADIUS = 4.5
"""A chord of c √R over a circle of radius R stands c² / 8 = 2.5 px off its middle, whatever the radius: enough to
tell it from a straight edge, which whole pixels leave within one."""
STRAIGHT_WITHIN_PX = 0.8
"""A stretch of that length which stays this close to its chord is flatter than a circle of three times the radius."""
SHOULDER_SAMPLES = 4
"""Samples beside a gap are dropped too: corners of the cut lie there."""
HARMONICS = 6
IRREGULARITY = 0.2
"""Size of the second harmonic over the radius in what is met: an ellipse of 3:2. The k-th falls as 1 / k³, which
keeps the curvature's harmonics, k² times as large, falling too."""
MIN_VISIBLE_FRACTION = 0.25
"""With less of the outline than this the series would be invented; the hull is used as it is."""
ITERATIONS = 8
CORRELATION_SAMPLES = 3.0
"""Neighbouring samples of a border in whole pixels err alike as far as its steps reach."""
MASK_STD_PX = 0.3
"""Error of a mask's border: that of rounding to whole pixels, 1 / √12."""
BORDER_STD_PX = 0.3
"""A threshold cuts a blurred border, two pixels wide, anywhere in its middle half: up to half a pixel outside or
inside, and alike along a whole side, which is lit and stands out alike."""
OUTSIDE, INSIDE = 3.0, 2.0
"""Samples this many deviations from the curve lose weight. What covers an object can only cut its outline short,
so that a sample inside is doubted earlier."""
HIDDEN_SPREAD = 0.3
"""Standard deviation of the centroid over the radius where most of the outline is hidden."""


@dataclass(frozen=True, slots=True)
class CompletedOutline:
    """A whole outline: its centroid, shape (2,), with covariance (2, 2), and its curve, shape (n, 2), all in px.

    `visible_fraction` is the part of the hull that is outline; `fitted` is False where that is too little, and
    curve and centroid are those of the hull.
    """

    centroid_px: Array
    covariance_px2: Array
    curve_px: Array
    visible_fraction: float
    fitted: bool


def complete_outline(mask: NDArray[np.uint8], hull: NDArray[np.int32]) -> CompletedOutline:
    """Fit the outline that a partly hidden object has.

    `mask`, shape (h, w), holds the visible part; `hull`, shape (n, 1, 2), is its convex hull. Points at the
    image's border are no outline either: the object goes on there.
    """
    corners = hull.reshape(-1, 2).astype(np.float64)
    points_px, step_px = _sample(corners)
    centroid_px = polygon_centroid(corners)
    radius_px = float(np.sqrt(cv2.contourArea(hull) / np.pi))
    visible = _is_outline(points_px, step_px, mask, radius_px)
    fraction = float(np.count_nonzero(visible) / len(points_px))
    if np.count_nonzero(visible) < max(4 * HARMONICS + 2, MIN_VISIBLE_FRACTION * len(points_px)):
        # The hidden part may be anywhere within the hull's own size.
        spread_px = HIDDEN_SPREAD * radius_px
        return CompletedOutline(centroid_px, spread_px**2 * np.eye(2), corners, fraction, False)
    return _fit(points_px[visible], centroid_px, step_px, fraction)


def _sample(corners: Array) -> tuple[Array, float]:
    """Points along a closed polygon, shape (n, 2), and the step between them in px."""
    closed = np.vstack([corners, corners[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    count = int(np.clip(along[-1] / SAMPLE_STEP_PX, 3, MAX_SAMPLES))
    at = np.linspace(0.0, along[-1], count, endpoint=False)
    points = np.stack([np.interp(at, along, closed[:, 0]), np.interp(at, along, closed[:, 1])], -1)
    return points, float(along[-1]) / count


def _is_outline(
    points_px: Array,
    step_px: float,
    mask: NDArray[np.uint8],
    radius_px: float,
) -> NDArray[np.bool_]:
    height, width = mask.shape
    column, row = np.round(points_px).astype(np.intp).T
    left, top = column.min(), row.min()  # all that matters lies inside the hull's bounding box
    window = (slice(top, row.max() + 1), slice(left, column.max() + 1))
    distance_px = cv2.distanceTransform(cv2.bitwise_not(mask[window]), cv2.DIST_L2, 5)
    hidden = np.asarray(distance_px[row - top, column - left] > GAP_REACH_PX)
    hidden |= _is_straight(points_px, round(STRAIGHT_PER_ROOT_RADIUS * np.sqrt(radius_px) / step_px))
    beside = [np.roll(hidden, shift) for shift in range(-SHOULDER_SAMPLES, SHOULDER_SAMPLES + 1)]
    hidden = np.any(beside, axis=0)
    inside = (column > 2) & (column < width - 3) & (row > 2) & (row < height - 3)
    return np.asarray(~hidden & inside)


def _is_straight(points_px: Array, length: int) -> NDArray[np.bool_]:
    """Which points, shape (n,), of a closed curve lie on a stretch of `length` samples that stays at its chord."""
    count = len(points_px)
    straight = np.zeros(count, np.bool_)
    if length < 3 or length >= count // 2:
        return straight
    stretch = points_px[(np.arange(count)[:, None] + np.arange(length + 1)) % count]
    chord = stretch[:, -1] - stretch[:, 0]
    across = np.stack([-chord[:, 1], chord[:, 0]], -1) / np.linalg.norm(chord, axis=1)[:, None]
    off_px = np.einsum("nkj,nj->nk", stretch - stretch[:, :1], across)
    for start in np.flatnonzero(np.abs(off_px).max(1) < STRAIGHT_WITHIN_PX):
        straight[(start + np.arange(length + 1)) % count] = True
    return straight


def _fit(points_px: Array, start_px: Array, step_px: float, visible_fraction: float) -> CompletedOutline:
    """Fit r(θ) about a centre, move the centre to the curve's centroid, and repeat until it rests."""
    centre_px = start_px
    angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    series = _series(angles)
    alike = max(1.0, CORRELATION_SAMPLES * SAMPLE_STEP_PX / step_px)
    weight = np.ones(len(points_px))
    for _ in range(ITERATIONS):
        offset = points_px - centre_px
        A = _series(np.arctan2(offset[:, 1], offset[:, 0]))
        radius_px = np.hypot(offset[:, 0], offset[:, 1])
        prior_std_px = _prior_std(float(np.median(radius_px)))
        std_px = MASK_STD_PX
        for _ in range(2):  # the deviation and the weights follow from the residual, and it from them
            information = A.T @ (weight[:, None] * A) / (alike * std_px**2)
            posterior = np.linalg.inv(information + np.diag(prior_std_px**-2.0))
            coefficients = posterior @ (A.T @ (weight * radius_px)) / (alike * std_px**2)
            residual_px = radius_px - A @ coefficients
            std_px = max(MASK_STD_PX, 1.4826 * float(np.median(np.abs(residual_px))))
            bound_px = np.where(residual_px < 0.0, INSIDE, OUTSIDE) * std_px
            weight = np.minimum(1.0, (bound_px / np.maximum(np.abs(residual_px), 1e-9)) ** 2)
        curve_px = _curve(centre_px, angles, series @ coefficients)
        moved_px = polygon_centroid(curve_px)
        rests = np.linalg.norm(moved_px - centre_px) < 0.01
        centre_px = moved_px
        if rests:
            break
    shift_px = np.concatenate([np.full(5, BORDER_STD_PX / np.sqrt(3.0)), np.zeros(2 * HARMONICS - 4)])
    follows = posterior @ information  # how the fit follows a shift of the visible border
    covariance = posterior + follows @ np.diag(shift_px**2) @ follows.T
    # How the centroid answers to each coefficient, about the curve as fitted.
    fitted_px = polygon_centroid(_curve(np.zeros(2), angles, series @ coefficients))
    steps = [
        polygon_centroid(_curve(np.zeros(2), angles, series @ (coefficients + unit))) - fitted_px
        for unit in np.eye(len(coefficients))
    ]
    J = np.stack(steps, -1)
    return CompletedOutline(centre_px, J @ covariance @ J.T, curve_px, visible_fraction, True)


def _prior_std(radius_px: float) -> Array:
    """Standard deviation of each coefficient in px, shape (2 HARMONICS + 1,); size and place are free."""
    order = np.repeat(np.arange(1, HARMONICS + 1), 2)
    return radius_px * np.concatenate([[1.0], np.where(order == 1, 1.0, IRREGULARITY * (2.0 / order) ** 3)])


def _curve(centre_px: Array, angles: Array, radius_px: Array) -> Array:
    return np.asarray(centre_px + radius_px[:, None] * np.stack([np.cos(angles), np.sin(angles)], -1))


def _series(angles: Array) -> Array:
    """The terms 1, cos θ, sin θ, cos 2θ, …, shape (n, 2 HARMONICS + 1)."""
    terms = [np.ones_like(angles)]
    for k in range(1, HARMONICS + 1):
        terms += [np.cos(k * angles), np.sin(k * angles)]
    return np.stack(terms, -1)


def polygon_centroid(polygon: NDArray[np.generic]) -> Array:
    """Centroid of the area inside a polygon, (n, 2) or OpenCV's (n, 1, 2); without area, its corners' mean."""
    moments = cv2.moments(polygon.astype(np.float32))
    if moments["m00"] <= 0:
        return np.asarray(polygon.reshape(-1, 2).mean(0), np.float64)
    return np.array([moments["m10"], moments["m01"]]) / moments["m00"]


def completed_centroid(mask: NDArray[np.uint8], hull: NDArray[np.int32]) -> Array:
    """Centroid, shape (2,) in px, of the outline that a partly hidden object has; see `complete_outline`."""
    return complete_outline(mask, hull).centroid_px

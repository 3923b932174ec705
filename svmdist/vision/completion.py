"""The outline of a smooth convex object of which an instrument hides a part, and its centroid.

Where an instrument crosses the object, the convex hull of the visible part bridges the gap by a straight
edge; where it covers a side, its own straight edge becomes the hull's. Long straight edges are therefore
not the object's outline. The rest is: a closed curve r(θ) about its own centroid, a Fourier series of
few terms, is fitted to it by regularised least squares and fills the gaps smoothly.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.transforms import Array

SAMPLE_STEP_PX = 2.0
GAP_REACH_PX = 2.0
"""Points of the hull further than this from a visible pixel bridge a gap."""
STRAIGHT_FRACTION = 0.12
"""A hull edge longer than this fraction of the square root of the hull's area is too straight to be outline.
A circle's arc of that length turns by 12°, and digitised it breaks into edges a quarter as long."""
SHOULDER_SAMPLES = 4
"""Samples beside a gap are dropped too: corners of the cut lie there."""
HARMONICS = 4
SMOOTHING = 0.1
"""Weight of k⁴ times the squared k-th coefficient. Visible points, two pixels apart, outweigh it wherever there
are any; in a gap it keeps the series from swinging."""
MIN_VISIBLE_FRACTION = 0.25
"""With less of the outline than this the series would be invented; the hull is used as it is."""
ITERATIONS = 6
CORRELATION_SAMPLES = 8.0
"""Neighbouring samples err alike: what four harmonics leave of a smooth outline turns over after an eighth of it."""
MASK_STD_PX = 0.3
"""Error of a mask's border beside the fit's residual: that of rounding to whole pixels."""
IRREGULARITY = 0.2
"""Size of the second harmonic over the radius in what is met, an ellipse of 3:2; the k-th falls as 1/k²."""
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


def completed_centroid(mask: NDArray[np.uint8], hull: NDArray[np.int32]) -> Array:
    """Centroid, shape (2,) in px, of the outline that a partly hidden object has; see `complete_outline`."""
    return complete_outline(mask, hull).centroid_px


def complete_outline(mask: NDArray[np.uint8], hull: NDArray[np.int32]) -> CompletedOutline:
    """Fit the outline that a partly hidden object has.

    `mask`, shape (h, w), holds the visible part; `hull`, shape (n, 1, 2), is its convex hull. Points at the
    image's border are no outline either: the object goes on there.
    """
    corners = hull.reshape(-1, 2).astype(np.float64)
    points_px, edge_length_px = _sample(corners)
    centroid_px = polygon_centroid(corners)
    visible = _is_outline(points_px, edge_length_px, mask, float(cv2.contourArea(hull)))
    fraction = float(np.count_nonzero(visible) / len(points_px))
    if np.count_nonzero(visible) < max(4 * HARMONICS + 2, MIN_VISIBLE_FRACTION * len(points_px)):
        # The hidden part may be anywhere within the hull's own size.
        spread_px = HIDDEN_SPREAD * np.sqrt(cv2.contourArea(hull) / np.pi)
        return CompletedOutline(centroid_px, spread_px**2 * np.eye(2), corners, fraction, False)
    return _fit(points_px[visible], centroid_px, fraction)


def _sample(corners: Array) -> tuple[Array, Array]:
    """Points along a closed polygon, shape (n, 2), and the length of the edge that each lies on, shape (n,)."""
    closed = np.vstack([corners, corners[:1]])
    lengths = np.linalg.norm(np.diff(closed, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    at = np.arange(0.0, along[-1], SAMPLE_STEP_PX)
    edge = np.clip(np.searchsorted(along, at, side="right") - 1, 0, len(lengths) - 1)
    points = np.stack([np.interp(at, along, closed[:, 0]), np.interp(at, along, closed[:, 1])], -1)
    return points, lengths[edge]


def _is_outline(
    points_px: Array, edge_length_px: Array, mask: NDArray[np.uint8], hull_area_px2: float
) -> NDArray[np.bool_]:
    height, width = mask.shape
    column, row = np.round(points_px).astype(np.intp).T
    left, top = column.min(), row.min()  # all that matters lies inside the hull's bounding box
    window = mask[top : row.max() + 1, left : column.max() + 1]
    distance_px = cv2.distanceTransform(cv2.bitwise_not(window), cv2.DIST_L2, 5)
    real = np.asarray(distance_px[row - top, column - left] <= GAP_REACH_PX)
    real &= edge_length_px <= STRAIGHT_FRACTION * np.sqrt(hull_area_px2)
    hidden = ~real
    for shift in range(1, SHOULDER_SAMPLES + 1):
        hidden = hidden | np.roll(~real, shift) | np.roll(~real, -shift)
    inside = (column > 2) & (column < width - 3) & (row > 2) & (row < height - 3)
    return np.asarray(~hidden & inside)


def _fit(points_px: Array, start_px: Array, visible_fraction: float) -> CompletedOutline:
    """Fit r(θ) about a centre, move the centre to the curve's centroid, and repeat until it rests."""
    centre_px = start_px
    order = np.arange(1, HARMONICS + 1)
    penalty = np.diag(np.concatenate([[0.0], np.repeat(SMOOTHING * order**4, 2)]))
    angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    series = _series(angles)
    for _ in range(ITERATIONS):
        offset = points_px - centre_px
        A = _series(np.arctan2(offset[:, 1], offset[:, 0]))
        radius_px = np.hypot(offset[:, 0], offset[:, 1])
        coefficients = np.asarray(np.linalg.solve(A.T @ A + penalty, A.T @ radius_px), np.float64)
        curve_px = _curve(centre_px, angles, series @ coefficients)
        moved_px = polygon_centroid(curve_px)
        rests = np.linalg.norm(moved_px - centre_px) < 0.01
        centre_px = moved_px
        if rests:
            break
    residual_px = np.asarray(radius_px - A @ coefficients, np.float64)
    covariance = _coefficient_covariance(A, penalty, coefficients, residual_px)
    # How the centroid answers to each coefficient, about the curve as fitted.
    fitted_px = polygon_centroid(_curve(np.zeros(2), angles, series @ coefficients))
    steps = [
        polygon_centroid(_curve(np.zeros(2), angles, series @ (coefficients + unit))) - fitted_px
        for unit in np.eye(len(coefficients))
    ]
    J = np.stack(steps, -1)
    return CompletedOutline(centre_px, J @ covariance @ J.T, curve_px, visible_fraction, True)


def _coefficient_covariance(A: Array, penalty: Array, coefficients: Array, residual_px: Array) -> Array:
    """Covariance of coefficients ĉ = M⁻¹ Aᵀ r with M = AᵀA + P: ĉ - c = M⁻¹ (Aᵀ ε - P c).

    The first term is the samples' error ε: what the series cannot follow, alike along CORRELATION_SAMPLES
    neighbours. The second is the pull of the regularisation towards a circle, which counts in the gaps;
    there the true coefficients are not known, and each may be of the size that a smooth shape allows.
    """
    M_inverse = np.linalg.inv(A.T @ A + penalty)
    error2 = float(residual_px @ residual_px) / max(len(residual_px) - len(coefficients), 1) + MASK_STD_PX**2
    sampled = CORRELATION_SAMPLES * error2 * (M_inverse @ A.T @ A @ M_inverse)
    order = np.repeat(np.arange(1, HARMONICS + 1), 2)
    prior_px = np.concatenate([[0.0], IRREGULARITY * coefficients[0] / order**2])
    pull = M_inverse @ penalty
    return np.asarray(sampled + pull @ np.diag(prior_px**2) @ pull.T)


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

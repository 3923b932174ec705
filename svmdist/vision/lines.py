"""The straight line through points of an edge that err alike over some length, and some of which are wrong."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.least_squares import huber_weights, scale_of
from svmdist.profile.settings import ShaftSettings
from svmdist.transforms import Array

DEFAULT = ShaftSettings()
HUBER = 1.5
"""Deviations beyond which a point counts singly, at 95 % efficiency on normal errors about 1.35 (Huber 1964)."""
FIT_STEPS, TRIALS, SEED = 6, 120, 7


@dataclass(frozen=True, slots=True)
class Line:
    """The points with `normal` · p = `offset`, in the unit of the points that were fitted.

    `normal` (2,) has length 1; `covariance` (2, 2) belongs to (turn in rad about `centre`, shift along the
    normal); `centre` (2,) is the points' middle, and `count` how many there were.
    """

    normal: Array
    offset: float
    centre: Array
    covariance: Array
    count: int

    @property
    def direction(self) -> Array:
        """Unit vector along the line, the normal turned by a quarter turn, shape (2,)."""
        return np.array([-self.normal[1], self.normal[0]])


def undistorted(camera: Camera, points_px: Array) -> Array:
    """Points, shape (n, 2) in px, on the plane z = 1 of the camera frame, without distortion."""
    if len(points_px) == 0:
        return np.zeros((0, 2))
    if not np.any(camera.D):
        (fx, skew, cx), (_, fy, cy), _ = camera.K
        y = (points_px[:, 1] - cy) / fy
        return np.stack([(points_px[:, 0] - cx - skew * y) / fx, y], -1)
    criteria = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 60, 1e-12)
    points = cv2.undistortPoints(
        np.ascontiguousarray(points_px, np.float64).reshape(-1, 1, 2),
        camera.K,
        camera.D,
        None,
        None,
        None,
        criteria,
    )
    return np.asarray(points, np.float64).reshape(-1, 2)


def fit_line(
    points: Array,
    unit: float,
    min_count: int = 8,
    inlier_px: float = 1.0,
    systematic_px: float = 0.0,
    correlation_px: float = DEFAULT.point_correlation_px,
    min_point_std_px: float = DEFAULT.min_point_std_px,
) -> Line | None:
    """The line through most of the points, shape (n, 2): RANSAC, then total least squares with Huber's weights.

    `unit` is the size of a pixel in the unit of the points. None where fewer than `min_count` points agree
    within `inlier_px`, or less than half of them. `systematic_px` is an error that the points share: it shifts
    the line, and may shift its two ends differently. Points closer than `correlation_px` err alike; none errs less
    than `min_point_std_px`.
    """
    chosen = _consensus(points, inlier_px * unit)
    if np.count_nonzero(chosen) < max(min_count, len(points) // 2):
        return None
    points = points[chosen]
    weight = np.ones(len(points))
    floor = min_point_std_px * unit
    for _ in range(FIT_STEPS):
        centre = weight @ points / weight.sum()
        direction = _main_direction(points - centre, weight)
        normal = np.array([-direction[1], direction[0]])
        residual = (points - centre) @ normal
        scale = max(scale_of(residual), floor)
        weight = huber_weights(residual, HUBER * scale)
    position = (points - centre) @ direction
    # Points err alike over the correlation length: as if there were fewer of them.
    spacing = np.ptp(position) / unit / max(len(points) - 1, 1)
    alike = max(1.0, correlation_px / max(spacing, 1e-6))
    variance = scale**2 * alike
    shared = (systematic_px * unit) ** 2
    turn = (variance / weight.sum() + shared) / max(float(weight @ position**2 / weight.sum()), 1e-30)
    shift = variance / weight.sum() + shared
    return Line(
        normal,
        float(normal @ centre),
        centre,
        np.diag([turn, shift]),
        len(points),
    )


def _main_direction(offsets: Array, weight: Array) -> Array:
    """The unit vector (2,) along which weighted points about their centre, shape (n, 2), scatter most."""
    x, y = offsets.T
    twice = np.arctan2(2.0 * (weight * x) @ y, (weight * x) @ x - (weight * y) @ y)
    return np.array([np.cos(0.5 * twice), np.sin(0.5 * twice)])


def _consensus(points: Array, tolerance: float) -> NDArray[np.bool_]:
    """The largest set of points, shape (n,), that lie within a tolerance of a line through two of them."""
    count = len(points)
    if count < 2:
        return np.zeros(count, np.bool_)
    first, second = _trials(count)
    along = points[second] - points[first]
    length = np.hypot(along[:, 0], along[:, 1])
    usable = length > 0
    if not usable.any():
        return np.zeros(count, np.bool_)
    across = np.stack([-along[:, 1], along[:, 0]], -1)[usable] / length[usable, None]
    distance = np.abs(across @ points.T - np.sum(across * points[first][usable], 1)[:, None])
    close = distance <= tolerance
    return np.asarray(close[np.argmax(np.count_nonzero(close, axis=1))])


@lru_cache(maxsize=1024)
def _trials(count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs of different points among so many, the same whenever they are drawn."""
    rng = np.random.default_rng(SEED)
    first = rng.integers(0, count, TRIALS)
    return first, (first + rng.integers(1, count, TRIALS)) % count

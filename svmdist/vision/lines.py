"""Lines through points of an edge, and what the outlines of a cylinder and of a sphere say of them in space."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.least_squares import huber_weights, scale_of
from svmdist.transforms import Array, cross, skew

# Neighbouring edge points share pixels: points closer than this along the edge err alike
POINT_CORRELATION_PX = 2.0
MIN_POINT_STD_PX = 0.05  # what pixel grid and interpolation leave even without noise

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
    points = np.ascontiguousarray(points_px, np.float64).reshape(-1, 1, 2)
    points = np.asarray(
        cv2.undistortPoints(points, camera.K, camera.D, None, None, None, criteria), np.float64
    )
    return points.reshape(-1, 2)


def fit_line(
    points: Array,
    unit: float,
    min_count: int = 8,
    inlier_px: float = 1.0,
    systematic_px: float = 0.0,
    correlation_px: float = POINT_CORRELATION_PX,
) -> Line | None:
    """The line through most of the points, shape (n, 2): RANSAC, then total least squares with Huber's weights.

    `unit` is the size of a pixel in the unit of the points. None where fewer than `min_count` points agree
    within `inlier_px`, or less than half of them. `systematic_px` is an error that the points share: it shifts
    the line, and may shift its two ends differently. Points closer than `correlation_px` err alike.
    """
    chosen = _consensus(points, inlier_px * unit)
    if np.count_nonzero(chosen) < max(min_count, len(points) // 2):
        return None
    points = points[chosen]
    weight = np.ones(len(points))
    floor = MIN_POINT_STD_PX * unit
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
    return Line(normal, float(normal @ centre), centre, np.diag([turn, shift]), len(points))


def _main_direction(offsets: Array, weight: Array) -> Array:
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


# Of the angle between the two planes: a radius below 0.25 % of the distance has no measurable width
MIN_SINE = 5e-3


@dataclass(frozen=True, slots=True)
class TangentPlane:
    """A plane through the camera's centre that touches the cylinder: unit normal (3,), covariance (3, 3)."""

    normal: Array
    covariance: Array

    @property
    def whitening(self) -> Array:
        """The matrix, shape (2, 3), that makes of a small error of the normal two numbers of variance one."""
        variance, axes = np.linalg.eigh(self.covariance)
        return np.asarray((axes[:, 1:] / np.sqrt(variance[1:])).T)


@dataclass(frozen=True, slots=True)
class CylinderAxis:
    """The axis: point nearest to the camera's centre (3,) in m, unit direction (3,), and covariance (6, 6) of both."""

    point_m: Array
    direction: Array
    covariance: Array


def tangent_plane(line: Line, inside: Array) -> TangentPlane:
    """The plane of a line on z = 1 of the camera frame; `inside`, (2,), is a point on the cylinder's side."""
    a, b = line.normal
    raw = np.array([a, b, -line.offset])
    # Turn about the centre c by τ, shift by s: normal + τ t, offset + τ t · c + s with t along the line.
    t = line.direction
    d_raw = np.array([[t[0], 0.0], [t[1], 0.0], [-float(t @ line.centre), -1.0]])
    if raw @ np.array([inside[0], inside[1], 1.0]) < 0.0:
        raw, d_raw = -raw, -d_raw
    length = float(np.linalg.norm(raw))
    normal = raw / length
    J = (np.eye(3) - np.outer(normal, normal)) @ d_raw / length
    return TangentPlane(normal, np.asarray(J @ line.covariance @ J.T))


def axis_of_cylinder(first: TangentPlane, second: TangentPlane, radius_m: float) -> CylinderAxis | None:
    """The axis of a cylinder of known radius between two planes; None where the planes nearly coincide."""
    n1, n2 = first.normal, second.normal
    across = cross(n1, n2)
    sine, cosine = float(np.linalg.norm(across)), float(n1 @ n2)
    if sine < MIN_SINE:
        return None
    d = across / sine
    p = radius_m * (n1 + n2) / (1.0 + cosine)
    into_d = (np.eye(3) - np.outer(d, d)) / sine
    J1 = np.vstack([(radius_m * np.eye(3) - np.outer(p, n2)) / (1.0 + cosine), into_d @ -skew(n2)])
    J2 = np.vstack([(radius_m * np.eye(3) - np.outer(p, n1)) / (1.0 + cosine), into_d @ skew(n1)])
    covariance = J1 @ first.covariance @ J1.T + J2 @ second.covariance @ J2.T
    return CylinderAxis(p, d, covariance)


def tangent_normal(point_m: Array, direction: Array, radius_m: float, side: int) -> Array:
    """Unit normals, shape (..., 3), of the planes that touch cylinders: the inverse of `axis_of_cylinder`.

    `point_m` (..., 3) is any point of the axis. `side` is +1 for the plane to the right of the axis as it runs
    through the image, y being down, and -1 for the left. Where the camera is inside the cylinder there is none: NaN.
    """
    foot = point_m - direction * np.sum(point_m * direction, -1, keepdims=True)
    distance_m = np.sqrt(np.sum(foot * foot, -1, keepdims=True))
    sine = radius_m / np.where(distance_m > radius_m, distance_m, np.nan)
    towards, left = foot / distance_m, cross(direction, foot) / distance_m
    return np.asarray(sine * towards + side * np.sqrt(1.0 - sine**2) * left)


def tangent_normal_with_derivatives(
    point_m: Array, direction: Array, radius_m: float, side: int
) -> tuple[Array, Array, Array]:
    """`tangent_normal` of one cylinder, (3,), and its derivatives by the point and by the direction, (3, 3) each.

    The normal obeys n · n = 1, n · d = 0 and n · p = r. With e = n x d the differentials of these give
    dn = -(n · dd) d + e ((n · dd) (d · p) - n · dp) / (e · p).
    """
    normal = tangent_normal(point_m, direction, radius_m, side)
    e = cross(normal, direction)
    beside = e / float(e @ point_m)
    by_direction = np.outer(float(direction @ point_m) * beside - direction, normal)
    return normal, -np.outer(beside, normal), by_direction


def apparent_radius_px(centre_m: Array, radius_m: float, camera: Camera) -> Array:
    """Radius of the disc as large as a small sphere's image: f r / z, and 1 / cos θ longer away from the axis."""
    z_m = centre_m[..., 2]
    stretch = np.sqrt(np.linalg.norm(centre_m, axis=-1) / np.abs(z_m))
    return np.asarray(camera.K[0, 0] * radius_m / z_m * stretch)


def without_perspective(middle_px: Array, camera: Camera, depth_m: float, radius_m: float) -> Array:
    """The pixel (2,) of a sphere's centre from the middle of its outline.

    The tangents to a sphere at (X, 0, Z) meet z = 1 about X Z / (Z² - r²), not about X / Z.
    """
    if depth_m <= radius_m:
        return middle_px
    aside = (radius_m / depth_m) ** 2
    return middle_px - aside * (middle_px - camera.K[:2, 2])

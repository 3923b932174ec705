"""Lines through points of an edge, and what the outlines of a cylinder and of a sphere say of them in space."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from svmdist.camera import Camera
from svmdist.least_squares import huber_weights, scale_of
from svmdist.transforms import Array, cross, skew

POINT_CORRELATION_PX = 2.0  # neighbouring edge points share pixels: those closer along the edge err alike
MIN_POINT_STD_PX = 0.05  # what pixel grid and interpolation leave even without noise
HUBER = 1.5  # deviations beyond which a point counts singly; 95 % efficient at about 1.35 (Huber 1964)
FIT_STEPS, TRIALS, SEED = 6, 120, 7


@dataclass(frozen=True, slots=True)
class TangentPlane:
    """A plane through the camera's centre that touches the cylinder: unit normal (3,), covariance (3, 3).

    `side` is +1 to the right of the axis as it runs through the image, y being down, -1 to the left, 0 if unknown.
    """

    normal: Array
    covariance: Array
    side: int = 0


def fit_line(
    points: Array, unit: float, inside: Array, min_count: int, inlier_px: float, systematic_px: float
) -> TangentPlane | None:
    """The plane of the line through most of the points, (n, 2): RANSAC, then total least squares by Huber's weights.

    Points are on z = 1 of the camera frame, `inside` (2,) is one on the cylinder's side, and `unit` is the size of a
    pixel there. None where fewer than `min_count` points agree within `inlier_px`, or less than half of them.
    `systematic_px` is an error that the points share, at each end of the line another.
    """
    # The largest set within a tolerance of a line through two of them: pairs that differ, the same in every call.
    count, rng = len(points), np.random.default_rng(SEED)
    first = rng.integers(0, count, TRIALS)
    second = (first + rng.integers(1, count, TRIALS)) % count
    along = points[second] - points[first]
    across = np.stack([-along[:, 1], along[:, 0]], -1) / np.hypot(along[:, 0], along[:, 1])[:, None]
    off = np.abs(across @ points.T - np.sum(across * points[first], 1)[:, None])
    close = off <= inlier_px * unit
    chosen = close[np.argmax(np.count_nonzero(close, axis=1))]
    if np.count_nonzero(chosen) < max(min_count, len(points) // 2):
        return None
    points = points[chosen]
    weight = np.ones(len(points))
    floor = MIN_POINT_STD_PX * unit
    for _ in range(FIT_STEPS):
        centre = weight @ points / weight.sum()
        x, y = (points - centre).T
        angle = 0.5 * np.arctan2(2.0 * (weight * x) @ y, (weight * x) @ x - (weight * y) @ y)
        direction = np.array([np.cos(angle), np.sin(angle)])
        normal = np.array([-direction[1], direction[0]])
        residual = (points - centre) @ normal
        scale = max(scale_of(residual), floor)
        weight = huber_weights(residual, HUBER * scale)
    position = (points - centre) @ direction
    # Points err alike over the correlation length: as if there were fewer of them.
    spacing = np.ptp(position) / unit / max(len(points) - 1, 1)
    alike = max(1.0, POINT_CORRELATION_PX / max(spacing, 1e-6))
    shift = scale**2 * alike / weight.sum() + (systematic_px * unit) ** 2
    turn = shift / max(float(weight @ position**2 / weight.sum()), 1e-30)
    return _tangent_plane(normal, float(normal @ centre), centre, np.diag([turn, shift]), inside)


def line_between(ends: Array, covariance: Array, inside: Array) -> TangentPlane:
    """The plane of the line through two points, (2, 2), by the covariance (2, 2) of their offsets, as `fit_line`."""
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    normal = np.array([-along[1], along[0]]) / length
    J = np.array([[-1.0 / length, 1.0 / length], [0.5, 0.5]])  # turn and shift by both offsets
    return _tangent_plane(normal, float(normal @ ends[0]), ends.mean(axis=0), J @ covariance @ J.T, inside)


def _tangent_plane(normal: Array, offset: float, centre: Array, covariance: Array, inside: Array) -> TangentPlane:
    """The plane of the line on z = 1 with `normal` · p = `offset`, by the covariance of turn and shift at `centre`."""
    raw = np.array([normal[0], normal[1], -offset])
    # Turn about the centre c by τ, shift by s: normal + τ t, offset + τ t · c + s with t along the line.
    t = np.array([-normal[1], normal[0]])
    d_raw = np.array([[t[0], 0.0], [t[1], 0.0], [-float(t @ centre), -1.0]])
    if raw @ np.array([inside[0], inside[1], 1.0]) < 0.0:
        raw, d_raw = -raw, -d_raw
    length = float(np.linalg.norm(raw))
    n = raw / length
    J = (np.eye(3) - np.outer(n, n)) @ d_raw / length
    return TangentPlane(n, np.asarray(J @ covariance @ J.T))


MIN_SINE = 5e-3  # of two planes' angle: a radius below 0.25 % of the distance has no measurable width


@dataclass(frozen=True, slots=True)
class CylinderAxis:
    """The axis: point nearest to the camera's centre (3,) in m, and unit direction (3,)."""

    point_m: Array
    direction: Array

    def depth_m(self, ray: Array) -> float:
        """Where a ray (3,) of unit depth passes the axis, to one side of it as a rule."""
        across = cross(self.direction, cross(ray, self.direction))
        return float(self.point_m @ across) / float(ray @ across)


def axis_of_cylinder(planes: Iterable[TangentPlane], radius_m: float) -> CylinderAxis | None:
    """The axis of a cylinder of known radius between two planes; None where the planes nearly coincide."""
    n1, n2 = (plane.normal for plane in planes)
    across = cross(n1, n2)
    sine = float(np.linalg.norm(across))
    if sine < MIN_SINE:
        return None
    return CylinderAxis(radius_m * (n1 + n2) / (1.0 + float(n1 @ n2)), across / sine)


def tangent_normal(point_m: Array, direction: Array, radius_m: float, side: int) -> tuple[Array, Array, Array]:
    """Unit normal (3,) of a plane that touches a cylinder, and its derivatives by point and direction, (3, 3) each.

    `point_m` (3,) is any point of the axis, `side` as of a `TangentPlane`. NaN where the camera is inside the cylinder.
    The normal obeys n · n = 1, n · d = 0 and n · p = r. With e = n x d the differentials of these give
    dn = -(n · dd) d + e ((n · dd) (d · p) - n · dp) / (e · p).
    """
    foot = point_m - direction * np.sum(point_m * direction)
    distance_m = np.sqrt(np.sum(foot * foot))
    sine = radius_m / distance_m if distance_m > radius_m else np.nan
    towards, left = foot / distance_m, skew(direction) @ foot / distance_m
    normal = sine * towards + side * np.sqrt(1.0 - sine * sine) * left
    e = skew(normal) @ direction
    beside = e / float(e @ point_m)
    by_direction = np.outer(float(direction @ point_m) * beside - direction, normal)
    return normal, -np.outer(beside, normal), by_direction


def apparent_radius_px(centre_m: Array, radius_m: float, camera: Camera) -> Array:
    """Radius of the disc as large as a small sphere's image: f r / z, and 1 / cos θ longer away from the axis."""
    z_m = centre_m[..., 2]
    stretch = np.sqrt(np.linalg.norm(centre_m, axis=-1) / np.abs(z_m))
    return np.asarray(camera.K[0, 0] * radius_m / z_m * stretch)


def without_perspective(middle_px: Array, camera: Camera, depth_m: float, radius_m: float) -> Array:
    """The pixel (2,) of a sphere's centre from the middle of its outline."""
    if depth_m <= radius_m:
        return middle_px
    # The tangents to a sphere at (X, 0, Z) meet z = 1 about X Z / (Z² - r²), not about X / Z.
    return middle_px - (radius_m / depth_m) ** 2 * (middle_px - camera.K[:2, 2])

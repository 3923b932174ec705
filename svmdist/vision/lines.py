"""Lines through points of an edge, and what the outlines of a cylinder and of a sphere say of them in space."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.least_squares import huber_weights, scale_of
from svmdist.transforms import Array, cross, skew

POINT_CORRELATION_PX = 2.0  # neighbouring edge points share pixels: those closer along the edge err alike
MIN_POINT_STD_PX = 0.05  # what pixel grid and interpolation leave even without noise
HUBER = 1.5  # deviations beyond which a point counts singly; 95 % efficient at about 1.35 (Huber 1964)
FIT_STEPS, TRIALS, SEED = 6, 120, 7


@dataclass(frozen=True, slots=True)
class Line:
    """The points with `normal` · p = `offset`, in the unit of the points that were fitted.

    `normal` (2,) has length 1; `covariance` (2, 2) belongs to (turn in rad about `centre`, the points' middle (2,),
    shift along the normal).
    """

    normal: Array
    offset: float
    centre: Array
    covariance: Array

    @property
    def direction(self) -> Array:
        """Unit vector along the line, the normal turned by a quarter turn, shape (2,)."""
        return np.array([-self.normal[1], self.normal[0]])


def fit_line(
    points: Array,
    unit: float,
    min_count: int = 8,
    inlier_px: float = 1.0,
    systematic_px: float = 0.0,
) -> Line | None:
    """The line through most of the points, shape (n, 2): RANSAC, then total least squares with Huber's weights.

    `unit` is the size of a pixel in the unit of the points. None where fewer than `min_count` points agree within
    `inlier_px`, or less than half of them. `systematic_px` is an error that the points share, at each end of the line
    another. Points closer than `POINT_CORRELATION_PX` err alike.
    """
    chosen = _consensus(points, inlier_px * unit)
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
    variance = scale**2 * alike
    shared = (systematic_px * unit) ** 2
    turn = (variance / weight.sum() + shared) / max(float(weight @ position**2 / weight.sum()), 1e-30)
    shift = variance / weight.sum() + shared
    return Line(normal, float(normal @ centre), centre, np.diag([turn, shift]))


def line_between(ends: Array, covariance: Array) -> Line:
    """The line through two points, shape (2, 2), whose offsets across it have a covariance, (2, 2)."""
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    normal = np.array([-along[1], along[0]]) / length
    J = np.array([[-1.0 / length, 1.0 / length], [0.5, 0.5]])  # turn and shift by both offsets
    return Line(normal, float(normal @ ends[0]), ends.mean(axis=0), J @ covariance @ J.T)


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


MIN_SINE = 5e-3  # of two planes' angle: a radius below 0.25 % of the distance has no measurable width


@dataclass(frozen=True, slots=True)
class TangentPlane:
    """A plane through the camera's centre that touches the cylinder: unit normal (3,), covariance (3, 3)."""

    normal: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class CylinderAxis:
    """The axis: point nearest to the camera's centre (3,) in m, unit direction (3,), and covariance (6, 6) of both."""

    point_m: Array
    direction: Array
    covariance: Array

    def depth_m(self, ray: Array) -> float:
        """Where a ray (3,) of unit depth passes the axis, to one side of it as a rule."""
        across = cross(self.direction, cross(ray, self.direction))
        return float(self.point_m @ across) / float(ray @ across)


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


def tangent_normal(
    point_m: Array, direction: Array, radius_m: float, side: int
) -> tuple[Array, Array, Array]:
    """Unit normal (3,) of a plane that touches a cylinder, and its derivatives by point and direction, (3, 3) each.

    `point_m` (3,) is any point of the axis. `side` is +1 for the plane to the right of the axis as it runs through
    the image, y being down, and -1 for the left. Where the camera is inside the cylinder there is none: NaN.
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
    """The pixel (2,) of a sphere's centre from the middle of its outline.

    The tangents to a sphere at (X, 0, Z) meet z = 1 about X Z / (Z² - r²), not about X / Z.
    """
    if depth_m <= radius_m:
        return middle_px
    aside = (radius_m / depth_m) ** 2
    return middle_px - aside * (middle_px - camera.K[:2, 2])

"""A circular cylinder from its two apparent contour lines, in closed form.

The plane through the camera's centre and one contour line touches the cylinder. With unit normals n₁, n₂ of
the two planes, turned to the side on which the cylinder lies, its axis is parallel to both, and stands one
radius r from both:

    d = ± n₁ x n₂ / |n₁ x n₂|,    n₁ · p = n₂ · p = r,    d · p = 0

for p, the point of the axis nearest to the camera. p lies in the plane of the normals, and by symmetry
p = r (n₁ + n₂) / (1 + n₁ · n₂). Sources: Espiau, Chaumette & Rives, IEEE Trans. Robot. Autom. 1992 (the
contours of a cylinder); Doignon & de Mathelin, ICRA 2007 (pose of a cylindrical instrument from them).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.transforms import Array, cross, skew
from svmdist.vision.lines import Line

MIN_SINE = 5e-3
"""Of the angle between the two planes: a radius below 0.25 % of the distance has no measurable width."""


@dataclass(frozen=True, slots=True)
class TangentPlane:
    """A plane through the camera's centre that touches the cylinder.

    `normal` (3,), of length 1, points to the cylinder's side; `covariance` (3, 3) is that of the normal, with
    nothing along it.
    """

    normal: Array
    covariance: Array

    @property
    def whitening(self) -> Array:
        """The matrix, shape (2, 3), that makes of a small error of the normal two numbers of variance one."""
        variance, axes = np.linalg.eigh(self.covariance)
        return np.asarray((axes[:, 1:] / np.sqrt(variance[1:])).T)


@dataclass(frozen=True, slots=True)
class CylinderAxis:
    """The axis: the point nearest to the camera's centre, (3,) in m, its direction, (3,), of length 1.

    `covariance` (6, 6) belongs to (point, direction).
    """

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
    """The axis of a cylinder of known radius between two planes; None where the planes nearly coincide.

    They do where the cylinder has no measurable width, and where the camera looks along it from inside.
    """
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

"""A dome over the tissue's outline: its surface, and how unsure apex, height and curvature are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from svmdist.geometry import Mesh
from svmdist.profile.robot import Dome
from svmdist.transforms import Array, inverse, transform_points

INNER_RADIUS = 0.9  # of the dome, normalised: beyond it the rim is too steep for a surface of low order

FULL_TURN = 2.0 * np.pi


@dataclass(frozen=True, slots=True)
class PolarOutline:
    """An outline's corners about an apex (2,): vectors (n, 2), ascending angles, and 1 / lengths in 1/m, (n,)."""

    apex_m: Array
    from_apex_m: Array
    angle_rad: Array
    reciprocal: Array

    @staticmethod
    def about(apex_m: Array, outline_m: Array) -> PolarOutline:
        """The outline, shape (n, 2), as seen from the apex."""
        from_apex = outline_m - apex_m
        angle = np.arctan2(from_apex[:, 1], from_apex[:, 0])
        order = np.argsort(angle)
        from_apex = from_apex[order]
        return PolarOutline(apex_m, from_apex, angle[order], 1.0 / np.hypot(from_apex[:, 0], from_apex[:, 1]))

    def normalised_radius(self, points_m: Array) -> Array:
        """0 at the apex, 1 on the outline, for points, shape (n, 2): shape (n,)."""
        from_apex = points_m - self.apex_m
        before, after, _, share = self._between(from_apex)
        reciprocal = self.reciprocal[before] + share * (self.reciprocal[after] - self.reciprocal[before])
        return np.asarray(np.hypot(from_apex[:, 0], from_apex[:, 1]) * reciprocal)

    def with_derivative(self, points_m: Array) -> tuple[Array, Array]:
        """The same, and its derivative by the apex: shapes (n,) and (n, 2); the latter is zero at the apex itself."""
        from_apex = points_m - self.apex_m
        length = np.hypot(from_apex[:, 0], from_apex[:, 1])
        safe = np.where(length > 0.0, length, np.inf)
        before, after, span, share = self._between(from_apex)
        rise = self.reciprocal[after] - self.reciprocal[before]
        reciprocal = self.reciprocal[before] + share * rise
        # Of a vector r from the apex: d(1/|r|) = r / |r|³, d angle = (r_y, -r_x) / |r|², d|r| = -r / |r|.
        d_reciprocal = self.from_apex_m * self.reciprocal[:, None] ** 3
        d_angle = _across(self.from_apex_m) * self.reciprocal[:, None] ** 2
        d_toward = _across(from_apex) / safe[:, None] ** 2
        d_span = d_angle[after] - d_angle[before]
        span = np.where(span > 0.0, span, np.inf)[:, None]
        d_share = (d_toward - d_angle[before] - share[:, None] * d_span) / span
        d_here = d_reciprocal[before] + share[:, None] * (d_reciprocal[after] - d_reciprocal[before])
        d_here += d_share * rise[:, None]
        derivative = length[:, None] * d_here - reciprocal[:, None] * from_apex / safe[:, None]
        return length * reciprocal, np.where(length[:, None] > 0.0, derivative, 0.0)

    def _between(self, from_apex: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array, Array]:
        """The corners before and after vectors from the apex, the angle between them, and the vector's share of it."""
        toward = np.arctan2(from_apex[:, 1], from_apex[:, 0])
        after = np.searchsorted(self.angle_rad, toward, side="right") % len(self.angle_rad)
        before = (after - 1) % len(self.angle_rad)
        span = (self.angle_rad[after] - self.angle_rad[before]) % FULL_TURN
        ahead = (toward - self.angle_rad[before]) % FULL_TURN
        share = np.where(span > 0.0, ahead / np.where(span > 0.0, span, 1.0), 0.0)
        return before, after, span, share


def _across(vectors: Array) -> Array:
    return np.stack([vectors[:, 1], -vectors[:, 0]], -1)


RINGS = 14
SIDES = 72  # the dome's mesh: chords of 5° stand 0.03 mm off an outline of 28 mm
STEEP_RADIUS = 0.98
"""Towards the rim a dome's slope has no bound; beyond this normalised radius it counts as it is here."""


@dataclass(frozen=True)
class DomeModel:
    """A dome where it stands.

    `T_camera_tissue`, shape (4, 4), has its z axis along the plane's normal. `outline_m`, shape (n, 2), is the
    outline in that frame; `shape`, shape (5,), the apex's x and y there and its height, in m, then the exponents of
    gauge and height; `covariance`, shape (5, 5), of these.
    """

    T_camera_tissue: Array
    outline_m: Array
    shape: Array
    covariance: Array

    @staticmethod
    def over(outline_m: Array, T_camera_tissue: Array, rule: Dome) -> DomeModel:
        """The profile's dome over an outline in the camera frame, shape (n, 3) in m: the apex over the origin."""
        flat_m = transform_points(inverse(T_camera_tissue), outline_m)[:, :2]
        apex_std_m, exponent_stds = rule.apex_std_m, (rule.gauge_exponent_std, rule.height_exponent_std)
        stds = (apex_std_m, apex_std_m, rule.height_std_m, *exponent_stds)
        shape = np.array([0.0, 0.0, rule.height_m, rule.gauge_exponent, rule.height_exponent])
        return DomeModel(T_camera_tissue, flat_m, shape, np.diag(np.square(stds)))

    def scaled(self, factor: float) -> DomeModel:
        """The same on a parallel plane by this factor as far from the camera: as high, and wider by it."""
        T = self.T_camera_tissue.copy()
        T[:3, 3] *= factor
        shape = self.shape * np.array([factor, factor, 1.0, 1.0, 1.0])
        return replace(self, T_camera_tissue=T, outline_m=factor * self.outline_m, shape=shape)

    def to_tissue_frame(self, points_m: Array) -> Array:
        """Points of the camera frame, shape (n, 3), in the tissue's frame."""
        return transform_points(inverse(self.T_camera_tissue), points_m)

    def height_m(self, points_m: Array) -> Array:
        """Height over the plane at points in the tissue's frame, shape (n, 2)."""
        return np.asarray(self.shape[2] * self._profile(self.polar.normalised_radius(points_m)))

    def derivative(self, points_m: Array) -> Array:
        """Of the height (0 beyond the outline) at points, shape (n, 2), by the shape: shape (n, 5)."""
        radius, by_apex = self.polar.with_derivative(points_m)
        height_m, a, b = self.shape[2:]
        power = radius**a
        inside = power < 1.0
        rest = np.where(inside, 1.0 - power, 1.0)
        log_radius = np.log(np.where(radius > 0.0, radius, 1.0))
        profile = np.where(inside, rest**b, 0.0)
        by_power = np.where(inside, -b * rest ** (b - 1.0), 0.0)
        by_radius = by_power * a * radius ** (a - 1.0)
        by_gauge, by_exponent = height_m * by_power * power * log_radius, height_m * profile * np.log(rest)
        return np.column_stack([height_m * by_radius[:, None] * by_apex, profile, by_gauge, by_exponent])

    def variance_m2(self, point_m: Array, direction: Array) -> float:
        """By how much the surface at a point of the camera frame, (3,), may move along a unit vector, (3,)."""
        flat_m = self.to_tissue_frame(point_m[None])[:, :2]
        radius = float(self.polar.normalised_radius(flat_m)[0])
        if radius > STEEP_RADIUS:
            apex_m = self.shape[:2]
            flat_m = apex_m + (flat_m - apex_m) * STEEP_RADIUS / radius
        J = self.derivative(flat_m)[0]
        along = float(direction @ self.T_camera_tissue[:3, 2])
        return along**2 * float(J @ self.covariance @ J)

    @cached_property
    def polar(self) -> PolarOutline:
        """The outline about the apex, in the tissue's frame."""
        return PolarOutline.about(self.shape[:2], self.outline_m)

    @cached_property
    def mesh(self) -> Mesh:
        """The closed surface in the camera frame: apex, rings of `SIDES` vertices outwards, the floor's middle."""
        outline_m = self.outline_m[np.linspace(0, len(self.outline_m), SIDES, endpoint=False).astype(int)]
        x, y = outline_m.T
        if 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) < 0.0:  # clockwise
            outline_m = outline_m[::-1]
        apex_m, height_m = self.shape[:2], float(self.shape[2])
        radius = np.sin(np.linspace(0.0, np.pi / 2.0, RINGS + 1)[1:])
        rings = (apex_m + radius[:, None, None] * (outline_m - apex_m)).reshape(-1, 2)
        z_m = np.repeat(height_m * self._profile(radius), SIDES)
        vertices_m = np.vstack([[*apex_m, height_m], np.column_stack([rings, z_m]), [*apex_m, 0.0]])
        return Mesh(vertices_m, _faces()).transformed(self.T_camera_tissue)

    def _profile(self, radius: Array) -> Array:
        a, b = self.shape[3:]
        inside: Array = (1.0 - np.asarray(radius) ** a).clip(0.0)
        return np.asarray(inside**b)


@lru_cache(maxsize=1)
def _faces() -> NDArray[np.int64]:
    side = np.arange(SIDES)
    after = (side + 1) % SIDES
    last = 1 + (RINGS - 1) * SIDES
    faces = [
        np.stack([np.zeros_like(side), 1 + side, 1 + after], -1),
        np.stack([np.full_like(side, 1 + RINGS * SIDES), last + after, last + side], -1),
    ]
    for ring in range(RINGS - 1):
        inner, outer = 1 + ring * SIDES, 1 + (ring + 1) * SIDES
        faces.append(np.stack([inner + side, outer + side, outer + after], -1))
        faces.append(np.stack([inner + side, outer + after, inner + after], -1))
    return np.concatenate(faces).astype(np.int64)

"""A dome over the tissue's outline: its surface, and how unsure apex, height and curvature are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from svmdist.geometry import Mesh
from svmdist.profile.robot import Dome
from svmdist.transforms import Array, inverse, transform_points

INNER_RADIUS = 0.9  # of the dome, normalised: beyond it the rim is too steep for a surface of low order
STEP = 1e-7  # of the shape's numbers, by which the derivative is taken
RINGS = 14
SIDES = 72  # the dome's mesh: chords of 5° stand 0.03 mm off an outline of 28 mm
STEEP_RADIUS = 0.98
"""Towards the rim a dome's slope has no bound; beyond this normalised radius it counts as it is here."""


class AboveDome(NamedTuple):
    """Which of n points are inside of the rim, (n,), where these k are on the plane, (k, 2), and how far above it."""

    inner: NDArray[np.bool_]
    flat_m: Array
    over_m: Array


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
        stds = [rule.apex_std_m, rule.apex_std_m, rule.height_std_m, rule.gauge_exponent_std, rule.height_exponent_std]
        shape = np.array([0.0, 0.0, rule.height_m, rule.gauge_exponent, rule.height_exponent])
        return DomeModel(T_camera_tissue, flat_m, shape, np.diag(np.square(stds)))

    def at(self, position_m: Array, scale: float) -> DomeModel:
        """The same about another origin, shape (3,), in the camera frame: wider by a scale, and as high."""
        T = self.T_camera_tissue.copy()
        T[:3, 3] = position_m
        shape = self.shape * np.array([scale, scale, 1.0, 1.0, 1.0])
        return replace(self, T_camera_tissue=T, outline_m=scale * self.outline_m, shape=shape)

    def to_tissue_frame(self, points_m: Array) -> Array:
        """Points of the camera frame, shape (n, 3), in the tissue's frame."""
        return transform_points(inverse(self.T_camera_tissue), points_m)

    def normalised_radius(self, points_m: Array) -> Array:
        """0 at the apex, 1 on the outline, for points in the tissue's frame, shape (n, 2): shape (n,)."""
        (x, y), (corner_x, corner_y) = (points_m - self.shape[:2]).T, (self.outline_m - self.shape[:2]).T
        # Between corners the reciprocal of the length is interpolated by the angle.
        towards, angle = np.arctan2(y, x), np.arctan2(corner_y, corner_x)
        reciprocal = np.interp(towards, angle, 1.0 / np.hypot(corner_x, corner_y), period=2.0 * np.pi)
        return np.asarray(np.hypot(x, y) * reciprocal)

    def height_m(self, points_m: Array) -> Array:
        """Height over the plane, 0 beyond the outline, at points in the tissue's frame, shape (n, 2)."""
        return np.asarray(self.shape[2] * self._profile(self.normalised_radius(points_m)))

    def above(self, points_m: Array) -> AboveDome:
        """How far points of the camera frame, shape (n, 3), are above the dome."""
        local_m = self.to_tissue_frame(points_m)
        inner = self.normalised_radius(local_m[:, :2]) < INNER_RADIUS
        flat_m = local_m[inner, :2]
        return AboveDome(inner, flat_m, local_m[inner, 2] - self.height_m(flat_m))

    def derivative(self, points_m: Array) -> Array:
        """Of the height at points, shape (n, 2), by the shape: shape (n, 5), by central differences."""
        columns = []
        for step in STEP * np.eye(5):
            ahead, behind = (replace(self, shape=self.shape + by).height_m(points_m) for by in (step, -step))
            columns.append((ahead - behind) / (2.0 * STEP))
        return np.column_stack(columns)

    def variance_m2(self, point_m: Array, direction: Array) -> float:
        """By how much the surface at a point of the camera frame, (3,), may move along a unit vector, (3,)."""
        flat_m = self.to_tissue_frame(point_m[None])[:, :2]
        radius = float(self.normalised_radius(flat_m)[0])
        if radius > STEEP_RADIUS:
            apex_m = self.shape[:2]
            flat_m = apex_m + (flat_m - apex_m) * STEEP_RADIUS / radius
        J = self.derivative(flat_m)[0]
        along = float(direction @ self.T_camera_tissue[:3, 2])
        return along**2 * float(J @ self.covariance @ J)

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
    at = 1 + np.arange(RINGS * SIDES).reshape(RINGS, SIDES)
    after = np.roll(at, -1, axis=1)
    apex, floor = np.zeros(SIDES), np.full(SIDES, 1 + RINGS * SIDES)
    faces = [np.stack([apex, at[0], after[0]], -1), np.stack([floor, after[-1], at[-1]], -1)]
    for inner, inner_after, outer, outer_after in zip(at, after, at[1:], after[1:], strict=False):
        faces.append(np.stack([inner, outer, outer_after], -1))
        faces.append(np.stack([inner, outer_after, inner_after], -1))
    return np.concatenate(faces).astype(np.int64)

"""A dome over the tissue's outline: its surface, and how unsure apex and height are."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from svmdist.geometry.surfaces import Mesh
from svmdist.profile import Dome
from svmdist.transforms import Array, inverse, transform_points

RINGS = 14
SIDES = 72
"""The dome's mesh: chords of 5° stand 0.03 mm off an outline of 28 mm."""
STEP = 1e-6
"""Of the central differences, in m: truncation and rounding are both below 1e-9 of it."""
STEEP_GAUGE = 0.98
"""Towards the rim a dome's slope has no bound; beyond this gauge it counts as it is here."""


@dataclass(frozen=True, slots=True)
class DomeFix:
    """A dome where it stands.

    `T_camera_tissue`, shape (4, 4), has its z axis along the plane's normal. `outline_m`, shape (n, 2), is the
    outline in that frame; `shape_m`, shape (3,), the apex's x and y there, and its height; `covariance`, shape (3, 3),
    of these.
    """

    rule: Dome
    T_camera_tissue: Array
    outline_m: Array
    shape_m: Array
    covariance: Array

    @staticmethod
    def over(outline_m: Array, T_camera_tissue: Array, rule: Dome) -> DomeFix:
        """The profile's dome over an outline in the camera frame, shape (n, 3) in m: the apex over the origin."""
        flat_m = transform_points(inverse(T_camera_tissue), outline_m)[:, :2]
        covariance = np.diag([rule.apex_std_m**2, rule.apex_std_m**2, rule.height_std_m**2])
        return DomeFix(rule, T_camera_tissue, flat_m, np.array([0.0, 0.0, rule.height_m]), covariance)

    def shaped(self, shape_m: Array, covariance: Array) -> DomeFix:
        """The same outline under another apex and height."""
        return replace(self, shape_m=shape_m, covariance=covariance)

    def mesh(self) -> Mesh:
        """The closed surface in the camera frame.

        The gauge runs from 0 at the apex to 1 on the outline; rings crowd at the rim, where the dome is steep.
        """
        outline_m = self.outline_m[np.linspace(0, len(self.outline_m), SIDES, endpoint=False).astype(int)]
        if _signed_area(outline_m) < 0.0:
            outline_m = outline_m[::-1]
        apex_m, height_m = self.shape_m[:2], float(self.shape_m[2])
        gauge = np.sin(np.linspace(0.0, np.pi / 2.0, RINGS + 1)[1:])
        z_m = np.repeat(height_m * self._profile(gauge), SIDES)
        rings = (apex_m + gauge[:, None, None] * (outline_m - apex_m)).reshape(-1, 2)
        vertices_m = np.vstack([[*apex_m, height_m], np.column_stack([rings, z_m]), [*apex_m, 0.0]])
        return Mesh(vertices_m, _fan_rings_and_floor()).transformed(self.T_camera_tissue)

    def on_floor(self, points_m: Array) -> Array:
        """Points of the camera frame, shape (n, 3), in the tissue's frame."""
        return transform_points(inverse(self.T_camera_tissue), points_m)

    def gauge(self, points_m: Array, apex_m: Array) -> Array:
        """0 at the apex, shape (2,), 1 on the outline, for points in the tissue's frame, shape (n, 2): shape (n,)."""
        corners = self.outline_m - apex_m
        angle = np.arctan2(corners[:, 1], corners[:, 0])
        from_apex = points_m - apex_m
        toward = np.arctan2(from_apex[:, 1], from_apex[:, 0])
        curvature = np.interp(toward, *_sorted(angle, 1.0 / np.hypot(*corners.T)), period=2.0 * np.pi)
        return np.asarray(np.hypot(*from_apex.T) * curvature)

    def height_m(self, points_m: Array, shape_m: Array | None = None) -> Array:
        """Height over the plane at points in the tissue's frame, shape (n, 2); of another shape where one is given."""
        apex_x_m, apex_y_m, top_m = self.shape_m if shape_m is None else shape_m
        return np.asarray(top_m * self._profile(self.gauge(points_m, np.array([apex_x_m, apex_y_m]))))

    def derivative(self, points_m: Array) -> Array:
        """Of the height at points in the tissue's frame, shape (n, 2), by the shape: shape (n, 3)."""
        columns = [
            (self.height_m(points_m, self.shape_m + step) - self.height_m(points_m, self.shape_m - step))
            / (2.0 * STEP)
            for step in STEP * np.eye(3)
        ]
        return np.stack(columns, -1)

    def variance_m2(self, point_m: Array, direction: Array) -> float:
        """By how much the surface at a point of the camera frame, shape (3,), may move along a unit vector, shape (3,).

        Height and apex move the surface along the plane's normal; along d a part of it remains: (d · n)².
        """
        flat_m = self.on_floor(point_m[None])[:, :2]
        apex_m = self.shape_m[:2]
        gauge = float(self.gauge(flat_m, apex_m)[0])
        if gauge > STEEP_GAUGE:
            flat_m = apex_m + (flat_m - apex_m) * STEEP_GAUGE / gauge
        J = self.derivative(flat_m)[0]
        along = float(direction @ self.T_camera_tissue[:3, 2])
        return along**2 * float(J @ self.covariance @ J)

    def _profile(self, gauge: Array) -> Array:
        rule = self.rule
        inside: Array = (1.0 - np.asarray(gauge) ** rule.gauge_exponent).clip(0.0)
        return np.asarray(inside**rule.height_exponent)


def _fan_rings_and_floor() -> NDArray[np.int64]:
    """Triangles, shape (f, 3): a fan at the apex, rings, and a fan that closes the floor from its last vertex."""
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


def _signed_area(polygon_m: Array) -> float:
    x, y = polygon_m.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _sorted(angle: Array, values: Array) -> tuple[Array, Array]:
    order = np.argsort(angle)
    return angle[order], values[order]

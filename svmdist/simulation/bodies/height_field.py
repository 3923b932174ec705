"""The organ as heights over its plane: what lies straight below or above a point, exactly as its triangles have it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from svmdist.simulation.bodies.organ import Organ
from svmdist.transforms import Array


class HeightField:
    """Heights of an organ's mesh, whose rings about the apex make every triangle easy to find.

    Heights at the vertices may be others than the mesh's; their places in the plane stay.
    """

    def __init__(self, organ: Organ) -> None:
        vertices_m = organ.mesh.vertices_m
        self._side_count = len(organ.outline_m)
        self._apex_m = vertices_m[0, :2]
        rays_m = vertices_m[-self._side_count :, :2] - self._apex_m
        first = vertices_m[1 :: self._side_count, :2] - self._apex_m
        self._ring_radius = np.concatenate([[0.0], first @ rays_m[0] / (rays_m[0] @ rays_m[0])])
        # The outline is seen from the apex in the order of its corners: it is nearly convex.
        bearing = np.unwrap(np.arctan2(rays_m[:, 1], rays_m[:, 0]))
        self._first_bearing = bearing[0]
        self._bearings = bearing - bearing[0]
        self._rays_m = np.vstack([rays_m, rays_m[:1]])

    def heights_m(self, xy_m: Array, z_m: Array) -> Array:
        """Heights over points, shape (n, 2), by those of the vertices, shape (v,): (n,), -inf beside the organ."""
        away = xy_m - self._apex_m
        turn = np.mod(np.arctan2(away[:, 1], away[:, 0]) - self._first_bearing, 2.0 * np.pi)
        side = np.clip(np.searchsorted(self._bearings, turn, side="right") - 1, 0, self._side_count - 1)
        a, b = self._rays_m[side], self._rays_m[side + 1]
        # A point is alpha a + beta b; alpha + beta is its normalised radius.
        across = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        alpha = (away[:, 0] * b[:, 1] - away[:, 1] * b[:, 0]) / across
        beta = (a[:, 0] * away[:, 1] - a[:, 1] * away[:, 0]) / across
        ring = np.clip(np.searchsorted(self._ring_radius, alpha + beta), 1, len(self._ring_radius) - 1)
        near, far = self._ring_radius[ring - 1], self._ring_radius[ring]
        z_near, z_far = self._at(z_m, ring - 1, side), self._at(z_m, ring, side)
        z_near_b, z_far_b = self._at(z_m, ring - 1, side + 1), self._at(z_m, ring, side + 1)
        # The triangle on the side of `a`: inner a, outer a, outer b; and the other: inner a, outer b, inner b.
        w_far_b = beta / far
        w_far = (alpha - near * (1.0 - w_far_b)) / (far - near)
        on_a = w_far >= 0.0
        w_near = np.divide(alpha, near, out=np.zeros_like(alpha), where=near > 0.0)
        w_far_b_other = (beta - near * (1.0 - w_near)) / (far - near)
        height = np.where(
            on_a,
            (1.0 - w_far - w_far_b) * z_near + w_far * z_far + w_far_b * z_far_b,
            w_near * z_near + w_far_b_other * z_far_b + (1.0 - w_near - w_far_b_other) * z_near_b,
        )
        return np.where(alpha + beta <= 1.0, height, -np.inf)

    def _at(self, z_m: Array, ring: NDArray[np.intp], side: NDArray[np.intp]) -> Array:
        vertex = 1 + (ring - 1) * self._side_count + side % self._side_count
        return np.asarray(z_m[np.where(ring == 0, 0, vertex)])

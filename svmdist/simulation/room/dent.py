"""Tissue that gives way under what presses on it: its surface is pushed down, smoothly, until nothing is inside.

Every point of an instrument that would be inside pushes the surface below itself down to it, and what is around along
with it, less and less: by the deepest push that reaches a place. So the surface touches what presses and nothing lies
below it. What is not pressed is as at rest; nothing bulges, and nothing remains of a dent when the pressure is gone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.simulation.bodies.height_field import HeightField
from svmdist.simulation.bodies.meshes import DrawnMesh, smooth_normals
from svmdist.simulation.bodies.organ import Organ
from svmdist.transforms import Array

REACH_M = 0.012
"""A push is felt as far as this, half of it at 3.7 mm. Below a blunt punch on a deep half-space half of the depth is
left at 1.4 times its radius (Johnson 1985, Contact mechanics, sec. 3.4); a capsule under tension spreads it."""
LIMIT = 0.8
"""Of the organ's height at a place; then it is pressed flat against its bed, and gives way no further."""
MENDING_REACH_M = 0.002
SWEEPS = 8
"""Between the vertices the pressed surface is flat: some µm are left inside. They push again, on what is near alone."""
TOLERANCE_M = 1e-6
CELL_M = 0.0003
"""Of points in one cell of the plane the deepest pushes: those above it, and on steep sides, change nothing."""
CHUNK = 64


@dataclass(frozen=True)
class Dent:
    """The organ's mesh as it is pressed, and how far something is inside it all the same, in m along the heights."""

    mesh: DrawnMesh
    left_m: float


class YieldingOrgan:
    """An organ that gives way to points which would be inside; all in the tissue frame."""

    def __init__(self, organ: Organ) -> None:
        self._mesh = organ.mesh
        self._field = HeightField(organ)
        self._rest_m = organ.mesh.vertices_m[:, 2]
        self.height_m = float(self._rest_m.max())

    def inside_m(self, points_m: Array, share: float = 1.0) -> Array:
        """How deep points, shape (n, 3), lie below the surface at rest, or that share of its height: shape (n,)."""
        return self._field.heights_m(points_m[:, :2], self._rest_m) * share - points_m[:, 2]

    def is_too_deep(self, points_m: Array) -> bool:
        """Whether some of the points, shape (n, 3), lie so deep that the organ does not give way to them."""
        return bool((self.inside_m(points_m, 1.0 - LIMIT) > TOLERANCE_M).any())

    def dented(self, points_m: Array) -> Dent:
        """The organ under points, shape (n, 3), which are inside it at rest."""
        down_m, least_m = np.zeros_like(self._rest_m), (1.0 - LIMIT) * self._rest_m
        for sweep in range(SWEEPS + 1):
            deep_m = self._field.heights_m(points_m[:, :2], self._rest_m - down_m) - points_m[:, 2]
            push = deep_m > TOLERANCE_M
            if sweep == SWEEPS or not push.any():
                break
            xy_m, by_m = _deepest(points_m[push, :2], deep_m[push])
            down_m += self._pushed_m(xy_m, by_m, MENDING_REACH_M if sweep else REACH_M)
            down_m = np.minimum(down_m, self._rest_m - least_m)
        vertices_m = self._mesh.vertices_m.copy()
        vertices_m[:, 2] -= down_m
        normals = smooth_normals(vertices_m, self._mesh.faces)
        return Dent(DrawnMesh(vertices_m, self._mesh.faces, normals, self._mesh.uv), float(deep_m.max()))

    def _pushed_m(self, xy_m: Array, by_m: Array, reach_m: float) -> Array:
        """How far vertices are pushed by points, shape (n, 2), that push so far, shape (n,): the most of all; (v,)."""
        place_m, pushed_m = self._mesh.vertices_m[:, :2], np.zeros_like(self._rest_m)
        for begin in range(0, len(xy_m), CHUNK):
            some_m, push_m = xy_m[begin : begin + CHUNK], by_m[begin : begin + CHUNK]
            near = ((place_m > some_m.min(0) - reach_m) & (place_m < some_m.max(0) + reach_m)).all(axis=1)
            x_m, y_m = (place_m[near, axis, None] - some_m[:, axis] for axis in range(2))
            share = bump(np.sqrt(x_m * x_m + y_m * y_m) / reach_m)
            pushed_m[near] = np.maximum(pushed_m[near], (share * push_m).max(axis=1))
        return pushed_m


def _deepest(xy_m: Array, deep_m: Array) -> tuple[Array, Array]:
    """Of points, shape (n, 2), which are so deep, shape (n,), the deepest of each cell, cell by cell."""
    column, row = np.floor(xy_m / CELL_M).astype(np.int64).T
    order = np.lexsort((deep_m, row, column))
    column, row = column[order], row[order]
    is_last = np.append((np.diff(column) != 0) | (np.diff(row) != 0), True)
    chosen = order[is_last]
    return xy_m[chosen], deep_m[chosen]


def bump(radius: Array) -> Array:
    """From 1 at radius 0 to 0 at 1 and beyond, any shape; twice differentiable.

    Wendland 1995, Piecewise polynomial, positive definite and compactly supported radial functions.
    """
    left = np.maximum(1.0 - radius, 0.0)
    square = left * left
    return np.asarray(square * square * (5.0 - 4.0 * left))

"""Compact groups of a mesh's faces: what bounds a group tells which of its faces can be near.

Which faces make a group depends on the mesh's topology and its rough shape only, so that the groups are kept while
the mesh moves or bends; the bounds are computed for the vertices as they stand, and hold for any grouping.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.geometry.closest import cross, dot
from svmdist.transforms import Array

Indices = NDArray[np.intp]

FACES_PER_PATCH = 16
"""Of a mesh of 2,000 faces this makes 64 patches; half or twice as many take as long."""
MARGIN = 1e-15
"""Of a coordinate: by how much more a box holds, for the rounding of its middle."""
TURN = 0.25
"""How far faces count as apart that are turned from one another, over the mesh's size: a floor is no part of a dome."""


@dataclass(frozen=True, slots=True)
class Patches:
    """Groups of faces: their indices, shape (p, k), and those of their vertices, shape (m, p).

    They are filled up with faces and vertices that stand in them already, so that all have as many.
    """

    faces: Indices
    vertices: Indices

    @staticmethod
    def of(vertices_m: Array, faces: NDArray[np.int64]) -> Patches:
        """Patches of faces, shape (f, 3), which are compact where the vertices, shape (v, 3), are these."""
        halvings = max(0, int(np.ceil(np.log2(len(faces) / FACES_PER_PATCH))))
        corners = vertices_m[faces]
        normals = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        turned = TURN * np.ptp(vertices_m, axis=0).max() * normals / np.where(lengths > 0.0, lengths, 1.0)
        places = np.column_stack([corners.mean(1), turned])
        grouped = compact_order(places, FACES_PER_PATCH << halvings, 1 << halvings).reshape(1 << halvings, -1)
        used = [np.unique(faces[group]) for group in grouped]
        widest = max(len(each) for each in used)
        return Patches(grouped, np.stack([np.resize(each, widest) for each in used], -1))

    def bounds(self, vertices_m: Array) -> Bounds:
        """Bounds of the patches of a mesh with these vertices, shape (v, 3)."""
        return Bounds.about(vertices_m[self.vertices])


@dataclass(frozen=True, slots=True)
class Bounds:
    """Boxes of p groups of points by their middles `centre_m` and half sides `half_m`, shape (p, 3) each."""

    centre_m: Array
    half_m: Array

    @property
    def reach_m(self) -> Array:
        """Radii of balls about the boxes, shape (p,)."""
        return np.asarray(np.sqrt(dot(self.half_m, self.half_m)))

    @property
    def low_m(self) -> Array:
        """The boxes' corners with the least coordinates, shape (p, 3)."""
        return self.centre_m - self.half_m

    @property
    def high_m(self) -> Array:
        """The boxes' corners with the greatest coordinates, shape (p, 3)."""
        return self.centre_m + self.half_m

    @staticmethod
    def about(points_m: Array) -> Bounds:
        """Bounds of p groups of m points each, shape (m, p, 3)."""
        low_m, high_m = points_m.min(0), points_m.max(0)
        # Rounding may leave a point a last digit outside of middle and half side.
        return Bounds(0.5 * (low_m + high_m), 0.5 * (high_m - low_m) + MARGIN * np.abs(high_m + low_m))


def compact_order(places: Array, count: int, groups: int) -> Indices:
    """An order of `count` items at places, shape (n, d), whose halves, quarters and so on are each compact.

    Items stand in it twice where `count` is above n. It is halved until there are as many groups, a power of two.
    """
    order = np.resize(np.arange(len(places)), count)
    group = count
    while group > count // groups:  # groups are sorted along their longest side and cut in the middle
        grouped = order.reshape(-1, group)
        points = places[grouped]
        axis = np.argmax(np.ptp(points, axis=1), axis=1)
        along = np.take_along_axis(points, axis[:, None, None], axis=2)[..., 0]
        order = np.take_along_axis(grouped, np.argsort(along, axis=1, kind="stable"), axis=1).ravel()
        group //= 2
    return order


def is_closed(faces: NDArray[np.int64]) -> bool:
    """Whether every edge of the faces, shape (f, 3), is run once in each direction: the mesh has no border."""
    count = int(faces.max()) + 1
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    forward, times = np.unique(start * count + end, return_counts=True)
    return bool((times == 1).all() and np.array_equal(forward, np.unique(end * count + start)))

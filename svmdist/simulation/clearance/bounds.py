"""What cannot be the nearest part of an instrument: lower bounds of the parts' clearances, for many poses at once.

A separating direction bounds the signed distance of two bodies from below, and so does that of bodies that hold them:
a box holds each part, half-spaces hold the organ. For two instruments, each part is held by a capsule.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.geometry.closest import point_to_segment, segment_to_segment
from svmdist.geometry.surfaces import Mesh
from svmdist.transforms import Array

DIRECTIONS = 128
"""They are 0.2 rad apart: between two of them, a bound falls short of a distance by 0.5 % of it."""


@dataclass(frozen=True)
class HalfSpaces:
    """What holds a body: points with `normals` · p <= `offsets_m`; shapes (d, 3), of length 1, and (d,)."""

    normals: Array
    offsets_m: Array

    @staticmethod
    def about(vertices_m: Array) -> HalfSpaces:
        """The half-spaces that touch a body with vertices, shape (v, 3), in directions that spread over the sphere."""
        index = np.arange(DIRECTIONS) + 0.5
        z, angle = 1.0 - 2.0 * index / DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * index
        ring = np.sqrt(1.0 - z**2)
        normals = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], -1)
        return HalfSpaces(normals, (vertices_m @ normals.T).max(0))


@dataclass(frozen=True)
class PartBounds:
    """What holds the parts, k of them, each in the frame of its link: boxes and capsules.

    Boxes by `centre_m` and half sides `half_m`, shape (k, 3); capsules by the ends of their axes, shape (k, 3), and
    `radius_m`, shape (k,).
    """

    links: tuple[str, ...]
    centre_m: Array
    half_m: Array
    start_m: Array
    end_m: Array
    radius_m: Array

    @staticmethod
    def of(parts: Sequence[tuple[str, Mesh]]) -> PartBounds:
        """Bounds of meshes in the frames of their links."""
        low_m = np.stack([mesh.vertices_m.min(0) for _, mesh in parts])
        high_m = np.stack([mesh.vertices_m.max(0) for _, mesh in parts])
        centre_m, half_m = 0.5 * (low_m + high_m), 0.5 * (high_m - low_m)
        axes = [_axis(mesh.vertices_m, c, h) for (_, mesh), c, h in zip(parts, centre_m, half_m, strict=True)]
        start_m, end_m, radius_m = (np.array(values) for values in zip(*axes, strict=True))
        return PartBounds(tuple(link for link, _ in parts), centre_m, half_m, start_m, end_m, radius_m)

    def stacked(self, poses: dict[str, Array]) -> Array:
        """The poses of the parts' links, shape (n, k, 4, 4), from those of all links, shape (n, 4, 4) each."""
        return np.stack([poses[link] for link in self.links], -3)

    def least_m(self, T_world_part: Array, body: HalfSpaces) -> Array:
        """No more than the parts' clearances to what the half-spaces hold, at poses (n, k, 4, 4): shape (n, k)."""
        R = T_world_part[..., :3, :3]
        height_m = _placed(T_world_part, self.centre_m) @ body.normals.T - body.offsets_m
        reach_m = np.einsum("nkdj,kj->nkd", np.abs(body.normals @ R), self.half_m)
        return np.asarray((height_m - reach_m).max(-1))

    def least_between_m(self, T_world_part: Array, other: PartBounds, T_world_other: Array) -> Array:
        """No more than the clearances of each two parts, at poses (n, k, 4, 4) and (n, l, 4, 4): shape (n, k, l)."""
        start, end = (_placed(T_world_part, each)[:, :, None] for each in (self.start_m, self.end_m))
        start_other, end_other = (
            _placed(T_world_other, each)[:, None] for each in (other.start_m, other.end_m)
        )
        apart_m = segment_to_segment(start, end, start_other, end_other).distance
        return np.asarray(apart_m - self.radius_m[:, None] - other.radius_m)


def _axis(vertices_m: Array, centre_m: Array, half_m: Array) -> tuple[Array, Array, float]:
    """A capsule about vertices along the longest side of their box: its axis's ends, and its radius in m."""
    along = np.eye(3)[int(np.argmax(half_m))]
    away = vertices_m - centre_m
    aside_m = float(np.linalg.norm(away - (away @ along)[:, None] * along, axis=1).max())
    reach = max(float(half_m @ along) - aside_m, 0.0) * along
    start_m, end_m = centre_m - reach, centre_m + reach
    return start_m, end_m, float(point_to_segment(vertices_m, start_m, end_m).distance.max())


def _placed(T_world_part: Array, points_m: Array) -> Array:
    """A point of each part, shape (k, 3), in the world: shape (n, k, 3)."""
    return np.asarray((T_world_part[..., :3, :3] @ points_m[:, :, None])[..., 0] + T_world_part[..., :3, 3])

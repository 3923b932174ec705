"""The shortest separation between capsules and a surface, or other capsules, signed and with its direction.

Outside, the distance is that of the axis less the radius. Where an axis reaches into a solid (half-space,
closed mesh), the depth of its deepest point counts below zero, and the radius on top: the distance goes
through zero without a jump, and its derivative along `direction` is -1 on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from svmdist.geometry.closest import point_to_segment, segment_to_segment, segment_to_triangle
from svmdist.geometry.inside import contains
from svmdist.geometry.near import (
    CHUNK,
    ROUGH_M,
    TOUCH_M,
    distances_to_axes,
    near_faces,
    near_pairs,
    nearest_on_mesh,
)
from svmdist.geometry.patches import Indices
from svmdist.geometry.surfaces import Capsules, Mesh, Plane, PosedMesh, Surface
from svmdist.transforms import Array, inverse, transform_points

ZOOM_POINTS = 33
ZOOM_ROUNDS = 8
"""The deepest point is searched on a grid that shrinks 16-fold a round: 0.3 m to 1e-10 m."""


@dataclass(frozen=True, slots=True)
class Separation:
    """The shortest separation: `distance_m` (negative: penetration depth) along `direction`, shape (3,).

    `direction` is a unit vector from instrument to tissue: moving the instrument along it lessens the distance.
    The points, shape (3,), satisfy `on_tissue_m = on_instrument_m + distance_m * direction`. `capsule` is
    the index of the nearest one, `other_capsule` that of the other instrument's, where it is no tissue.
    """

    distance_m: float
    direction: Array
    on_instrument_m: Array
    on_tissue_m: Array
    capsule: int
    other_capsule: int | None = None

    def transformed(self, T_other_this: Array) -> Separation:
        """The same separation in another frame, by a transform of shape (4, 4)."""
        on_instrument_m, on_tissue_m = transform_points(
            T_other_this, [self.on_instrument_m, self.on_tissue_m]
        )
        direction = T_other_this[:3, :3] @ self.direction
        return replace(self, direction=direction, on_instrument_m=on_instrument_m, on_tissue_m=on_tissue_m)

    def reversed(self) -> Separation:
        """The separation of two instruments as the other one has it."""
        if self.other_capsule is None:
            raise ValueError("tissue is no instrument: its separation has one side only")
        return Separation(
            self.distance_m,
            -self.direction,
            self.on_tissue_m,
            self.on_instrument_m,
            self.other_capsule,
            self.capsule,
        )


def separation(capsules: Capsules, surface: Surface) -> Separation:
    """Shortest separation between capsules and a surface in the same frame."""
    if isinstance(surface, Plane):
        return _to_plane(capsules, surface)
    if isinstance(surface, PosedMesh):
        in_shape = _to_mesh(capsules.transformed(inverse(surface.T_here_shape)), surface.shape)
        return in_shape.transformed(surface.T_here_shape)
    if isinstance(surface, Mesh):
        return _to_mesh(capsules, surface)
    return _to_points(capsules, surface.points_m)


def capsule_separation(instrument: Capsules, other: Capsules) -> Separation:
    """Shortest separation between two sets of capsules; `other` stands in the tissue's place."""
    i, j = near_pairs(instrument, other)
    pair = segment_to_segment(instrument.start_m[i], instrument.end_m[i], other.start_m[j], other.end_m[j])
    gap = pair.distance - instrument.radius_m[i] - other.radius_m[j]
    at = int(np.argmin(gap))
    first, second, distance = pair.first[at], pair.second[at], float(pair.distance[at])
    i, j = i[at], j[at]
    if distance > TOUCH_M:
        direction = (second - first) / distance
    else:  # the axes cross: apart is along their common perpendicular
        direction = _unit_or_any(
            np.cross(instrument.end_m[i] - instrument.start_m[i], other.end_m[j] - other.start_m[j])
        )
    return replace(_outside(instrument, int(i), first, direction, float(gap[at])), other_capsule=int(j))


def _to_plane(capsules: Capsules, plane: Plane) -> Separation:
    """A linear height is least at an end of the segment."""
    ends = np.stack([capsules.start_m, capsules.end_m])  # (2, n, 3)
    height_m = ends @ plane.normal - plane.offset_m - capsules.radius_m
    side, index = np.unravel_index(np.argmin(height_m), height_m.shape)
    return _outside(capsules, int(index), ends[side, index], -plane.normal, float(height_m[side, index]))


def _to_points(capsules: Capsules, points_m: Array) -> Separation:
    if len(points_m) == 0:
        raise ValueError("a cloud without points has no distance")
    # The squared distances by matrix products are right within 1e-15 m²: what they leave is then computed exactly.
    best: tuple[float, int, int] = (np.inf, 0, 0)
    step = max(1, CHUNK // max(len(capsules), 1))
    for begin in range(0, len(points_m), step):
        part = points_m[begin : begin + step]
        rough = distances_to_axes(part, capsules) - capsules.radius_m[:, None]
        i, j = np.nonzero(rough <= rough.min() + 2.0 * ROUGH_M)
        pair = point_to_segment(part[j], capsules.start_m[i], capsules.end_m[i])
        gap = pair.distance - capsules.radius_m[i]
        at = int(np.argmin(gap))
        if gap[at] < best[0]:
            best = (float(gap[at]), int(i[at]), begin + int(j[at]))
    gap_m, index, at = best
    pair = point_to_segment(points_m[at], capsules.start_m[index], capsules.end_m[index])
    direction = _unit_or_any(pair.first - pair.second)
    return _outside(capsules, index, pair.second, direction, gap_m)


def _to_mesh(capsules: Capsules, mesh: Mesh) -> Separation:
    capsule, corners = near_faces(capsules, mesh)
    pair = segment_to_triangle(capsules.start_m[capsule], capsules.end_m[capsule], corners)
    gap = pair.distance - capsules.radius_m[capsule]
    at = int(np.argmin(gap))
    index = int(capsule[at])
    reaching = _reaching_inside(capsules, mesh, np.unique(capsule[pair.distance <= TOUCH_M]))
    if len(reaching):
        return min((_deepest(capsules, int(k), mesh) for k in reaching), key=lambda found: found.distance_m)
    if pair.distance[at] <= TOUCH_M:  # an end touches from outside
        a, b, c = corners[at]
        direction = -_unit_or_any(np.cross(b - a, c - a))
    else:
        direction = (pair.second[at] - pair.first[at]) / pair.distance[at]
    return _outside(capsules, index, pair.first[at], direction, float(gap[at]))


def _reaching_inside(capsules: Capsules, mesh: Mesh, piercing: Indices) -> Indices:
    """Indices of capsules whose axis has a part inside: those that pierce the surface, and those fully inside."""
    count = len(capsules)
    ends = contains(mesh, np.concatenate([capsules.start_m, capsules.end_m]))
    inside = ends[:count] | ends[count:]
    for k in piercing[~inside[piercing]]:
        along = np.linspace(0.0, 1.0, ZOOM_POINTS)[:, None]
        points = capsules.start_m[k] + along * (capsules.end_m[k] - capsules.start_m[k])
        inside[k] = bool(contains(mesh, points).any())
    return np.nonzero(inside)[0]


def _deepest(capsules: Capsules, index: int, mesh: Mesh) -> Separation:
    """The axis's deepest point inside a mesh: unique in a convex one, where the depth is concave along a line."""
    start, along = capsules.start_m[index], capsules.end_m[index] - capsules.start_m[index]
    low, high = 0.0, 1.0
    bounded_by_inside = False
    for _ in range(ZOOM_ROUNDS):
        t = np.linspace(low, high, ZOOM_POINTS)
        points = start + t[:, None] * along
        nearest, distance = nearest_on_mesh(points, mesh)
        # Between two points inside all are inside: only the first rounds, which cost most, must ask for each.
        inside = np.ones(len(t), np.bool_) if bounded_by_inside else contains(mesh, points)
        depth = np.where(inside, distance, -distance)
        at = int(np.argmax(depth))
        before, after = max(at - 1, 0), min(at + 1, len(t) - 1)
        bounded_by_inside = bool(inside[before] and inside[after])
        low, high = float(t[before]), float(t[after])
    inward = points[at] - nearest[at]
    if np.linalg.norm(inward) <= TOUCH_M:
        inward = along
    distance_m = -float(depth[at]) - float(capsules.radius_m[index])
    return _outside(capsules, index, points[at], _unit_or_any(inward), distance_m)


def _outside(
    capsules: Capsules, index: int, on_axis: Array, direction: Array, distance_m: float
) -> Separation:
    on_instrument = on_axis + capsules.radius_m[index] * direction
    return Separation(distance_m, direction, on_instrument, on_instrument + distance_m * direction, index)


def _unit_or_any(vector: Array) -> Array:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 0.0 else np.array([0.0, 0.0, 1.0])

"""The shortest separation between capsules and a surface, or other capsules, signed and with its direction.

Outside, the distance is that of the axis less the radius. Where an axis reaches into a solid (half-space,
closed mesh), the depth of its deepest point counts below zero, and the radius on top: the distance goes
through zero without a jump, and its derivative along `direction` is -1 on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.geometry.closest import (
    point_to_segment,
    point_to_triangle,
    segment_to_segment,
    segment_to_triangle,
    winding_number,
)
from svmdist.geometry.surfaces import Capsules, Mesh, Plane, Surface
from svmdist.transforms import Array

Indices = NDArray[np.intp]

CHUNK = 1 << 20
"""Pairs that are held at once: about 100 MB of temporaries."""
ZOOM_POINTS = 33
ZOOM_ROUNDS = 8
"""The deepest point is searched on a grid that shrinks 16-fold a round: 0.3 m to 1e-10 m."""
TOUCH_M = 1e-12


@dataclass(frozen=True, slots=True)
class Separation:
    """The shortest separation: `distance_m` (negative: penetration depth) along `direction`, shape (3,).

    `direction` is a unit vector from instrument to tissue: moving the instrument along it lessens the distance.
    The points, shape (3,), satisfy `on_tissue_m = on_instrument_m + distance_m * direction`. `capsule` is
    the index of the nearest one.
    """

    distance_m: float
    direction: Array
    on_instrument_m: Array
    on_tissue_m: Array
    capsule: int


def separation(capsules: Capsules, surface: Surface) -> Separation:
    """Shortest separation between capsules and a surface in the same frame."""
    if isinstance(surface, Plane):
        return _to_plane(capsules, surface)
    if isinstance(surface, Mesh):
        return _to_mesh(capsules, surface)
    return _to_points(capsules, surface.points_m)


def capsule_separation(instrument: Capsules, other: Capsules) -> Separation:
    """Shortest separation between two sets of capsules; `other` stands in the tissue's place."""
    pair = segment_to_segment(
        instrument.start_m[:, None], instrument.end_m[:, None], other.start_m[None], other.end_m[None]
    )
    gap = pair.distance - instrument.radius_m[:, None] - other.radius_m[None]
    i, j = np.unravel_index(np.argmin(gap), gap.shape)
    first, second, distance = pair.first[i, j], pair.second[i, j], float(pair.distance[i, j])
    if distance > TOUCH_M:
        direction = (second - first) / distance
    else:  # the axes cross: apart is along their common perpendicular
        direction = _unit_or_any(
            np.cross(instrument.end_m[i] - instrument.start_m[i], other.end_m[j] - other.start_m[j])
        )
    return _outside(instrument, int(i), first, direction, float(gap[i, j]))


def _to_plane(capsules: Capsules, plane: Plane) -> Separation:
    """A linear height is least at an end of the segment."""
    ends = np.stack([capsules.start_m, capsules.end_m])  # (2, n, 3)
    height_m = ends @ plane.normal - plane.offset_m - capsules.radius_m
    side, index = np.unravel_index(np.argmin(height_m), height_m.shape)
    return _outside(capsules, int(index), ends[side, index], -plane.normal, float(height_m[side, index]))


def _to_points(capsules: Capsules, points_m: Array) -> Separation:
    if len(points_m) == 0:
        raise ValueError("a cloud without points has no distance")
    best: tuple[float, int, int] = (np.inf, 0, 0)
    step = max(1, CHUNK // max(len(capsules), 1))
    for begin in range(0, len(points_m), step):
        part = points_m[begin : begin + step]
        pair = point_to_segment(part[None], capsules.start_m[:, None], capsules.end_m[:, None])
        gap = pair.distance - capsules.radius_m[:, None]
        i, j = np.unravel_index(np.argmin(gap), gap.shape)
        if gap[i, j] < best[0]:
            best = (float(gap[i, j]), int(i), begin + int(j))
    gap_m, index, at = best
    pair = point_to_segment(points_m[at], capsules.start_m[index], capsules.end_m[index])
    direction = _unit_or_any(pair.first - pair.second)
    return _outside(capsules, index, pair.second, direction, gap_m)


def _to_mesh(capsules: Capsules, mesh: Mesh) -> Separation:
    triangles = mesh.triangles_m
    capsule, face = _candidates(capsules, triangles)
    pair = segment_to_triangle(capsules.start_m[capsule], capsules.end_m[capsule], triangles[face])
    gap = pair.distance - capsules.radius_m[capsule]
    at = int(np.argmin(gap))
    index = int(capsule[at])
    reaching = _reaching_inside(capsules, triangles, np.unique(capsule[pair.distance <= TOUCH_M]))
    if len(reaching):
        return min(
            (_deepest(capsules, int(k), triangles) for k in reaching), key=lambda found: found.distance_m
        )
    if pair.distance[at] <= TOUCH_M:  # an end touches from outside
        corners = triangles[face[at]]
        direction = -_unit_or_any(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    else:
        direction = (pair.second[at] - pair.first[at]) / pair.distance[at]
    return _outside(capsules, index, pair.first[at], direction, float(gap[at]))


def _candidates(capsules: Capsules, triangles: Array) -> tuple[Indices, Indices]:
    """Pairs of capsule and triangle that can hold the shortest separation, by the triangles' bounding spheres."""
    centre = triangles.mean(1)
    reach = np.linalg.norm(triangles - centre[:, None], axis=-1).max(1)
    to_axis = point_to_segment(centre[None], capsules.start_m[:, None], capsules.end_m[:, None]).distance
    upper = to_axis - capsules.radius_m[:, None]
    # A pierced triangle is kept too: its capsule may be the deepest without being the nearest.
    keep = (upper - reach <= upper.min()) | (to_axis <= reach)
    capsule, face = np.nonzero(keep)
    return capsule, face


def _reaching_inside(capsules: Capsules, triangles: Array, piercing: Indices) -> Indices:
    """Indices of capsules whose axis has a part inside: those that pierce the surface, and those fully inside."""
    low, high = triangles.min((0, 1)), triangles.max((0, 1))
    ends = np.stack([capsules.start_m, capsules.end_m])
    boxed = np.all((ends > low) & (ends < high), axis=-1).any(0)
    inside = np.zeros(len(capsules), np.bool_)
    for k in np.nonzero(boxed)[0]:
        inside[k] = bool((winding_number(ends[:, k], triangles) > 0.5).any())
    for k in piercing[~inside[piercing]]:
        along = np.linspace(0.0, 1.0, ZOOM_POINTS)[:, None]
        points = capsules.start_m[k] + along * (capsules.end_m[k] - capsules.start_m[k])
        inside[k] = bool((winding_number(points, triangles) > 0.5).any())
    return np.nonzero(inside)[0]


def _deepest(capsules: Capsules, index: int, triangles: Array) -> Separation:
    """The axis's deepest point inside a mesh: unique in a convex one, where the depth is concave along a line."""
    start, along = capsules.start_m[index], capsules.end_m[index] - capsules.start_m[index]
    low, high = 0.0, 1.0
    bounded_by_inside = False
    for _ in range(ZOOM_ROUNDS):
        t = np.linspace(low, high, ZOOM_POINTS)
        points = start + t[:, None] * along
        nearest, distance = _nearest_on(points, triangles)
        # Between two points inside all are inside: only the first rounds, which cost most, must ask for each.
        inside = np.ones(len(t), np.bool_) if bounded_by_inside else winding_number(points, triangles) > 0.5
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


def _nearest_on(points: Array, triangles: Array) -> tuple[Array, Array]:
    """Nearest surface points, shape (n, 3), and distances, shape (n,), of points close to one another.

    A triangle farther from the points' middle than the nearest one, by more than bounding spheres explain, is no
    candidate for any of them.
    """
    middle = points.mean(0)
    spread = float(np.linalg.norm(points - middle, axis=1).max())
    centre = triangles.mean(1)
    reach = np.linalg.norm(triangles - centre[:, None], axis=-1).max(1)
    to_centre = np.linalg.norm(centre - middle, axis=1)
    near = triangles[to_centre - reach <= to_centre.min() + 2.0 * spread]
    nearest, distance = np.empty_like(points), np.empty(len(points))
    step = max(1, CHUNK // (8 * len(near)))
    for begin in range(0, len(points), step):
        part = slice(begin, begin + step)
        pair = point_to_triangle(points[part][:, None], near[None])
        face = np.argmin(pair.distance, axis=1)
        rows = np.arange(len(face))
        nearest[part], distance[part] = pair.second[rows, face], pair.distance[rows, face]
    return nearest, distance


def _outside(
    capsules: Capsules, index: int, on_axis: Array, direction: Array, distance_m: float
) -> Separation:
    on_instrument = on_axis + capsules.radius_m[index] * direction
    return Separation(distance_m, direction, on_instrument, on_instrument + distance_m * direction, index)


def _unit_or_any(vector: Array) -> Array:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 0.0 else np.array([0.0, 0.0, 1.0])

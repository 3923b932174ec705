"""The shortest separation between capsules and a surface, or other capsules, signed and with its direction.

Outside, the distance is that of the axis less the radius. Where an axis reaches into a solid (half-space, closed
mesh), the depth of its deepest point counts below zero, and the radius on top: the distance goes through zero without
a jump, and its derivative along `direction` is -1 on both sides.

Of a mesh only faces with a centroid near enough are looked at: no farther than the nearest centroid and the face's own
reach. Angle-weighted pseudonormals give the sign (Bærentzen and Aanæs 2005).
Closest points are those of C. Ericson, *Real-Time Collision Detection*, sec. 5.1: each pair of features is solved and
the nearest taken, which has no branches and loses no digits where features are parallel. Everything broadcasts over
leading axes; points have shape (..., 3), in one frame, in m.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from svmdist.geometry import Capsules, Mesh, Plane, Surface
from svmdist.tracks import Mask
from svmdist.transforms import Array, cross

Indices = NDArray[np.intp]

TOUCH_M = 1e-12
ROUGH_M = 1e-6  # error of a distance by matrix products: its square loses 1e-16 of the scene's size squared
PARALLEL = 1e-14  # squared sine of the angle of parallel lines, of which an end is a closest point
ZOOM_POINTS, ZOOM_ROUNDS = 33, 8  # grid for the deepest point, 16-fold finer a round: 0.3 m to 1e-10 m


@dataclass(frozen=True, slots=True)
class Separation:
    """The shortest separation: `distance_m` (negative: penetration depth) along `direction`, shape (3,).

    `direction` is a unit vector from instrument to tissue: moving the instrument along it lessens the distance.
    The points, shape (3,), satisfy `on_tissue_m = on_instrument_m + distance_m * direction`.
    """

    distance_m: float
    direction: Array
    on_instrument_m: Array
    on_tissue_m: Array


def separation(capsules: Capsules, surface: Surface) -> Separation:
    """Shortest separation between capsules and a surface in the same frame; a mesh must be closed."""
    if isinstance(surface, Mesh):
        return _to_mesh(capsules, surface)
    if isinstance(surface, Plane):
        ends = np.stack([capsules.start_m, capsules.end_m])  # (2, n, 3): the height is least at an end
        height_m = ends @ surface.normal - surface.offset_m - capsules.radius_m
        side, index = np.unravel_index(np.argmin(height_m), height_m.shape)
        return _outside(capsules, int(index), ends[side, index], -surface.normal, float(height_m[side, index]))
    if len(surface.points_m) == 0:
        raise ValueError("a cloud without points has no distance")
    rough = distances_to_axes(surface.points_m, capsules) - capsules.radius_m[:, None]
    near, at = np.nonzero(rough <= rough.min() + 2.0 * ROUGH_M)
    on_axis = _on_segment(surface.points_m[at], capsules.start_m[near], capsules.end_m[near])
    away = surface.points_m[at] - on_axis
    gap = _lengths(away) - capsules.radius_m[near]
    k = int(np.argmin(gap))
    return _outside(capsules, int(near[k]), on_axis[k], _unit_or_any(away[k]), float(gap[k]))


def capsule_separation(instrument: Capsules, other: Capsules) -> Separation:
    """Shortest separation between two sets of capsules; `other` is in the tissue's place."""
    pair = segment_to_segment(
        instrument.start_m[:, None], instrument.end_m[:, None], other.start_m[None], other.end_m[None]
    )
    gap = pair.distance - instrument.radius_m[:, None] - other.radius_m[None]
    i, j = np.unravel_index(int(np.argmin(gap)), gap.shape)
    if pair.distance[i, j] > TOUCH_M:
        direction = (pair.second[i, j] - pair.first[i, j]) / pair.distance[i, j]
    else:  # the axes cross: apart is along their common perpendicular
        along = instrument.end_m[i] - instrument.start_m[i]
        direction = _unit_or_any(cross(along, other.end_m[j] - other.start_m[j]))
    return _outside(instrument, int(i), pair.first[i, j], direction, float(gap[i, j]))


def _to_mesh(capsules: Capsules, mesh: Mesh) -> Separation:
    radius_m = capsules.radius_m
    rough = distances_to_axes(mesh.middles_m, capsules)
    upper_m = float((rough.min(1) - radius_m).min())
    # A face that an axis may pierce counts too: its capsule may be the deepest without being the nearest.
    capsule, face = _near_faces(capsules, mesh, rough, np.maximum(radius_m + upper_m, 0.0))
    corners = mesh.triangles_m[face]
    pair = segment_to_triangle(capsules.start_m[capsule], capsules.end_m[capsule], corners)
    gap = pair.distance - radius_m[capsule]
    # Axes that reach inside: with an end there, or through a face.
    ends = np.concatenate([capsules.start_m, capsules.end_m])
    low, high = mesh.vertices_m.min(0), mesh.vertices_m.max(0)
    in_box = np.flatnonzero(((ends > low) & (ends < high)).all(-1))
    if len(in_box):
        in_box = in_box[signed_distances(ends[in_box], mesh)[1] < 0.0]
    inside = np.union1d(in_box % len(capsules), capsule[pair.distance <= TOUCH_M])
    if len(inside):
        # Depth changes along an axis by no more than the way: only some axes can hold the deepest point.
        start_m, end_m = capsules.start_m[inside], capsules.end_m[inside]
        height_m = signed_distances(0.5 * (start_m + end_m), mesh)[1] - radius_m[inside]
        inside = inside[height_m - 0.5 * _lengths(end_m - start_m) <= height_m.min()]
        found = [_deepest(capsules, int(k), mesh) for k in inside]
        if deep := [each for each in found if each is not None]:
            return min(deep, key=lambda each: each.distance_m)
    at = int(np.argmin(gap))
    if pair.distance[at] <= TOUCH_M:  # an end touches from outside
        a, b, c = corners[at]
        direction = -_unit_or_any(cross(b - a, c - a))
    else:
        direction = (pair.second[at] - pair.first[at]) / pair.distance[at]
    return _outside(capsules, int(capsule[at]), pair.first[at], direction, float(gap[at]))


def _near_faces(axes: Capsules, mesh: Mesh, rough: Array, upper_m: Array) -> tuple[Indices, Indices]:
    """Pairs of axis and face that may be within `upper_m`, shape (n,); `rough`: distances to the centroids, (n, f).

    Let u point from an axis's closest point to a centroid, at distance D. No part of the axis lies beyond that point
    along u, so that a corner that reaches back by h along u leaves the face at least D - h away.
    """
    upper_m = upper_m + 2.0 * ROUGH_M
    near = np.flatnonzero(rough <= upper_m[:, None] + mesh.reach_m)  # much faster than by rows and columns
    row, face = np.divmod(near, rough.shape[1])
    middle = mesh.middles_m[face]
    away = middle - _on_segment(middle, axes.start_m[row], axes.end_m[row])
    distance = _lengths(away)
    u = away / np.where(distance > 0.0, distance, 1.0)[:, None]
    back_m = np.einsum("pi,pki->kp", u, mesh.triangles_m[face] - middle[:, None]).min(0)
    is_near = distance + back_m <= upper_m[row]
    return row[is_near], face[is_near]


def _deepest(capsules: Capsules, index: int, mesh: Mesh) -> Separation | None:
    """The axis's deepest point inside a mesh, unique in a convex one; None for an axis that only touches the mesh."""
    start, along = capsules.start_m[index], capsules.end_m[index] - capsules.start_m[index]
    low, high = 0.0, 1.0
    for _ in range(ZOOM_ROUNDS):
        t = np.linspace(low, high, ZOOM_POINTS)
        points = start + t[:, None] * along
        nearest, height_m = signed_distances(points, mesh)
        at = int(np.argmin(height_m))
        if height_m[at] >= 0.0:
            return None
        low, high = float(t[max(at - 1, 0)]), float(t[min(at + 1, len(t) - 1)])
    inward = points[at] - nearest[at]
    if np.linalg.norm(inward) <= TOUCH_M:
        inward = along
    distance_m = float(height_m[at]) - float(capsules.radius_m[index])
    return _outside(capsules, index, points[at], _unit_or_any(inward), distance_m)


def _outside(capsules: Capsules, index: int, on_axis: Array, direction: Array, gap_m: float) -> Separation:
    on_instrument = on_axis + capsules.radius_m[index] * direction
    return Separation(gap_m, direction, on_instrument, on_instrument + gap_m * direction)


def _unit_or_any(vector: Array) -> Array:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 0.0 else np.array([0.0, 0.0, 1.0])


def signed_distances(points: Array, mesh: Mesh) -> tuple[Array, Array]:
    """Nearest points, shape (n, 3), of a closed mesh and distances, (n,), negative inside, for points, (n, 3)."""
    middle = points.mean(0, keepdims=True)
    for axes, spread_m in ((middle, float(_lengths(points - middle).max())), (points, 0.0)):
        capsules = Capsules(axes, axes, np.zeros(len(axes)))
        rough = distances_to_axes(mesh.middles_m, capsules)
        row, face = _near_faces(capsules, mesh, rough, rough.min(1) + 2.0 * spread_m)
        mesh = mesh if axes is points else Mesh(mesh.vertices_m, mesh.faces[face])
    triangle = mesh.triangles_m[face]
    pair = point_to_triangle(points[row], triangle)
    first = np.lexsort((pair.distance, row))[np.searchsorted(row, np.arange(len(points)))]
    nearest, distance = pair.second[first], pair.distance[first]
    # The faces about the nearest point: one, both at an edge, or all at a vertex, weighted by their angles there.
    about = np.nonzero(_lengths(pair.second - nearest[row]) <= TOUCH_M)[0]
    row, triangle = row[about], triangle[about]
    ahead, back = _following(triangle) - triangle, triangle[:, [2, 0, 1]] - triangle
    normals = cross(ahead, back)
    is_there = _lengths(triangle - nearest[row][:, None]) <= TOUCH_M
    angle = (np.arctan2(_lengths(normals), dot(ahead, back)) * is_there).sum(-1)
    normal, length = normals[:, 0], _lengths(normals[:, 0])
    weight = np.where(is_there.any(-1), angle, 1.0) / np.where(length > 0.0, length, 1.0)
    side = np.bincount(row, weight * dot(points[row] - nearest[row], normal), len(points))
    return nearest, np.where(side < 0.0, -distance, distance)


def distances_to_axes(points: Array, capsules: Capsules) -> Array:
    """Distances, (n, m), of capsules' axes to points, (m, 3), right within ROUGH_M: by matrix products."""
    middle = points.mean(0)
    points, start = points - middle, capsules.start_m - middle
    along = capsules.end_m - capsules.start_m
    length2 = dot(along, along)
    from_start = along @ points.T
    from_start -= dot(start, along)[:, None]
    t = from_start / np.where(length2 > 0.0, length2, 1.0)[:, None]
    np.minimum(np.maximum(t, 0.0, out=t), 1.0, out=t)
    distance2 = (-2.0 * start) @ points.T
    distance2 += dot(points, points)
    distance2 += dot(start, start)[:, None]
    from_start *= -2.0
    from_start += t * length2[:, None]
    distance2 += np.multiply(t, from_start, out=t)
    return np.asarray(np.sqrt(np.maximum(distance2, 0.0, out=distance2), out=distance2))


class ClosestPair(NamedTuple):
    """Closest points of two features, (..., 3) each, and their distance, (...)."""

    first: Array
    second: Array
    distance: Array


def segment_to_segment(start_a: Array, end_a: Array, start_b: Array, end_b: Array) -> ClosestPair:
    """Closest points of two segments: an end of either, or the feet of the common perpendicular."""
    # With an axis for the candidates: the feet, both ends of the first segment, both of the second.
    shape = np.broadcast_shapes(start_a.shape, start_b.shape)
    start_a, end_a, start_b, end_b = (np.broadcast_to(p, shape)[..., None, :] for p in (start_a, end_a, start_b, end_b))
    a, b, gap = end_a - start_a, end_b - start_b, start_b - start_a
    aa, bb, ab, a_gap, b_gap = dot(a, a), dot(b, b), dot(a, b), dot(a, gap), dot(b, gap)
    determinant = aa * bb - ab * ab
    skew = determinant > PARALLEL * aa * bb
    safe = np.where(skew, determinant, 1.0)
    s = (a_gap * bb - b_gap * ab) / safe
    t = (a_gap * ab - b_gap * aa) / safe
    inside = skew & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    ends_a, ends_b = np.concatenate([start_a, end_a], -2), np.concatenate([start_b, end_b], -2)
    first = np.concatenate([start_a + s[..., None] * a, ends_a, _on_segment(ends_b, start_a, end_a)], -2)
    second = np.concatenate([start_b + t[..., None] * b, _on_segment(ends_a, start_b, end_b), ends_b], -2)
    return _nearest(first, second, inside)


def point_to_triangle(point: Array, triangle: Array) -> ClosestPair:
    """Closest point of triangles, shape (..., 3, 3) with a corner a row, to points."""
    foot, inside = _foot_on_face(point[..., None, :], triangle)
    on_edges = _on_segment(point[..., None, :], triangle, _following(triangle))
    second = np.concatenate([foot, on_edges], -2)
    return _nearest(np.broadcast_to(point[..., None, :], second.shape), second, inside)


def segment_to_triangle(start: Array, end: Array, triangle: Array) -> ClosestPair:
    """Closest points of segments and triangles; zero distance where a segment pierces its triangle."""
    # Where segments cross the triangles' planes, and whether they do.
    a, b, c = np.moveaxis(triangle, -2, 0)
    normal = cross(b - a, c - a)
    height_start, height_end = dot(start - a, normal), dot(end - a, normal)
    drop = height_start - height_end
    crosses = (height_start * height_end <= 0.0) & (drop != 0.0)
    t = np.where(crosses, height_start / np.where(crosses, drop, 1.0), 0.0)
    crossing = start + t[..., None] * (end - start)
    points = np.stack(np.broadcast_arrays(crossing, start, end), -2)
    on_face, inside = _foot_on_face(points, triangle)
    inside[..., 0] &= crosses
    on_face[..., 0, :] = crossing
    edges = segment_to_segment(start[..., None, :], end[..., None, :], triangle, _following(triangle))
    first = np.concatenate([points, edges.first], -2)
    return _nearest(first, np.concatenate([on_face, edges.second], -2), inside)


def dot(a: Array, b: Array) -> Array:
    """Scalar products along the last axis."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def _lengths(vectors: Array) -> Array:
    return np.asarray(np.sqrt(dot(vectors, vectors)))


def _following(triangle: Array) -> Array:
    return np.asarray(triangle[..., [1, 2, 0], :])


def _on_segment(point: Array, start: Array, end: Array) -> Array:
    """Closest point of the segments to the points; a segment may have no length."""
    along = end - start
    length2 = dot(along, along)
    t = dot(point - start, along) / np.where(length2 > 0.0, length2, 1.0)
    return np.asarray(start + np.minimum(np.maximum(t, 0.0), 1.0)[..., None] * along)


def _foot_on_face(points: Array, triangle: Array) -> tuple[Array, Mask]:
    """Feet of points, shape (..., k, 3), on the triangles' planes, and whether they lie inside the triangles."""
    a = triangle[..., :1, :]
    edges = _following(triangle) - triangle
    normal = cross(edges[..., :1, :], -edges[..., 2:, :])
    area2 = dot(normal, normal)
    safe = np.where(area2 > 0.0, area2, 1.0)
    foot = points - (dot(points - a, normal) / safe)[..., None] * normal
    # (edge x (foot - corner)) · normal = (normal x edge) · (foot - corner)
    inwards = cross(normal, edges)[..., None, :, :]
    sides = dot(foot[..., :, None, :] - triangle[..., None, :, :], inwards)
    return foot, (area2 > 0.0) & (sides >= 0.0).all(-1)


def _nearest(first: Array, second: Array, valid: Mask) -> ClosestPair:
    """The nearest of k candidates, shape (..., k, 3), of which the first ones may be invalid; the first of several."""
    apart = first - second
    distance2 = dot(apart, apart)
    distance2[..., : valid.shape[-1]][~valid] = np.inf
    best = np.argmin(distance2, -1)[..., None]
    distance = np.sqrt(np.take_along_axis(distance2, best, -1)[..., 0])
    first, second = (np.take_along_axis(ends, best[..., None], -2)[..., 0, :] for ends in (first, second))
    return ClosestPair(first, second, distance)

"""Closest points between points, segments and triangles: pairs of arrays in, arrays out.

Every function broadcasts over the leading axes. Points have shape (..., 3), in one frame and one unit.
C. Ericson, *Real-Time Collision Detection*, sec. 5.1, has the cases; here each pair of features is
solved and the nearest taken, which has no branches and loses no digits where features are parallel.
All pairs of features of a kind are solved in one step: for the few pairs that are left after pruning, the time
goes into the number of NumPy's calls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.transforms import Array

PARALLEL = 1e-14
"""Squared sine of the angle below which two lines count as parallel: an end is a closest point then."""


@dataclass(frozen=True, slots=True)
class ClosestPair:
    """Closest points of two features, shape (..., 3) each, and their distance, shape (...)."""

    first: Array
    second: Array
    distance: Array


def point_to_segment(point: Array, start: Array, end: Array) -> ClosestPair:
    """Closest point of the segments to the points; a segment may have no length."""
    on_segment = _on_segment(point, start, end)
    return _pair(np.broadcast_to(point, on_segment.shape), on_segment)


def segment_to_segment(start_a: Array, end_a: Array, start_b: Array, end_b: Array) -> ClosestPair:
    """Closest points of two segments: an end of either, or the feet of the common perpendicular."""
    start_a, end_a, start_b, end_b = np.broadcast_arrays(start_a, end_a, start_b, end_b)
    foot_a, foot_b, inside = _feet(start_a, end_a, start_b, end_b)
    ends_a, ends_b = np.stack([start_a, end_a], -2), np.stack([start_b, end_b], -2)
    ends_a_on_b = _on_segment(ends_a, start_b[..., None, :], end_b[..., None, :])
    ends_b_on_a = _on_segment(ends_b, start_a[..., None, :], end_a[..., None, :])
    return _nearest(
        np.concatenate([foot_a[..., None, :], ends_a, ends_b_on_a], -2),
        np.concatenate([foot_b[..., None, :], ends_a_on_b, ends_b], -2),
        _only(inside[..., None], 5),
    )


def point_to_triangle(point: Array, triangle: Array) -> ClosestPair:
    """Closest point of triangles, shape (..., 3, 3) with a corner a row, to points."""
    foot, inside = _foot_on_face(point[..., None, :], triangle)
    on_edges = _on_segment(point[..., None, :], triangle, _following(triangle))
    second = np.concatenate([foot, on_edges], -2)
    first = np.broadcast_to(point[..., None, :], second.shape)
    return _nearest(first, second, _only(inside, 4))


def segment_to_triangle(start: Array, end: Array, triangle: Array) -> ClosestPair:
    """Closest points of segments and triangles; zero distance where a segment pierces its triangle."""
    shape = np.broadcast_shapes(start.shape, end.shape, (*triangle.shape[:-2], 3))
    start, end = np.broadcast_to(start, shape), np.broadcast_to(end, shape)
    triangle = np.broadcast_to(triangle, (*shape[:-1], 3, 3))
    ends, following = np.stack([start, end], -2), _following(triangle)
    crossing, crosses = _crossing(start, end, triangle)
    on_face, inside = _foot_on_face(np.concatenate([crossing[..., None, :], ends], -2), triangle)
    inside[..., 0] &= crosses
    on_face[..., 0, :] = crossing
    beside = (*shape[:-1], 6, 3)
    ends_on_edges = _on_segment(ends[..., :, None, :], triangle[..., None, :, :], following[..., None, :, :])
    corners_on_segment = _on_segment(triangle, start[..., None, :], end[..., None, :])
    foot, foot_on_edge, feet_inside = _feet(start[..., None, :], end[..., None, :], triangle, following)
    first = [
        crossing[..., None, :],
        ends,
        foot,
        np.broadcast_to(ends[..., :, None, :], ends_on_edges.shape).reshape(beside),
        corners_on_segment,
    ]
    second = [on_face, foot_on_edge, ends_on_edges.reshape(beside), triangle]
    valid = _only(np.concatenate([inside, feet_inside], -1), 15)
    return _nearest(np.concatenate(first, -2), np.concatenate(second, -2), valid)


def dot(a: Array, b: Array) -> Array:
    """Scalar products along the last axis."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def cross(a: Array, b: Array) -> Array:
    """Vector products along the last axis; `numpy.cross` without its checks, which cost more than the product."""
    return np.asarray(a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]])


def _on_segment(point: Array, start: Array, end: Array) -> Array:
    along = end - start
    length2 = dot(along, along)
    t = dot(point - start, along) / np.where(length2 > 0.0, length2, 1.0)
    return np.asarray(start + np.minimum(np.maximum(t, 0.0), 1.0)[..., None] * along)


def _feet(
    start_a: Array, end_a: Array, start_b: Array, end_b: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The feet of two segments' common perpendicular, and whether both lie on their segments."""
    a, b, gap = end_a - start_a, end_b - start_b, start_b - start_a
    aa, bb, ab, a_gap, b_gap = dot(a, a), dot(b, b), dot(a, b), dot(a, gap), dot(b, gap)
    determinant = aa * bb - ab * ab
    skew = determinant > PARALLEL * aa * bb
    safe = np.where(skew, determinant, 1.0)
    s = (a_gap * bb - b_gap * ab) / safe
    t = (a_gap * ab - b_gap * aa) / safe
    inside = skew & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    return start_a + s[..., None] * a, start_b + t[..., None] * b, inside


def _foot_on_face(points: Array, triangle: Array) -> tuple[Array, NDArray[np.bool_]]:
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


def _crossing(start: Array, end: Array, triangle: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Where segments cross the triangles' planes, and whether they do."""
    a = triangle[..., 0, :]
    normal = cross(triangle[..., 1, :] - a, triangle[..., 2, :] - a)
    height_start, height_end = dot(start - a, normal), dot(end - a, normal)
    drop = height_start - height_end
    crosses = (height_start * height_end <= 0.0) & (drop != 0.0)
    t = np.where(crosses, height_start / np.where(crosses, drop, 1.0), 0.0)
    return start + t[..., None] * (end - start), crosses


def _following(triangle: Array) -> Array:
    return np.asarray(triangle[..., [1, 2, 0], :])


def _only(valid: NDArray[np.bool_], count: int) -> NDArray[np.bool_]:
    """Which of `count` candidates count: the first ones as told, all others always."""
    all_valid = np.ones((*valid.shape[:-1], count), np.bool_)
    all_valid[..., : valid.shape[-1]] = valid
    return all_valid


def _pair(first: Array, second: Array) -> ClosestPair:
    apart = first - second
    return ClosestPair(first, second, np.asarray(np.sqrt(dot(apart, apart))))


def _nearest(first: Array, second: Array, valid: NDArray[np.bool_]) -> ClosestPair:
    """The nearest of k candidates, shapes (..., k, 3) and (..., k); the first one of several."""
    apart = first - second
    distance2 = np.where(valid, dot(apart, apart), np.inf)
    best = np.argmin(distance2, -1)[..., None]
    distance = np.sqrt(np.take_along_axis(distance2, best, -1)[..., 0])
    best = best[..., None]
    return ClosestPair(
        np.take_along_axis(first, best, -2)[..., 0, :],
        np.take_along_axis(second, best, -2)[..., 0, :],
        distance,
    )

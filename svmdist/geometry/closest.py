"""Closest points between points, segments and triangles: pairs of arrays in, arrays out.

Every function broadcasts over the leading axes. Points have shape (..., 3), in one frame and one unit.
C. Ericson, *Real-Time Collision Detection*, sec. 5.1, has the cases; here each pair of features is
solved and the nearest taken, which has no branches and loses no digits where features are parallel.
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
    along = end - start
    length2 = _dot(along, along)
    t = np.clip(_dot(point - start, along) / np.where(length2 > 0.0, length2, 1.0), 0.0, 1.0)
    on_segment = start + t[..., None] * along
    return _pair(np.broadcast_to(point, on_segment.shape), on_segment)


def segment_to_segment(start_a: Array, end_a: Array, start_b: Array, end_b: Array) -> ClosestPair:
    """Closest points of two segments: an end of either, or the feet of the common perpendicular."""
    a, b, gap = end_a - start_a, end_b - start_b, start_b - start_a
    aa, bb, ab = _dot(a, a), _dot(b, b), _dot(a, b)
    determinant = aa * bb - ab * ab
    skew = determinant > PARALLEL * aa * bb
    safe = np.where(skew, determinant, 1.0)
    s = (_dot(a, gap) * bb - _dot(b, gap) * ab) / safe
    t = (_dot(a, gap) * ab - _dot(b, gap) * aa) / safe
    inside = skew & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    feet = _pair(start_a + s[..., None] * a, start_b + t[..., None] * b)
    feet = ClosestPair(feet.first, feet.second, np.where(inside, feet.distance, np.inf))
    return _nearest(
        feet,
        point_to_segment(start_a, start_b, end_b),
        point_to_segment(end_a, start_b, end_b),
        _swap(point_to_segment(start_b, start_a, end_a)),
        _swap(point_to_segment(end_b, start_a, end_a)),
    )


def point_to_triangle(point: Array, triangle: Array) -> ClosestPair:
    """Closest point of triangles, shape (..., 3, 3) with a corner a row, to points."""
    a, b, c = triangle[..., 0, :], triangle[..., 1, :], triangle[..., 2, :]
    foot, inside = _foot_on_face(point, triangle)
    face = _pair(np.broadcast_to(point, foot.shape), foot)
    face = ClosestPair(face.first, face.second, np.where(inside, face.distance, np.inf))
    return _nearest(
        face, point_to_segment(point, a, b), point_to_segment(point, b, c), point_to_segment(point, c, a)
    )


def segment_to_triangle(start: Array, end: Array, triangle: Array) -> ClosestPair:
    """Closest points of segments and triangles; zero distance where a segment pierces its triangle."""
    a, b, c = triangle[..., 0, :], triangle[..., 1, :], triangle[..., 2, :]
    return _nearest(
        _piercing(start, end, triangle),
        point_to_triangle(start, triangle),
        point_to_triangle(end, triangle),
        segment_to_segment(start, end, a, b),
        segment_to_segment(start, end, b, c),
        segment_to_segment(start, end, c, a),
    )


def winding_number(point: Array, triangles: Array) -> Array:
    """How often a mesh, shape (f, 3, 3), wraps around points, shape (n, 3): 1 inside, 0 outside.

    Sum of the signed solid angles over 4π (van Oosterom and Strackee 1983; Jacobson 2013); the faces' corners
    run counter-clockwise seen from outside.
    """
    corners = triangles[None] - point[:, None, None, :]
    lengths = np.linalg.norm(corners, axis=-1)
    a, b, c = (corners[..., k, :] for k in range(3))
    la, lb, lc = (lengths[..., k] for k in range(3))
    above = _dot(a, np.cross(b, c))
    below = la * lb * lc + _dot(a, b) * lc + _dot(b, c) * la + _dot(c, a) * lb
    return np.asarray(np.arctan2(above, below).sum(-1) / (2.0 * np.pi))


def _foot_on_face(point: Array, triangle: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The points' feet on the triangles' planes, and whether they lie inside the triangles."""
    a, b, c = triangle[..., 0, :], triangle[..., 1, :], triangle[..., 2, :]
    normal = np.cross(b - a, c - a)
    area2 = _dot(normal, normal)
    safe = np.where(area2 > 0.0, area2, 1.0)
    foot = point - (_dot(point - a, normal) / safe)[..., None] * normal
    sides = [_dot(np.cross(q - p, foot - p), normal) for p, q in ((a, b), (b, c), (c, a))]
    inside = (area2 > 0.0) & (sides[0] >= 0.0) & (sides[1] >= 0.0) & (sides[2] >= 0.0)
    return foot, inside


def _piercing(start: Array, end: Array, triangle: Array) -> ClosestPair:
    a, b, c = triangle[..., 0, :], triangle[..., 1, :], triangle[..., 2, :]
    normal = np.cross(b - a, c - a)
    height_start, height_end = _dot(start - a, normal), _dot(end - a, normal)
    drop = height_start - height_end
    crosses = (height_start * height_end <= 0.0) & (drop != 0.0)
    t = np.where(crosses, height_start / np.where(crosses, drop, 1.0), 0.0)
    point = start + t[..., None] * (end - start)
    _, inside = _foot_on_face(point, triangle)
    return ClosestPair(point, point, np.where(crosses & inside, 0.0, np.inf))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", a, b))


def _pair(first: Array, second: Array) -> ClosestPair:
    return ClosestPair(first, second, np.asarray(np.linalg.norm(first - second, axis=-1)))


def _swap(pair: ClosestPair) -> ClosestPair:
    return ClosestPair(pair.second, pair.first, pair.distance)


def _nearest(*pairs: ClosestPair) -> ClosestPair:
    shape = np.broadcast_shapes(*(pair.distance.shape for pair in pairs))
    best = np.broadcast_to(pairs[0].distance, shape)
    first = np.broadcast_to(pairs[0].first, (*shape, 3))
    second = np.broadcast_to(pairs[0].second, (*shape, 3))
    for pair in pairs[1:]:
        nearer = pair.distance < best
        best = np.where(nearer, pair.distance, best)
        first = np.where(nearer[..., None], pair.first, first)
        second = np.where(nearer[..., None], pair.second, second)
    return ClosestPair(first, second, best)

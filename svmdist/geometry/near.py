"""What can hold the shortest separation: bounds leave out the capsules, faces and points that cannot.

Of 24 capsules and 2,000 faces some twenty pairs are left, whose closest points are then computed exactly.
"""

from __future__ import annotations

import numpy as np

from svmdist.geometry.closest import dot, point_to_segment, point_to_triangle
from svmdist.geometry.patches import Indices
from svmdist.geometry.surfaces import Capsules, Mesh
from svmdist.transforms import Array

CHUNK = 1 << 20
"""Pairs that are held at once: about 100 MB of temporaries."""
TOUCH_M = 1e-12
ROUGH_M = 1e-6
"""A distance by matrix products is right within this: its square loses 1e-16 of the square of the scene's size."""


def near_pairs(instrument: Capsules, other: Capsules) -> tuple[Indices, Indices]:
    """Pairs of capsules that can hold the shortest separation, by a ball about either one of each pair."""
    to_axis = distances_to_axes(0.5 * (other.start_m + other.end_m), instrument)
    to_other = distances_to_axes(0.5 * (instrument.start_m + instrument.end_m), other).T
    radii = instrument.radius_m[:, None] + other.radius_m[None]
    reach, reach_other = (0.5 * _lengths(each.end_m - each.start_m) for each in (instrument, other))
    lower = np.maximum(to_axis - reach_other[None], to_other - reach[:, None]) - radii
    upper = float((np.minimum(to_axis, to_other) - radii).min())
    i, j = np.nonzero(lower <= upper + 2.0 * ROUGH_M)
    return i, j


def near_faces(capsules: Capsules, mesh: Mesh) -> tuple[Indices, Array]:
    """Pairs of capsule and face that can hold the shortest separation: capsules, shape (n,), and corners (n, 3, 3).

    Let u point from the axis's closest point to a point c, at distance D. No part of the axis lies beyond that
    point along u, so that what reaches back from c by h along u is at least D - h away. A face that an axis may
    pierce is kept too: its capsule may be the deepest without being the nearest.
    """
    boxes, patches = mesh.bounds, mesh.patches
    start_m, end_m, radius_m = capsules.start_m, capsules.end_m, capsules.radius_m
    distance, u = _towards(boxes.centre_m, start_m[:, None], end_m[:, None])
    least = distance - dot(np.abs(u), boxes.half_m)
    nearest = int(np.argmin((distance - radius_m[:, None]).min(0)))
    on_surface = mesh.vertices_m[patches.vertices[:, nearest]]
    upper = float((distances_to_axes(on_surface, capsules) - radius_m[:, None]).min()) + ROUGH_M
    capsule, patch = np.nonzero((least - radius_m[:, None] <= upper) | (least <= TOUCH_M))
    capsule = np.repeat(capsule, patches.faces.shape[1])
    corners = mesh.vertices_m[mesh.faces[patches.faces[patch].ravel()]]
    centre = corners.sum(1) / 3.0
    distance, u = _towards(centre, start_m[capsule], end_m[capsule])
    least = distance + dot(u[:, None], corners - centre[:, None]).min(1)
    gap = distance - radius_m[capsule]
    keep = (least - radius_m[capsule] <= gap.min() + TOUCH_M) | (least <= TOUCH_M)
    return capsule[keep], corners[keep]


def nearest_on_mesh(points: Array, mesh: Mesh) -> tuple[Array, Array]:
    """Nearest surface points, shape (n, 3), and distances, shape (n,), of points close to one another.

    A triangle farther from the points' middle than the nearest one, by more than bounding balls explain, is no
    candidate for any of them.
    """
    middle = points.mean(0)
    spread = float(_lengths(points - middle).max())
    reach = mesh.bounds.reach_m
    to_centre = _lengths(mesh.bounds.centre_m - middle)
    patch = to_centre - reach <= (to_centre + reach).min() + 2.0 * spread
    triangles = mesh.triangles_m[np.unique(mesh.patches.faces[patch])]
    centre = triangles.sum(1) / 3.0
    reach = _lengths(triangles - centre[:, None]).max(1)
    to_centre = _lengths(centre - middle)
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


def distances_to_axes(points: Array, capsules: Capsules) -> Array:
    """Distances of all capsules' axes to all points, shape (m, 3), right within ROUGH_M: shape (n, m).

    By matrix products, about their middle: several times as fast as point by point.
    """
    middle = points.mean(0)
    points, start = points - middle, capsules.start_m - middle
    along = capsules.end_m - capsules.start_m
    length2 = dot(along, along)
    t = along @ points.T
    from_start = t - dot(start, along)[:, None]
    t = from_start / np.where(length2 > 0.0, length2, 1.0)[:, None]
    np.minimum(np.maximum(t, 0.0, out=t), 1.0, out=t)
    distance2 = start @ points.T
    distance2 *= -2.0
    distance2 += dot(points, points)
    distance2 += dot(start, start)[:, None]
    distance2 += t * (t * length2[:, None] - 2.0 * from_start)
    return np.asarray(np.sqrt(np.maximum(distance2, 0.0, out=distance2), out=distance2))


def _towards(point: Array, start: Array, end: Array) -> tuple[Array, Array]:
    """Distances of points to segments, and unit vectors to the points; zero where there is no distance."""
    pair = point_to_segment(point, start, end)
    distance = pair.distance
    return distance, (pair.first - pair.second) / np.where(distance > 0.0, distance, 1.0)[..., None]


def _lengths(vectors: Array) -> Array:
    return np.asarray(np.sqrt(dot(vectors, vectors)))

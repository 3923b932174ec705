"""Which points are inside a mesh: where its winding number exceeds a half.

Of a closed mesh the winding number is the signed number of faces that a ray from the point crosses. That needs the
faces under the ray only. Where a ray runs so close to an edge, or the point lies so close to a face, that rounding
could decide, and for an open mesh, the solid angles of all faces are summed up instead.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from svmdist.geometry.closest import cross, dot
from svmdist.geometry.surfaces import Mesh
from svmdist.transforms import Array

DOUBT = 1e-13
"""Of the mesh's size squared: an area as small as this has its sign by rounding, which is some 1e-16 of it."""
CHUNK = 1 << 20
"""Pairs of point and face that are held at once: about 100 MB of temporaries."""


def contains(mesh: Mesh, points: Array) -> NDArray[np.bool_]:
    """Whether points, shape (n, 3), are inside the mesh; shape (n,)."""
    points = np.asarray(points)
    bounds = mesh.bounds
    low, high = bounds.low_m.min(0), bounds.high_m.max(0)
    inside: NDArray[np.bool_] = np.all((points > low) & (points < high), axis=-1)
    some = np.nonzero(inside)[0]
    if len(some) == 0:
        return inside
    if not mesh.is_closed:
        inside[some] = winding_number(points[some], mesh.triangles_m) > 0.5
        return inside
    turns, doubtful = _signed_crossings(mesh, points[some], 0.5 * (low + high))
    inside[some] = turns > 0
    if doubtful.any():
        inside[some[doubtful]] = winding_number(points[some[doubtful]], mesh.triangles_m) > 0.5
    return inside


def winding_number(point: Array, triangles: Array) -> Array:
    """How often a mesh, shape (f, 3, 3), wraps around points, shape (n, 3): 1 inside, 0 outside; shape (n,).

    Sum of the signed solid angles over 4π (van Oosterom and Strackee 1983; Jacobson 2013); the faces' corners
    run counter-clockwise seen from outside.
    """
    step = max(1, CHUNK // len(triangles))
    turns = [_winding(point[begin : begin + step], triangles) for begin in range(0, len(point), step)]
    return np.concatenate(turns) if turns else np.zeros(0)


def _winding(point: Array, triangles: Array) -> Array:
    corners = triangles[None] - point[:, None, None, :]
    lengths = np.sqrt(dot(corners, corners))
    a, b, c = (corners[..., k, :] for k in range(3))
    la, lb, lc = (lengths[..., k] for k in range(3))
    above = dot(a, cross(b, c))
    below = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
    return np.asarray(np.arctan2(above, below).sum(-1) / (2.0 * np.pi))


def _signed_crossings(
    mesh: Mesh, points: Array, centre: Array
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Faces that rays from points, shape (n, 3), leave through less those they enter by; and where that is in doubt.

    All rays are parallel, away from the mesh's centre: seen along them, each face is a flat triangle, and what
    crosses is the face whose triangle holds the point, and that lies before it.
    """
    axes = _axes(points.mean(0) - centre)
    vertices, points = mesh.vertices_m @ axes.T, points @ axes.T
    corners_of_patches = vertices[mesh.patches.vertices]
    low, high = corners_of_patches.min(0), corners_of_patches.max(0)
    before = (points[:, None] <= high).all(-1) & (points[:, None, :2] >= low[:, :2]).all(-1)
    at, patch = np.nonzero(before)
    width = mesh.patches.faces.shape[1]
    at, face = np.repeat(at, width), mesh.patches.faces[patch].ravel()
    a, b, c = np.moveaxis(vertices[mesh.faces[face]] - points[at][:, None], 1, 0)
    areas = np.stack([_area(b, c), _area(c, a), _area(a, b)], -1)
    whole = areas.sum(-1)
    doubt = DOUBT * float((high.max(0) - low.min(0)).max()) ** 2
    near = (areas.min(-1) > -doubt) | (areas.max(-1) < doubt)
    at, face, areas, whole = at[near], face[near], areas[near], whole[near]
    heights = np.stack([a[near, 2], b[near, 2], c[near, 2]], -1)
    doubtful = np.zeros(len(points), np.bool_)
    height = dot(areas, heights)  # times the area: its sign along the ray
    unsure = (np.abs(areas) <= doubt).any(-1) | (
        np.abs(height) <= doubt * float(np.abs(heights).max(initial=0.0))
    )
    doubtful[at[unsure & (heights.max(-1, initial=-np.inf) >= 0.0)]] = True
    crossed = ~unsure & (height * np.sign(whole) > 0.0)
    # A face stands in a patch twice where the patch was filled up: it counts once.
    key = np.unique(at[crossed] * len(mesh.faces) + face[crossed], return_index=True)[1]
    turns = np.zeros(len(points), np.int64)
    np.add.at(turns, at[crossed][key], np.sign(whole[crossed][key]).astype(np.int64))
    return turns, doubtful


def _area(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _axes(direction: Array) -> Array:
    """An orthonormal frame, its axes in the rows, whose third one is the direction; any where it has no length."""
    length = float(np.linalg.norm(direction))
    z = direction / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    x = cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, cross(z, x), z])

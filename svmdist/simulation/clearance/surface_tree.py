"""A tree over points or triangles of a surface, each node with its bounds, walked a whole level at a time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from svmdist.geometry.patches import Indices, compact_order
from svmdist.transforms import Array

BRANCHES = 4
TOP_COUNT = 16
"""Nodes of the first level, or twice as many: fewer would only add levels."""


@dataclass(frozen=True)
class Discs:
    """What holds flat pieces of a surface tightly, one for each node, in m.

    A piece lies within `half_m`, shape (n,), of the plane through its middle, shape (n, 3), with a unit normal,
    shape (n, 3), and along the plane within `spreads_m`, shape (n,), of the middle.
    """

    middles_m: Array
    normals: Array
    half_m: Array
    spreads_m: Array


@dataclass(frozen=True)
class Level:
    """Nodes of one depth, n of them, each with two bounds of the `corners_m`, shape (n, k, 3), below it.

    A ball about one of the corners (`points_m`, shape (n, 3), `radii_m`, shape (n,)), and a disc.
    """

    corners_m: Array
    points_m: Array
    radii_m: Array

    @cached_property
    def discs(self) -> Discs:
        """The discs, made when they are first asked for."""
        middles = _middles(self.corners_m)
        away = self.corners_m - middles[:, None]
        # The direction in which the corners spread least.
        normals = np.linalg.eigh(np.einsum("ijk,ijl->ikl", away, away))[1][:, :, 0]
        heights = np.einsum("ijk,ik->ij", away, normals)
        aside2 = np.maximum(np.einsum("ijk,ijk->ij", away, away) - heights**2, 0.0)
        return Discs(middles, normals, np.abs(heights).max(axis=1), np.sqrt(aside2.max(axis=1)))

    def least_m(self, points_m: Array, nodes: Indices) -> Array:
        """Lower bounds of the distances of points, shape (k, 3), to what lies below nodes, shape (k,)."""
        discs = self.discs
        away = points_m - discs.middles_m[nodes]
        height_m = np.einsum("ij,ij->i", away, discs.normals[nodes])
        aside2 = np.maximum(np.einsum("ij,ij->i", away, away) - height_m**2, 0.0)
        up_m = np.maximum(np.abs(height_m) - discs.half_m[nodes], 0.0)
        out_m = np.maximum(np.sqrt(aside2) - discs.spreads_m[nodes], 0.0)
        return np.asarray(np.sqrt(up_m**2 + out_m**2))


class SurfaceTree:
    """Items, shape (n, k, 3) with k corners each, in levels; every node has four children at the next.

    Node `i`'s children are `4 i` to `4 i + 3`; the last level's nodes are the items. Some items stand there
    twice, to fill the last level.
    """

    def __init__(self, items_m: Array) -> None:
        halvings = max(0, int(np.ceil(np.log2(len(items_m) / TOP_COUNT))))
        depth, count = halvings // 2, TOP_COUNT * 2**halvings
        self.items_m: Array = items_m[compact_order(items_m.mean(axis=1), count, count)]
        self.levels = tuple(_level(self.items_m, count // BRANCHES**up) for up in range(depth, -1, -1))

    @staticmethod
    def children(nodes: Indices) -> Indices:
        """Indices at the next level of the children of nodes, shape (n,); shape (4 n,)."""
        return np.asarray(nodes[:, None] * BRANCHES + np.arange(BRANCHES)).ravel()


def _level(items_m: Array, node_count: int) -> Level:
    corners = items_m.reshape(node_count, -1, 3)
    away = corners - _middles(corners)[:, None]
    points = corners[np.arange(node_count), np.argmin(np.einsum("ijk,ijk->ij", away, away), axis=1)]
    away = corners - points[:, None]
    return Level(corners, points, np.sqrt(np.einsum("ijk,ijk->ij", away, away).max(axis=1)))


def _middles(corners_m: Array) -> Array:
    return np.asarray(0.5 * (corners_m.min(axis=1) + corners_m.max(axis=1)))

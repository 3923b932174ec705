"""The signed distance of an instrument's parts to an organ that need not be convex.

It is the least signed distance of all points of a part's surface to the organ's triangles: outside that is
the distance of the two surfaces, inside less the depth of the deepest point. It has no jump at touch. A
part's surface is sampled so densely that the organ's curvature between samples adds a few µm at most.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.geometry.closest import point_to_triangle
from svmdist.geometry.patches import Indices
from svmdist.geometry.surfaces import Mesh
from svmdist.simulation.clearance.bounds import HalfSpaces, PartBounds
from svmdist.simulation.clearance.surface_tree import SurfaceTree
from svmdist.simulation.scene import Scene
from svmdist.transforms import Array, inverse, transform_points

SPACING_M = 0.0004
"""Longest side of the triangles between samples. No point of them is farther than 0.23 mm from a sample; that
far aside, a vessel's crest at a relief of 0.5 mm (radius 2 mm) has fallen by 13 µm, the rest by less."""
REACH_M = 0.07
"""A shaft comes in from above, and the organ is 62 mm long at most: what is farther behind the link's origin
is never the nearest."""
TIE_M = 1e-10
"""Triangles that share an edge or a corner are equally far from a point that is nearest to it."""
CELL_M = 0.0005
"""Of the grid that tells which points may be below the surface."""
BATCH = 64
SLACK_M = 1e-9
"""Bounds count as so much lower, for rounding."""


@dataclass(frozen=True)
class Nearest:
    """Where the smallest distance was found: index of the part, its sample, shape (3,), and the triangle."""

    part: int
    sample_m: Array
    triangle: int


class PartSamples:
    """The surfaces of a scene's instrument as samples, each part's made when they are first asked for; its bounds.

    A fiducial plate is a part.
    """

    def __init__(self, scene: Scene) -> None:
        parts: list[tuple[str, Mesh]] = [(part.link, part.mesh) for part in scene.parts]
        if scene.plate is not None:
            parts.append((scene.plate.link, scene.plate.mesh.transformed(scene.plate.T_link_tag)))
        self._meshes = [mesh for _, mesh in parts]
        self._trees: dict[int, SurfaceTree] = {}
        self.bounds = PartBounds.of(parts)

    def __getitem__(self, part: int) -> SurfaceTree:
        """The samples of a part by its number, in the frame of its link."""
        if part not in self._trees:
            self._trees[part] = sample_part(self._meshes[part])
        return self._trees[part]

    def below_m(self, part: int, T_tissue_part: Array, height_m: float) -> Array:
        """Samples of a part in the tissue frame, shape (n, 3): all that are below a height, and some above it."""
        samples = self[part]
        top = samples.levels[0]
        low = transform_points(T_tissue_part, top.points_m)[:, 2] - top.radii_m < height_m
        points_m = samples.items_m.reshape(len(low), -1, 3)[low].reshape(-1, 3)
        return transform_points(T_tissue_part, points_m)


class ReliefMeter:
    """Measures clearances of one scene whose organ is not convex, or has another surface than at rest.

    `surface`, in the tissue frame, takes the place of the organ's mesh; `samples` may be shared between meters.
    """

    def __init__(self, scene: Scene, samples: PartSamples | None = None, surface: Mesh | None = None) -> None:
        mesh = surface or scene.organ.mesh
        self._scene = scene
        self._organ = OrganSurface(mesh)
        self._T_tissue_world = inverse(scene.T_world_tissue)
        self._parts = samples or PartSamples(scene)
        self._bounds = self._parts.bounds
        self._half_spaces = HalfSpaces.about(mesh.vertices_m)
        self._nearest: Nearest | None = None

    def clearance_m(self, q: Array) -> float:
        """Smallest distance in m at joints `q`, shape (n_joints,); negative is penetration depth."""
        return float(self.clearances_m(q[None])[0])

    def clearances_m(self, q: Array, rise_m: Array | None = None) -> Array:
        """Smallest distances in m, shape (n,), at joints `q`, shape (n, n_joints), which are best in the order of time.

        `rise_m`, shape (n,), is how far the tissue has risen from its place at rest.

        They do not depend on what was measured before, not even in the last bit.
        """
        self._nearest = None
        T_tissue_part = self._T_tissue_world @ self._bounds.stacked(seen_from_tissue(self._scene, q, rise_m))
        least_m = self._bounds.least_m(T_tissue_part, self._half_spaces)
        return np.array([self._smallest_m(*each) for each in zip(T_tissue_part, least_m, strict=True)])

    def _smallest_m(self, T_tissue_part: Array, least_m: Array) -> float:
        """The clearance with parts at poses, shape (k, 4, 4), which are no nearer than bounds, shape (k,)."""
        # Where the nearest place was in the last pose is a bound for this one, and most often a close one.
        last, best_m = self._nearest, np.inf
        if last is not None:
            point_m = transform_points(T_tissue_part[last.part], last.sample_m[None])
            best_m = self._organ.distance_m(point_m, np.array([last.triangle]))
        for part in np.argsort(least_m).tolist():
            if least_m[part] - SLACK_M >= best_m:
                break
            found = self._organ.nearest(self._parts[part], T_tissue_part[part], best_m)
            if found is not None:
                best_m, sample_m, triangle = found
                self._nearest = Nearest(part, sample_m, triangle)
        if best_m >= SPACING_M:  # a surface that crosses the organ's has samples nearer than that
            return best_m
        low = np.nonzero(least_m <= SLACK_M)[0]
        depth_m = max(
            (self._organ.depth_m(self._parts, part, T_tissue_part[part]) for part in low.tolist()),
            default=0.0,
        )
        return -depth_m if depth_m > 0.0 else best_m


def seen_from_tissue(scene: Scene, q: Array, rise_m: Array | None) -> dict[str, Array]:
    """Poses of all links, shape (n, 4, 4), in a world that moves with the tissue: there the tissue is at rest."""
    poses = scene.link_poses(q)
    if rise_m is None:
        return poses
    for T_world_link in poses.values():
        T_world_link[:, 2, 3] -= rise_m
    return poses


class OrganSurface:
    """The organ's triangles in the tissue frame, for signed distances of points and of parts."""

    def __init__(self, mesh: Mesh) -> None:
        self.tree = SurfaceTree(mesh.vertices_m[mesh.faces])
        triangles = self.tree.items_m
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        self._normals: Array = normals / _lengths(normals)[:, None]
        self._low_m, self._roof_m = _roof(triangles)

    def distance_m(self, points_m: Array, triangles: Indices) -> float:
        """The smallest distance between points, shape (k, 3), and triangles, shape (k,), pair by pair."""
        return float(point_to_triangle(points_m, self.tree.items_m[triangles]).distance.min())

    def depth_m(self, samples: PartSamples, part: int, T_tissue_part: Array) -> float:
        """How deep the part's deepest sample lies below the surface; zero where none does."""
        points_m = samples.below_m(part, T_tissue_part, float(self._roof_m.max()))
        below_roof_m = self._below_roof_m(points_m)
        order = np.argsort(-below_roof_m)
        deepest_m = 0.0
        for begin in range(0, len(order), BATCH):
            some = order[begin : begin + BATCH]
            some = some[below_roof_m[some] > deepest_m]  # no point is deeper than below what is above it
            if len(some) == 0:
                break
            deepest_m = max(deepest_m, -float(self.signed_distances_m(points_m[some]).min()))
        return deepest_m

    def signed_distances_m(self, points_m: Array) -> Array:
        """Distances of points, shape (n, 3), to the surface, negative below it; shape (n,)."""
        upper = np.full(len(points_m), np.inf)
        i = np.repeat(np.arange(len(points_m)), len(self.tree.levels[0].radii_m))
        j = np.tile(np.arange(len(self.tree.levels[0].radii_m)), len(points_m))
        for level in self.tree.levels:
            np.minimum.at(upper, i, _lengths(points_m[i] - level.points_m[j]))
            keep = level.least_m(points_m[i], j) <= upper[i] + TIE_M
            i, j = i[keep], j[keep]
            if level is not self.tree.levels[-1]:
                i, j = np.repeat(i, 4), SurfaceTree.children(j)
        distance = point_to_triangle(points_m[i], self.tree.items_m[j]).distance
        smallest = np.full(len(points_m), np.inf)
        np.minimum.at(smallest, i, distance)
        nearest = distance <= smallest[i] + TIE_M
        return np.asarray(smallest * self._sides(points_m, i[nearest], j[nearest]))

    def _sides(self, points_m: Array, i: Indices, j: Indices) -> Array:
        """Which side of the surface points lie on, -1 below it; triangles `j` are the nearest to points `i`.

        At an edge or a corner, that triangle tells whose plane is farthest from the point.
        """
        heights = np.einsum("ij,ij->i", points_m[i] - self.tree.items_m[j, 0], self._normals[j])
        order = np.argsort(np.abs(heights), kind="stable")
        side = np.ones(len(points_m))
        side[i[order]] = np.where(heights[order] < 0.0, -1.0, 1.0)  # of several for a point, the last stays
        return side

    def nearest(
        self, part: SurfaceTree, T_tissue_part: Array, below_m: float
    ) -> tuple[float, Array, int] | None:
        """The smallest distance of samples and triangles, unsigned, with the two; None where not below that."""
        best_m = below_m
        a, b = 0, 0
        i, j = (
            side.ravel()
            for side in np.indices((len(part.levels[0].radii_m), len(self.tree.levels[0].radii_m)))
        )
        while True:
            mine, organ = part.levels[a], self.tree.levels[b]
            points_m = transform_points(T_tissue_part, mine.points_m[i])
            apart_m = _lengths(points_m - organ.points_m[j])
            best_m = min(best_m, float(apart_m.min()))
            keep = np.nonzero(apart_m - mine.radii_m[i] - organ.radii_m[j] <= best_m)[0]
            keep = keep[organ.least_m(points_m[keep], j[keep]) - mine.radii_m[i[keep]] <= best_m]
            i, j = i[keep], j[keep]
            if len(i) == 0:
                return None
            divide_a, divide_b = a + 1 < len(part.levels), b + 1 < len(self.tree.levels)
            if not (divide_a or divide_b):
                break
            # What leaves more doubt is divided.
            if divide_a and (not divide_b or mine.radii_m[i].max() >= organ.discs.half_m[j].max()):
                i, j, a = SurfaceTree.children(i), np.repeat(j, 4), a + 1
            else:
                i, j, b = np.repeat(i, 4), SurfaceTree.children(j), b + 1
        distances_m = point_to_triangle(points_m[keep], self.tree.items_m[j]).distance
        at = int(np.argmin(distances_m))
        found_m = float(distances_m[at])
        return (found_m, part.items_m[i[at], 0], int(j[at])) if found_m < below_m else None

    def _below_roof_m(self, points_m: Array) -> Array:
        """How far points, shape (n, 3), lie below the highest triangle of their cell of the floor; shape (n,)."""
        cell = np.floor((points_m[:, :2] - self._low_m) / CELL_M).astype(np.intp)
        known = np.all((cell >= 0) & (cell < self._roof_m.shape), axis=1)
        cell = np.where(known[:, None], cell, 0)
        return np.where(known, self._roof_m[cell[:, 0], cell[:, 1]] - points_m[:, 2], -np.inf)


def _roof(triangles_m: Array) -> tuple[Array, Array]:
    """Corner of a grid over the floor, shape (2,), and no less than the greatest height over each cell."""
    low, high = triangles_m[..., :2].min(axis=1), triangles_m[..., :2].max(axis=1)
    corner_m = low.min(axis=0)
    first, last = (np.floor((bound - corner_m) / CELL_M).astype(np.intp) for bound in (low, high))
    roof_m = np.full(last.max(axis=0) + 1, -np.inf)
    span = (last - first).max(axis=0)
    for right, up in np.ndindex(span[0] + 1, span[1] + 1):
        cell = np.minimum(first + np.array([right, up]), last)
        np.maximum.at(roof_m, (cell[:, 0], cell[:, 1]), triangles_m[..., 2].max(axis=1))
    return corner_m, roof_m


def sample_part(mesh: Mesh) -> SurfaceTree:
    """Samples of a part's surface that leave no gap wider than the spacing, as far as it can be near."""
    near = _lengths(mesh.vertices_m) < REACH_M
    faces, points_m = mesh.faces[near[mesh.faces].any(axis=1)], mesh.vertices_m
    used = np.unique(faces)
    while len(faces):
        corners_m = points_m[faces]
        sides_m = _lengths(np.roll(corners_m, -1, axis=1) - corners_m)  # corner k to the next
        long = sides_m.max(axis=1) > SPACING_M
        faces, start = faces[long], np.argmax(sides_m[long], axis=1)
        a, b, c = (faces[np.arange(len(faces)), (start + turn) % 3] for turn in range(3))
        # Triangles on both sides of an edge share its middle.
        edges, middle = np.unique(np.minimum(a, b) * len(points_m) + np.maximum(a, b), return_inverse=True)
        middle += len(points_m)
        points_m = np.vstack(
            [points_m, 0.5 * (points_m[edges // len(points_m)] + points_m[edges % len(points_m)])]
        )
        faces = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
    chosen = np.concatenate([used, np.arange(len(mesh.vertices_m), len(points_m))])
    return SurfaceTree(points_m[chosen][:, None])


def _lengths(vectors: Array) -> Array:
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)))

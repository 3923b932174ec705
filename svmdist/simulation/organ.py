"""The tissue organ of one seed: an irregular dome, lobes or an ellipsoid, distances to it, and how it is pressed in.

The tissue frame's origin is the outline's area centroid, whose projection is the centroid of the silhouette seen from
straight above. The surface is one height over each point of the plane, in rings about the apex; it is open below.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.geometry.distance import signed_distances
from svmdist.perturbations import UNPERTURBED, Perturbations
from svmdist.simulation.meshes import TEXTURE_SPAN_M, DrawnMesh, smooth_normals
from svmdist.transforms import Array, polygon_centroid

SEMI_AXES_M, HEIGHT_M = (0.028, 0.022), 0.008
DOME_EXPONENTS, ELLIPSOID_EXPONENTS = np.array([2.3, 0.62]), np.array([2.0, 0.5])  # a, b of (1 - r^a)^b
RING_COUNT, SIDE_COUNT = 44, 160
FINE_RING_COUNT, FINE_SIDE_COUNT = 72, 200  # of an organ with lobes or dents: edges of about 0.6 mm

SHAPE_STREAM = 102
OUTLINE_ORDERS = (3, 4, 5, 6)
OUTLINE_SHARE = 0.2  # of the strength of `tissue_shape`: waves of 6 % of the outline's radius at a strength of 0.3
WAVE_COUNT, WAVELENGTHS_M = 10, (0.014, 0.032)  # half of the organ to the whole of it: lobes

REACH_M = 0.012
"""A push is felt as far as this, half of it at 3.7 mm. Below a blunt punch on a deep half-space half of the depth is
left at 1.4 times its radius (Johnson 1985, Contact mechanics, sec. 3.4); a capsule under tension spreads it."""
LIMIT = 0.8  # of the organ's height at a place; then it is pressed flat against its bed, and gives way no further
SWEEPS, FINE_REACH_M = 8, 0.002
"""The pressed surface is flat between vertices, so that some µm are left inside and push again, with a small reach."""
TOLERANCE_M = 1e-6
CELL_M = 0.0003  # only the deepest push of each cell counts: those above it, and on steep sides, change nothing
CHUNK = 64  # pushes that are worked on together
KD_TREE = 4  # of OpenCV's FLANN: FLANN_INDEX_KDTREE_SINGLE, which is exact
SLACK_M = 1e-7  # the vertices are looked up in single precision


@dataclass(frozen=True, eq=False)
class Organ:
    """Mesh in the tissue frame, its outline on the floor, shape (n, 2) in m, and the height of its apex in m."""

    mesh: DrawnMesh
    outline_m: Array
    height_m: float

    def heights_m(self, xy_m: Array, z_m: Array | None = None) -> Array:
        """Heights, (n,), of triangles over points, (n, 2), -inf beside; vertices may have others, `z_m`, (v,)."""
        vertices_m, count = self.mesh.vertices_m, len(self.outline_m)
        z_m, apex_m = vertices_m[:, 2] if z_m is None else z_m, vertices_m[0, :2]
        rays_m, first_m = vertices_m[-count:, :2] - apex_m, vertices_m[1::count, :2] - apex_m
        ring_radius = np.concatenate([[0.0], first_m @ rays_m[0] / (rays_m[0] @ rays_m[0])])
        # The outline is seen from the apex in the order of its corners: it is nearly convex.
        bearing = np.unwrap(np.arctan2(rays_m[:, 1], rays_m[:, 0]))
        away = xy_m - apex_m
        turn = np.mod(np.arctan2(away[:, 1], away[:, 0]) - bearing[0], 2.0 * np.pi)
        side = np.clip(np.searchsorted(bearing - bearing[0], turn, side="right") - 1, 0, count - 1)
        a, b = rays_m[side], rays_m[(side + 1) % count]
        # A point is alpha a + beta b; alpha + beta is its normalised radius.
        across = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        alpha = (away[:, 0] * b[:, 1] - away[:, 1] * b[:, 0]) / across
        beta = (a[:, 0] * away[:, 1] - a[:, 1] * away[:, 0]) / across
        ring = np.clip(np.searchsorted(ring_radius, alpha + beta), 1, len(ring_radius) - 1)
        near, far = ring_radius[ring - 1], ring_radius[ring]

        def at(ring: NDArray[np.intp], side: NDArray[np.intp]) -> Array:
            return np.asarray(z_m[np.where(ring == 0, 0, 1 + (ring - 1) * count + side % count)])

        # The triangle on the side of `a`: inner a, outer a, outer b; and the other: inner a, outer b, inner b.
        z_near, z_far, z_far_b = at(ring - 1, side), at(ring, side), at(ring, side + 1)
        w_far_b = beta / far
        w_far = (alpha - near * (1.0 - w_far_b)) / (far - near)
        w_near = np.divide(alpha, near, out=np.zeros_like(alpha), where=near > 0.0)
        w_far_b_other = (beta - near * (1.0 - w_near)) / (far - near)
        on_a = (1.0 - w_far - w_far_b) * z_near + w_far * z_far + w_far_b * z_far_b
        on_b = w_near * z_near + w_far_b_other * z_far_b + (1.0 - w_near - w_far_b_other) * at(ring - 1, side + 1)
        return np.where(alpha + beta <= 1.0, np.where(w_far >= 0.0, on_a, on_b), -np.inf)

    def inside(self, points_m: Array) -> Array:
        """Those of the points, shape (n, 3), that lie below the surface."""
        low_m = points_m[points_m[:, 2] < self.mesh.vertices_m[:, 2].max()]
        return np.asarray(low_m[self.heights_m(low_m[:, :2]) > low_m[:, 2]])

    def bounds_m(self, points_m: Array) -> tuple[Array, Array]:
        """Lower and upper bounds of distances of points, shape (n, 3): by the nearest vertex, shape (n,) each."""
        _, squared = _vertices(self).knnSearch(points_m.astype(np.float32), 1, params={})
        nearest2 = np.asarray(squared[:, 0], np.float64)
        return np.sqrt(np.maximum(nearest2 - self._corner2_m2, 0.0)), np.sqrt(nearest2)

    def distances_m(self, points_m: Array) -> Array:
        """Exact distances of points, shape (n, 3), from the triangles; shape (n,)."""
        return np.abs(signed_distances(points_m, self.mesh)[1])  # it is open: they have no side

    def depth_m(self, points_m: Array) -> float:
        """How deep the deepest of points lies, shape (n, 3), which are all below the surface."""
        least_m, most_m = self.bounds_m(points_m)
        return float(self.distances_m(points_m[most_m >= least_m.max() - SLACK_M]).max())

    @cached_property
    def _corner2_m2(self) -> float:
        """At most |p - v|² - d², where v is a corner next to the closest point of a triangle, at d from p."""
        sides_m = np.diff(self.mesh.triangles_m, axis=1, append=self.mesh.triangles_m[:, :1])
        return float(np.linalg.norm(sides_m, axis=2).max()) ** 2 / 3.0

    def is_too_deep(self, points_m: Array) -> bool:
        """Whether some of the points, shape (n, 3), lie so deep that the organ does not give way to them."""
        return bool((self.heights_m(points_m[:, :2]) * (1.0 - LIMIT) - points_m[:, 2] > TOLERANCE_M).any())

    def dented(self, points_m: Array) -> Organ:
        """The organ under points, shape (n, 3), which are inside it at rest, and push the surface down to themselves.

        What is around goes down less and less, by the deepest push that reaches there; nothing bulges.
        """
        rest_m = self.mesh.vertices_m[:, 2]
        down_m, least_m = np.zeros_like(rest_m), (1.0 - LIMIT) * rest_m
        for sweep in range(SWEEPS):
            deep_m = self.heights_m(points_m[:, :2], rest_m - down_m) - points_m[:, 2]
            push = np.argsort(-deep_m)[: np.count_nonzero(deep_m > TOLERANCE_M)]
            if not len(push):
                break
            _, first = np.unique(np.floor(points_m[push, :2] / CELL_M), axis=0, return_index=True)
            deepest = push[first]
            down_m += self._pushed_m(points_m[deepest, :2], deep_m[deepest], FINE_REACH_M if sweep else REACH_M)
            down_m = np.minimum(down_m, rest_m - least_m)
        vertices_m = self.mesh.vertices_m.copy()
        vertices_m[:, 2] -= down_m
        normals = smooth_normals(vertices_m, self.mesh.faces)
        return replace(self, mesh=DrawnMesh(vertices_m, self.mesh.faces, normals, self.mesh.uv))

    def _pushed_m(self, xy_m: Array, by_m: Array, reach_m: float) -> Array:
        """How far vertices are pushed by points, shape (n, 2), that push so far, shape (n,): the most of all; (v,)."""
        place_m, pushed_m = self.mesh.vertices_m[:, :2], np.zeros(len(self.mesh.vertices_m))
        for begin in range(0, len(xy_m), CHUNK):
            some_m, push_m = xy_m[begin : begin + CHUNK], by_m[begin : begin + CHUNK]
            near = ((place_m > some_m.min(0) - reach_m) & (place_m < some_m.max(0) + reach_m)).all(axis=1)
            x_m, y_m = (place_m[near, axis, None] - some_m[:, axis] for axis in range(2))
            # From 1 at a point to 0 at the reach, twice differentiable (Wendland 1995, Piecewise polynomial, positive
            # definite and compactly supported radial functions).
            left = np.maximum(1.0 - np.sqrt(x_m * x_m + y_m * y_m) / reach_m, 0.0)
            share = np.square(left * left) * (5.0 - 4.0 * left)
            pushed_m[near] = np.maximum(pushed_m[near], (share * push_m).max(axis=1))
        return pushed_m


@lru_cache(maxsize=4)
def _vertices(organ: Organ) -> cv2.flann.Index:
    """The tree of an organ's vertices, which is no part of it: it cannot go to another process."""
    return cv2.flann.Index(organ.mesh.vertices_m.astype(np.float32), {"algorithm": KD_TREE})


def make_organ(rng: np.random.Generator, seed: int = 0, perturbations: Perturbations = UNPERTURBED) -> Organ:
    """Make the organ of a random stream: a convex dome, unless perturbations `tissue_*` give it another shape.

    Waves multiply the height by 1 ± `tissue_shape`; the seed draws the same ones at every strength. The organ rises no
    higher than the dome, so that scenarios keep clear of it.
    """
    strength, ellipsoid = perturbations["tissue_shape"], perturbations["tissue_ellipsoid"]
    is_fine = strength > 0.0 or perturbations["dent"] > 0.0
    ring_count, side_count = (FINE_RING_COUNT, FINE_SIDE_COUNT) if is_fine else (RING_COUNT, SIDE_COUNT)
    shape = np.random.default_rng([seed, SHAPE_STREAM])
    length_m, heading_rad = shape.uniform(*WAVELENGTHS_M, WAVE_COUNT), shape.uniform(0.0, 2.0 * np.pi, WAVE_COUNT)
    weights, phases_rad = shape.uniform(0.5, 1.0, len(OUTLINE_ORDERS)), shape.uniform(0.0, 2.0 * np.pi, WAVE_COUNT)
    outline_phases_rad = shape.uniform(0.0, 2.0 * np.pi, len(OUTLINE_ORDERS))
    angle = np.linspace(0.0, 2.0 * np.pi, side_count, endpoint=False)
    outline_m = _outline(angle, rng)
    orders = zip(OUTLINE_ORDERS, weights / weights.sum(), outline_phases_rad, strict=True)
    waves = sum(weight * np.cos(order * angle + phase) for order, weight, phase in orders)
    outline_m *= np.asarray(1.0 + strength * OUTLINE_SHARE * waves)[:, None]
    outline_m -= polygon_centroid(outline_m)
    # The apex beside the centroid, as no organ is symmetric.
    apex_m = rng.uniform(-1.0, 1.0, 2) * (0.004, 0.003)
    height_m = HEIGHT_M * rng.uniform(0.97, 1.03)
    # Rings crowd at the rim, where the dome is steep.
    radius = np.sin(np.linspace(0.0, np.pi / 2, ring_count + 1)[1:])
    inner, outer = DOME_EXPONENTS + ellipsoid * (ELLIPSOID_EXPONENTS - DOME_EXPONENTS)
    z_m = height_m * (1.0 - radius**inner) ** outer
    xy_m = apex_m + radius[:, None, None] * (outline_m - apex_m)
    rings_m = np.concatenate([xy_m, np.broadcast_to(z_m[:, None, None], (ring_count, side_count, 1))], -1)
    vertices_m = np.vstack([[*apex_m, height_m], rings_m.reshape(-1, 3)])
    vectors = 2.0 * np.pi / length_m[:, None] * np.stack([np.cos(heading_rad), np.sin(heading_rad)], -1)
    waves = np.cos(vertices_m[:, :2] @ vectors.T + phases_rad).sum(axis=1)
    vertices_m[:, 2] *= 1.0 + strength * waves / np.abs(waves).max()
    vertices_m[:, 2] *= height_m / vertices_m[:, 2].max()
    # A fan at the apex, then rings down to the floor, of two triangles between each two corners.
    here = 1 + np.arange(ring_count * side_count).reshape(ring_count, side_count)
    following = np.roll(here, -1, axis=1)
    fan = np.stack([np.zeros_like(here[0]), here[0], following[0]], -1)
    outwards = np.stack([here[:-1], here[1:], following[1:]], -1)
    inwards = np.stack([here[:-1], following[1:], following[:-1]], -1)
    faces = np.vstack([fan, np.stack([outwards, inwards], 1).reshape(-1, 3)])
    normals, uv = smooth_normals(vertices_m, faces), 0.5 + vertices_m[:, :2] / TEXTURE_SPAN_M
    return Organ(DrawnMesh(vertices_m, faces, normals, uv), outline_m, float(height_m))


def _outline(angle: Array, rng: np.random.Generator) -> Array:
    """A superellipse-like outline with two faint waves; their shares of the radius keep it convex."""
    a_m, b_m = SEMI_AXES_M
    exponent = rng.uniform(2.05, 2.2)
    summed = np.abs(np.cos(angle) / a_m) ** exponent + np.abs(np.sin(angle) / b_m) ** exponent
    waves = [share * np.cos(order * angle + rng.uniform(0.0, 2.0 * np.pi)) for order, share in ((2, 0.02), (3, 0.025))]
    radius_m = summed ** (-1.0 / exponent) * (1.0 + sum(waves))
    return np.asarray(radius_m[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1))

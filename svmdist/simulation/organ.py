"""The tissue organ of one seed: a slightly irregular dome, lobes or an ellipsoid, and its shape where it is pressed in.

The tissue frame's origin is the area centroid of the outline on the floor, so that the centroid of the organ's
silhouette, seen from straight above, is the projection of that origin. The surface is one height over each point of
the plane, in rings about the apex; it is open at the floor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from svmdist.perturbations.chosen import UNPERTURBED, Perturbations
from svmdist.simulation.meshes import TEXTURE_SPAN_M, DrawnMesh, smooth_normals
from svmdist.transforms import Array, polygon_centroid

SEMI_AXES_M = (0.028, 0.022)
HEIGHT_M = 0.008
DOME_EXPONENTS, ELLIPSOID_EXPONENTS = (2.3, 0.62), (2.0, 0.5)
"""Height (1 - r^2.3)^0.62 over the normalised radius r; of an ellipsoid (1 - r²)^0.5."""
RING_COUNT, SIDE_COUNT = 44, 160
FINE_RING_COUNT, FINE_SIDE_COUNT = 72, 200
"""Of an organ with lobes or dents: edges of about 0.6 mm."""

SHAPE_STREAM = 102
OUTLINE_ORDERS = (3, 4, 5, 6)
OUTLINE_SHARE = 0.2
"""Of the strength of `tissue_shape`: waves of 6 % of the outline's radius at a strength of 0.3."""
WAVE_COUNT = 10
WAVELENGTHS_M = (0.014, 0.032)
"""Half of the organ to the whole of it: lobes."""

REACH_M = 0.012
"""A push is felt as far as this, half of it at 3.7 mm. Below a blunt punch on a deep half-space half of the depth is
left at 1.4 times its radius (Johnson 1985, Contact mechanics, sec. 3.4); a capsule under tension spreads it."""
LIMIT = 0.8
"""Of the organ's height at a place; then it is pressed flat against its bed, and gives way no further."""
FINE_REACH_M = 0.002
SWEEPS = 8
"""The pressed surface is flat between vertices, so that some µm are left inside and push again, with a small reach."""
TOLERANCE_M = 1e-6
CELL_M = 0.0003
"""Only the deepest push of each cell of the plane counts: those above it, and on steep sides, change nothing."""
CHUNK = 64


@dataclass(frozen=True)
class Organ:
    """Mesh in the tissue frame, its outline on the floor, shape (n, 2) in m, and the height of its apex in m."""

    mesh: DrawnMesh
    outline_m: Array
    height_m: float


def make_organ(rng: np.random.Generator, seed: int = 0, perturbations: Perturbations = UNPERTURBED) -> Organ:
    """Make the organ of a random stream: a convex dome, unless perturbations `tissue_*` give it another shape.

    Waves multiply the height by 1 ± `tissue_shape` and the outline's radius by a fifth of that. The organ rises no
    higher than the dome, so that scenarios keep clear of it. The seed draws the same waves at every strength.
    """
    strength, ellipsoid = perturbations["tissue_shape"], perturbations["tissue_ellipsoid"]
    is_fine = strength > 0.0 or perturbations["dent"] > 0.0
    ring_count, side_count = (FINE_RING_COUNT, FINE_SIDE_COUNT) if is_fine else (RING_COUNT, SIDE_COUNT)
    shape = np.random.default_rng([seed, SHAPE_STREAM])
    length_m = shape.uniform(*WAVELENGTHS_M, WAVE_COUNT)
    heading_rad = shape.uniform(0.0, 2.0 * np.pi, WAVE_COUNT)
    weights = shape.uniform(0.5, 1.0, len(OUTLINE_ORDERS))
    phases_rad = shape.uniform(0.0, 2.0 * np.pi, WAVE_COUNT)
    outline_phases_rad = shape.uniform(0.0, 2.0 * np.pi, len(OUTLINE_ORDERS))

    angle = np.linspace(0.0, 2.0 * np.pi, side_count, endpoint=False)
    outline_m = _outline(angle, rng)
    if strength or ellipsoid:
        orders = zip(OUTLINE_ORDERS, weights / weights.sum(), outline_phases_rad, strict=True)
        waves = sum(weight * np.cos(order * angle + phase) for order, weight, phase in orders)
        outline_m *= np.asarray(1.0 + strength * OUTLINE_SHARE * waves)[:, None]
    outline_m -= polygon_centroid(outline_m)
    # The apex beside the centroid, as no organ is symmetric.
    apex_m = rng.uniform(-1.0, 1.0, 2) * (0.004, 0.003)
    height_m = HEIGHT_M * rng.uniform(0.97, 1.03)
    # Rings crowd at the rim, where the dome is steep.
    radius = np.sin(np.linspace(0.0, np.pi / 2, ring_count + 1)[1:])
    exponents = zip(DOME_EXPONENTS, ELLIPSOID_EXPONENTS, strict=True)
    inner, outer = (dome + ellipsoid * (other - dome) for dome, other in exponents)
    profile = (1.0 - radius**inner) ** outer
    xy_m = apex_m + radius[:, None, None] * (outline_m - apex_m)
    z_m = np.broadcast_to(height_m * profile[:, None, None], (ring_count, side_count, 1))
    vertices_m = np.vstack([[*apex_m, height_m], np.concatenate([xy_m, z_m], -1).reshape(-1, 3)])
    if strength:
        vectors = 2.0 * np.pi / length_m[:, None] * np.stack([np.cos(heading_rad), np.sin(heading_rad)], -1)
        waves = np.cos(vertices_m[:, :2] @ vectors.T + phases_rad).sum(axis=1)
        vertices_m[:, 2] *= 1.0 + strength * waves / np.abs(waves).max()
        vertices_m[:, 2] *= height_m / vertices_m[:, 2].max()
    faces = _fan_and_rings(ring_count, side_count)
    uv = 0.5 + vertices_m[:, :2] / TEXTURE_SPAN_M
    mesh = DrawnMesh(vertices_m, faces, smooth_normals(vertices_m, faces), uv)
    return Organ(mesh, outline_m, float(height_m))


def _outline(angle: Array, rng: np.random.Generator) -> Array:
    """A superellipse-like outline with two faint waves; their amplitudes keep it convex."""
    a_m, b_m = SEMI_AXES_M
    exponent = rng.uniform(2.05, 2.2)
    summed = np.abs(np.cos(angle) / a_m) ** exponent + np.abs(np.sin(angle) / b_m) ** exponent
    radius_m = summed ** (-1.0 / exponent)
    wave = sum(
        amplitude * np.cos(order * angle + rng.uniform(0.0, 2.0 * np.pi))
        for order, amplitude in ((2, 0.02), (3, 0.025))
    )
    return np.asarray((radius_m * (1.0 + wave))[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1))


def _fan_and_rings(ring_count: int, side_count: int) -> NDArray[np.int64]:
    """Triangles of the dome: a fan at the apex, then rings down to the floor."""
    side = np.arange(side_count)
    following = (side + 1) % side_count
    parts = [np.stack([np.zeros_like(side), 1 + side, 1 + following], -1)]
    for ring in range(ring_count - 1):
        inner, outer = 1 + ring * side_count, 1 + (ring + 1) * side_count
        parts.append(np.stack([inner + side, outer + side, outer + following], -1))
        parts.append(np.stack([inner + side, outer + following, inner + following], -1))
    return np.concatenate(parts)


class OrganSurface:
    """The surface of an organ as heights over points of the plane, and as it gives way to pressure; tissue frame.

    Heights are exactly those of the triangles, which the rings about the apex make easy to find.
    """

    def __init__(self, organ: Organ) -> None:
        self._organ = organ
        vertices_m = organ.mesh.vertices_m
        self._rest_m = vertices_m[:, 2]
        self.top_m = float(self._rest_m.max())
        self._side_count = len(organ.outline_m)
        self._apex_m = vertices_m[0, :2]
        rays_m = vertices_m[-self._side_count :, :2] - self._apex_m
        first = vertices_m[1 :: self._side_count, :2] - self._apex_m
        self._ring_radius = np.concatenate([[0.0], first @ rays_m[0] / (rays_m[0] @ rays_m[0])])
        # The outline is seen from the apex in the order of its corners: it is nearly convex.
        bearing = np.unwrap(np.arctan2(rays_m[:, 1], rays_m[:, 0]))
        self._first_bearing = bearing[0]
        self._bearings = bearing - bearing[0]
        self._rays_m = np.vstack([rays_m, rays_m[:1]])

    def heights_m(self, xy_m: Array, z_m: Array | None = None) -> Array:
        """Heights over points, shape (n, 2): shape (n,), -inf beside the organ.

        The vertices may have other heights `z_m`, shape (v,).
        """
        z_m = self._rest_m if z_m is None else z_m
        away = xy_m - self._apex_m
        turn = np.mod(np.arctan2(away[:, 1], away[:, 0]) - self._first_bearing, 2.0 * np.pi)
        side = np.clip(np.searchsorted(self._bearings, turn, side="right") - 1, 0, self._side_count - 1)
        a, b = self._rays_m[side], self._rays_m[side + 1]
        # A point is alpha a + beta b; alpha + beta is its normalised radius.
        across = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        alpha = (away[:, 0] * b[:, 1] - away[:, 1] * b[:, 0]) / across
        beta = (a[:, 0] * away[:, 1] - a[:, 1] * away[:, 0]) / across
        ring = np.clip(np.searchsorted(self._ring_radius, alpha + beta), 1, len(self._ring_radius) - 1)
        near, far = self._ring_radius[ring - 1], self._ring_radius[ring]
        z_near, z_far = self._at(z_m, ring - 1, side), self._at(z_m, ring, side)
        z_near_b, z_far_b = self._at(z_m, ring - 1, side + 1), self._at(z_m, ring, side + 1)
        # The triangle on the side of `a`: inner a, outer a, outer b; and the other: inner a, outer b, inner b.
        w_far_b = beta / far
        w_far = (alpha - near * (1.0 - w_far_b)) / (far - near)
        on_a = w_far >= 0.0
        w_near = np.divide(alpha, near, out=np.zeros_like(alpha), where=near > 0.0)
        w_far_b_other = (beta - near * (1.0 - w_near)) / (far - near)
        height = np.where(
            on_a,
            (1.0 - w_far - w_far_b) * z_near + w_far * z_far + w_far_b * z_far_b,
            w_near * z_near + w_far_b_other * z_far_b + (1.0 - w_near - w_far_b_other) * z_near_b,
        )
        return np.where(alpha + beta <= 1.0, height, -np.inf)

    def _at(self, z_m: Array, ring: NDArray[np.intp], side: NDArray[np.intp]) -> Array:
        vertex = 1 + (ring - 1) * self._side_count + side % self._side_count
        return np.asarray(z_m[np.where(ring == 0, 0, vertex)])

    def inside_m(self, points_m: Array, share: float = 1.0) -> Array:
        """How deep points, shape (n, 3), lie below the surface, or that share of its height: shape (n,)."""
        return self.heights_m(points_m[:, :2]) * share - points_m[:, 2]

    def is_too_deep(self, points_m: Array) -> bool:
        """Whether some of the points, shape (n, 3), lie so deep that the organ does not give way to them."""
        return bool((self.inside_m(points_m, 1.0 - LIMIT) > TOLERANCE_M).any())

    def dented(self, points_m: Array) -> Organ:
        """The organ under points, shape (n, 3), which are inside it at rest.

        Every such point pushes the surface below itself down to it, and what is around less and less, by the deepest
        push that reaches there. What is not pressed is as at rest; nothing bulges.
        """
        down_m, least_m = np.zeros_like(self._rest_m), (1.0 - LIMIT) * self._rest_m
        for sweep in range(SWEEPS):
            deep_m = self.heights_m(points_m[:, :2], self._rest_m - down_m) - points_m[:, 2]
            push = deep_m > TOLERANCE_M
            if not push.any():
                break
            xy_m, by_m = _deepest(points_m[push, :2], deep_m[push])
            down_m += self._pushed_m(xy_m, by_m, FINE_REACH_M if sweep else REACH_M)
            down_m = np.minimum(down_m, self._rest_m - least_m)
        mesh = self._organ.mesh
        vertices_m = mesh.vertices_m.copy()
        vertices_m[:, 2] -= down_m
        normals = smooth_normals(vertices_m, mesh.faces)
        return replace(self._organ, mesh=DrawnMesh(vertices_m, mesh.faces, normals, mesh.uv))

    def _pushed_m(self, xy_m: Array, by_m: Array, reach_m: float) -> Array:
        """How far vertices are pushed by points, shape (n, 2), that push so far, shape (n,): the most of all; (v,)."""
        place_m, pushed_m = self._organ.mesh.vertices_m[:, :2], np.zeros_like(self._rest_m)
        for begin in range(0, len(xy_m), CHUNK):
            some_m, push_m = xy_m[begin : begin + CHUNK], by_m[begin : begin + CHUNK]
            near = ((place_m > some_m.min(0) - reach_m) & (place_m < some_m.max(0) + reach_m)).all(axis=1)
            x_m, y_m = (place_m[near, axis, None] - some_m[:, axis] for axis in range(2))
            share = _bump(np.sqrt(x_m * x_m + y_m * y_m) / reach_m)
            pushed_m[near] = np.maximum(pushed_m[near], (share * push_m).max(axis=1))
        return pushed_m


def _deepest(xy_m: Array, deep_m: Array) -> tuple[Array, Array]:
    """Of points, shape (n, 2), which are so deep, shape (n,), the deepest of each cell, cell by cell."""
    column, row = np.floor(xy_m / CELL_M).astype(np.int64).T
    order = np.lexsort((deep_m, row, column))
    column, row = column[order], row[order]
    is_last = np.append((np.diff(column) != 0) | (np.diff(row) != 0), True)
    chosen = order[is_last]
    return xy_m[chosen], deep_m[chosen]


def _bump(radius: Array) -> Array:
    """From 1 at radius 0 to 0 at 1 and beyond, any shape; twice differentiable.

    Wendland 1995, Piecewise polynomial, positive definite and compactly supported radial functions.
    """
    left = np.maximum(1.0 - radius, 0.0)
    square = left * left
    return np.asarray(square * square * (5.0 - 4.0 * left))

"""Triangle meshes with smooth normals: surfaces of revolution and lofted bars.

PyBullet draws its own cylinders and spheres as coarse prisms, up to 13 % too thin, which ruins metric
vision. Every round part is therefore a mesh of at least 64 sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.geometry import Mesh
from svmdist.samples import Image
from svmdist.transforms import Array, transform_points

SIDE_COUNT = 64


@dataclass(frozen=True)
class DrawnMesh(Mesh):
    """A mesh in the frame of its part, with what drawing it needs.

    Unit `normals` (v, 3) at the vertices, and texture coordinates `uv` (v, 2) in 0–1.
    """

    normals: Array
    uv: Array

    def transformed(self, T_other_this: Array) -> DrawnMesh:
        """The same mesh in another frame, by a transform of shape (4, 4)."""
        return DrawnMesh(
            transform_points(T_other_this, self.vertices_m),
            self.faces,
            self.normals @ T_other_this[:3, :3].T,
            self.uv,
        )


def loft(x_m: Array, half_y_m: Array, half_z_m: Array, roundness: float = 2.0) -> DrawnMesh:
    """Sweep superellipses along x: section i stands at x_m[i] with half-axes half_y_m[i], half_z_m[i].

    `roundness` 2 gives ellipses, 4 boxes with rounded edges. The ends are closed by flat caps. Lofts whose
    half-axes are concave functions of x are convex.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, SIDE_COUNT, endpoint=False)
    unit_y = np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** (2.0 / roundness)
    unit_z = np.sign(np.sin(angle)) * np.abs(np.sin(angle)) ** (2.0 / roundness)
    x_m, y_m, z_m = np.broadcast_arrays(x_m[:, None], half_y_m[:, None] * unit_y, half_z_m[:, None] * unit_z)
    grid = np.stack([x_m, y_m, z_m], -1)
    sides = _quads(len(grid), SIDE_COUNT)
    vertices = grid.reshape(-1, 3)
    parts = [(vertices, smooth_normals(vertices, sides), sides), _cap(grid[0], -1.0), _cap(grid[-1], 1.0)]
    offsets = np.cumsum([0] + [len(each) for each, _, _ in parts[:-1]])
    return DrawnMesh(
        np.concatenate([each for each, _, _ in parts]),
        np.concatenate([faces + offset for (_, _, faces), offset in zip(parts, offsets, strict=True)]),
        np.concatenate([normals for _, normals, _ in parts]),
        np.full((sum(len(each) for each, _, _ in parts), 2), 0.5),
    )


def revolve(x_m: Array, radius_m: Array) -> DrawnMesh:
    """Turn a profile of radii about the x axis."""
    return loft(x_m, radius_m, radius_m)


def sphere(radius_m: float) -> DrawnMesh:
    """A sphere about the origin with 64 meridians and 33 parallels."""
    latitude = np.linspace(0.0, np.pi, 33)
    # Not quite closed at the poles: a triangle without area has no normal.
    return revolve(-radius_m * np.cos(latitude), radius_m * np.maximum(np.sin(latitude), 1e-3))


def bar(x_m: tuple[float, float], half_y_m: float, half_z_m: float) -> DrawnMesh:
    """A bar along x with rounded edges and rounded ends."""
    bevel = min(half_y_m, half_z_m) * 0.6
    turn = np.linspace(0.0, np.pi / 2, 5)
    start, end = x_m[0] + bevel * (1 - np.sin(turn)), x_m[1] - bevel * (1 - np.sin(turn))
    shrink = bevel * (1 - np.cos(turn))
    inset = np.concatenate([shrink[::-1], shrink])
    x = np.concatenate([start[::-1], end])
    return loft(np.sort(x), half_y_m - inset, half_z_m - inset, roundness=4.0)


def smooth_normals(vertices_m: Array, faces: NDArray[np.int64]) -> Array:
    """Unit normals at vertices, shape (n, 3): the area-weighted mean over the triangles that meet there."""
    a, b, c = (vertices_m[faces[:, corner]] for corner in range(3))
    face_normals = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices_m)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], face_normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(length > 0, length, 1.0))


def _quads(ring_count: int, side_count: int) -> NDArray[np.int64]:
    """Triangles between neighbouring rings of a closed tube; rings follow one another along +x."""
    ring, side = np.meshgrid(np.arange(ring_count - 1), np.arange(side_count), indexing="ij")
    a = (ring * side_count + side).ravel()
    b = (ring * side_count + (side + 1) % side_count).ravel()
    inner, outer = np.stack([a, b, b + side_count], -1), np.stack([a, b + side_count, a + side_count], -1)
    return np.concatenate([inner, outer])


def _cap(ring_m: Array, direction: float) -> tuple[Array, Array, NDArray[np.int64]]:
    vertices = np.vstack([ring_m, ring_m.mean(axis=0)])
    count = len(ring_m)
    here, following = np.arange(count), (np.arange(count) + 1) % count
    centre = np.full(count, count)
    faces = np.stack([here, following, centre] if direction > 0 else [following, here, centre], -1)
    return vertices, np.tile([direction, 0.0, 0.0], (count + 1, 1)), faces


TEXTURE_PX = 1024
TEXTURE_SPAN_M = 0.07
"""The tissue's texture covers a square of this side about the tissue frame's origin."""


def tissue_texture(rng: np.random.Generator) -> Image:
    """Red-pink mottling with a few faint, branching vessels; BGR, shape (1024, 1024, 3)."""
    base = np.array([92.0, 84.0, 214.0])
    paler = np.array([38.0, 36.0, 18.0])
    mottling = 0.9 * smooth_noise(rng, 8) + 0.3 * smooth_noise(rng, 17)
    colour = base + mottling[..., None] * paler
    vessels = _vessels(rng)[..., None]
    colour += vessels * np.array([-22.0, -34.0, -48.0])
    return _as_image(colour)


def floor_texture(rng: np.random.Generator) -> Image:
    """Dull beige-brown folds, low in saturation; BGR, shape (1024, 1024, 3)."""
    base = np.array([104.0, 112.0, 122.0])
    folds = smooth_noise(rng, 7, stretch=2.2)
    return _as_image(base + folds[..., None] * np.array([13.0, 14.0, 14.0]))


def smooth_noise(rng: np.random.Generator, cell_count: int, stretch: float = 1.0) -> Array:
    """Noise with `cell_count` bumps across the texture, mean 0 and about -1 to 1, shape (1024, 1024).

    `stretch` makes the bumps longer along x.
    """
    columns = max(2, round(cell_count / stretch))
    cells = rng.uniform(-1.0, 1.0, (cell_count, columns))
    return np.asarray(cv2.resize(cells, (TEXTURE_PX, TEXTURE_PX), interpolation=cv2.INTER_CUBIC), np.float64)


def _vessels(rng: np.random.Generator) -> Array:
    """Dark branching lines with soft edges, 0 to 1, shape (1024, 1024)."""
    canvas = np.zeros((TEXTURE_PX, TEXTURE_PX), np.uint8)
    for _ in range(5):
        start = rng.uniform(0.25, 0.75, 2) * TEXTURE_PX
        _grow_vessel(canvas, rng, start, rng.uniform(0.0, 2.0 * np.pi), width_px=9.0)
    return cv2.GaussianBlur(canvas, (0, 0), 4.0).astype(np.float64) / 255.0


def _grow_vessel(
    canvas: Image, rng: np.random.Generator, start_px: Array, heading_rad: float, width_px: float
) -> None:
    position = start_px
    for step in range(16):
        following = position + 24.0 * np.array([np.cos(heading_rad), np.sin(heading_rad)])
        ends = [tuple(round(float(value) * 16) for value in point) for point in (position, following)]
        cv2.line(canvas, ends[0], ends[1], 255, max(1, round(width_px)), cv2.LINE_AA, shift=4)
        position = following
        heading_rad += rng.normal(0.0, 0.22)
        width_px *= 0.93
        if width_px > 5.0 and step in (4, 9):
            turn = rng.choice([-0.8, 0.8])
            _grow_vessel(canvas, rng, position, heading_rad + turn, width_px * 0.7)


def _as_image(colour: Array) -> Image:
    return np.clip(np.rint(colour), 0, 255).astype(np.uint8)

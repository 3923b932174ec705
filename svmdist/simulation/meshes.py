"""Surfaces that are drawn: triangle meshes with smooth normals, and the textures of tissue and floor.

PyBullet draws its own cylinders and spheres as coarse prisms, up to 13 % too thin, which ruins metric vision. Every
round part is therefore a mesh of at least 64 sides. Textures are smooth on the scale of pixels, so that frames stay
small as lossless PNG.
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
FLOOR_HALF_M = 0.16
TEXTURE_PX = 1024
TEXTURE_SPAN_M = 0.07  # the tissue's texture covers a square of this side about the tissue frame's origin


@dataclass(frozen=True)
class DrawnMesh(Mesh):
    """A mesh in the frame of its part, with what drawing it needs.

    Unit `normals` (v, 3) at the vertices, and texture coordinates `uv` (v, 2) in 0–1.
    """

    normals: Array
    uv: Array

    def transformed(self, T_other_this: Array) -> DrawnMesh:
        """The same mesh in another frame, by a transform of shape (4, 4)."""
        vertices_m = transform_points(T_other_this, self.vertices_m)
        return DrawnMesh(vertices_m, self.faces, self.normals @ T_other_this[:3, :3].T, self.uv)


def loft(x_m: Array, half_y_m: Array, half_z_m: Array, roundness: float = 2.0) -> DrawnMesh:
    """Sweep superellipses along x: section i stands at x_m[i] with half-axes half_y_m[i], half_z_m[i].

    `roundness` 2 gives ellipses, 4 boxes with rounded edges. The ends are closed by flat caps. Lofts whose
    half-axes are concave functions of x are convex.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, SIDE_COUNT, endpoint=False)
    y, z = (np.sign(wave) * np.abs(wave) ** (2.0 / roundness) for wave in (np.cos(angle), np.sin(angle)))
    grid = np.stack(np.broadcast_arrays(x_m[:, None], half_y_m[:, None] * y, half_z_m[:, None] * z), -1)
    # Two triangles between neighbouring sections and sides, then a cap at each end with a normal of its own.
    a = np.arange(grid.size // 3).reshape(grid.shape[:2])
    b = np.roll(a, -1, axis=1)
    inner, outer = np.stack([a[:-1], b[:-1], b[1:]], -1), np.stack([a[:-1], b[1:], a[1:]], -1)
    sides = np.concatenate([inner.reshape(-1, 3), outer.reshape(-1, 3)])
    vertices, faces, normals = [grid.reshape(-1, 3)], [sides], [smooth_normals(grid.reshape(-1, 3), sides)]
    for ring, direction in ((grid[0], -1.0), (grid[-1], 1.0)):
        here = sum(map(len, vertices)) + np.arange(SIDE_COUNT)
        following, centre = np.roll(here, -1), np.full(SIDE_COUNT, here[0] + SIDE_COUNT)
        faces.append(np.stack([here, following, centre] if direction > 0 else [following, here, centre], -1))
        vertices.append(np.vstack([ring, ring.mean(axis=0)]))
        normals.append(np.tile([direction, 0.0, 0.0], (SIDE_COUNT + 1, 1)))
    points_m = np.concatenate(vertices)
    return DrawnMesh(
        points_m, np.concatenate(faces), np.concatenate(normals), np.full((len(points_m), 2), 0.5)
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
    inwards, shrink = bevel * (1 - np.sin(turn)), bevel * (1 - np.cos(turn))
    x = np.sort(np.concatenate([x_m[0] + inwards, x_m[1] - inwards]))
    inset = np.concatenate([shrink[::-1], shrink])
    return loft(x, half_y_m - inset, half_z_m - inset, roundness=4.0)


def smooth_normals(vertices_m: Array, faces: NDArray[np.int64]) -> Array:
    """Unit normals at vertices, shape (n, 3): the area-weighted mean over the triangles that meet there."""
    a, b, c = (vertices_m[faces[:, corner]] for corner in range(3))
    face_normals = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices_m)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], face_normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(length > 0, length, 1.0))


def make_floor() -> DrawnMesh:
    """A flat sheet in the world's frame at z = 0, finely divided for even shading."""
    count = 33
    axis = np.linspace(-FLOOR_HALF_M, FLOOR_HALF_M, count)
    x, y = np.meshgrid(axis, axis)
    vertices_m = np.stack([x.ravel(), y.ravel(), np.zeros(count * count)], -1)
    a = np.arange(count * count).reshape(count, count)[:-1, :-1].reshape(-1, 1)
    faces = np.vstack([a + np.array(corners) for corners in ((0, 1, count + 1), (0, count + 1, count))])
    uv = 0.5 + vertices_m[:, :2] / (2.0 * FLOOR_HALF_M)
    return DrawnMesh(vertices_m, faces, smooth_normals(vertices_m, faces), uv)


def make_retractor() -> DrawnMesh:
    """A flat steel blade along +x from its tip at the origin; `occlusion` swings it over the instrument."""
    x_m = np.array([0.0, 0.0008, 0.002, 0.004, 0.008, 0.09])
    half_y_m = np.array([0.0035, 0.0052, 0.0062, 0.0068, 0.007, 0.007])
    half_z_m = np.array([0.0006, 0.0007, 0.0008, 0.0008, 0.0008, 0.0008])
    return loft(x_m, half_y_m, half_z_m, roundness=3.0)


def tissue_texture(rng: np.random.Generator) -> Image:
    """Red-pink mottling with a few faint, branching vessels; BGR, shape (1024, 1024, 3)."""
    mottling = 0.9 * _smooth_noise(rng, 8) + 0.3 * _smooth_noise(rng, 17)
    colour = np.array([92.0, 84.0, 214.0]) + mottling[..., None] * np.array([38.0, 36.0, 18.0])
    lines = np.zeros((TEXTURE_PX, TEXTURE_PX), np.uint8)
    for _ in range(5):
        start = rng.uniform(0.25, 0.75, 2) * TEXTURE_PX
        _grow_vessel(lines, rng, start, rng.uniform(0.0, 2.0 * np.pi), width_px=9.0)
    vessels = cv2.GaussianBlur(lines, (0, 0), 4.0).astype(np.float64)[..., None] / 255.0
    return _as_image(colour + vessels * np.array([-22.0, -34.0, -48.0]))


def floor_texture(rng: np.random.Generator) -> Image:
    """Dull beige-brown folds, low in saturation; BGR, shape (1024, 1024, 3)."""
    folds = _smooth_noise(rng, 7, stretch=2.2)[..., None]
    return _as_image(np.array([104.0, 112.0, 122.0]) + folds * np.array([13.0, 14.0, 14.0]))


def _smooth_noise(rng: np.random.Generator, cell_count: int, stretch: float = 1.0) -> Array:
    """Noise with `cell_count` bumps across the texture, longer along x by `stretch`; mean 0 and about -1 to 1."""
    cells = rng.uniform(-1.0, 1.0, (cell_count, max(2, round(cell_count / stretch))))
    return np.asarray(cv2.resize(cells, (TEXTURE_PX, TEXTURE_PX), interpolation=cv2.INTER_CUBIC), np.float64)


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

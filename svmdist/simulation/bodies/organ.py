"""The tissue organ of one seed: a convex, slightly irregular dome about its own frame, plain, with relief or lobes.

The tissue frame's origin is the area centroid of the outline on the floor, so that the centroid of the
organ's silhouette, seen from straight above, is the projection of that origin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.simulation.bodies.meshes import DrawnMesh, smooth_normals
from svmdist.simulation.bodies.relief import Relief
from svmdist.simulation.bodies.textures import TEXTURE_SPAN_M
from svmdist.simulation.bodies.tissue_shape import TissueShape
from svmdist.transforms import Array, polygon_centroid

SEMI_AXES_M = (0.028, 0.022)
HEIGHT_M = 0.008

RING_COUNT = 44
SIDE_COUNT = 160
RELIEF_RING_COUNT = 72
RELIEF_SIDE_COUNT = 200
"""Edges of about 0.6 mm: a sixth of the relief's shortest wavelength."""


@dataclass(frozen=True)
class Organ:
    """Mesh in the tissue frame, its outline on the floor, shape (n, 2) in m, and its height in m.

    The mesh is open at the floor. The height is that of the smooth dome; an organ with relief or lobes is not convex.
    """

    mesh: DrawnMesh
    outline_m: Array
    height_m: float
    is_convex: bool = True


def make_organ(
    rng: np.random.Generator,
    relief: Relief | None = None,
    shape: TissueShape | None = None,
    *,
    is_soft: bool = False,
) -> Organ:
    """Make the organ of a random stream, a dome unless it has a shape of its own.

    Height over the plane is concave in the normalised radius (1 on the outline, 0 at the apex), and the
    outline is convex, so the body is convex. Convexity lets Bullet compute exact distances to it. Relief is
    added to the height, so that the surface stays one height over the plane and the outline what it was. So does
    a shape's multiplied height; it rises no higher than the dome, so that scenarios keep clear of it. A soft organ
    has triangles as fine as relief has, for its dents.
    """
    is_convex = relief is None and (shape is None or shape.is_convex)
    is_coarse = is_convex and not is_soft
    ring_count, side_count = (RING_COUNT, SIDE_COUNT) if is_coarse else (RELIEF_RING_COUNT, RELIEF_SIDE_COUNT)
    angle = np.linspace(0.0, 2.0 * np.pi, side_count, endpoint=False)
    outline_m = _outline(angle, rng)
    if shape is not None:
        outline_m *= shape.stretched(angle)[:, None]
    outline_m -= polygon_centroid(outline_m)
    # The apex beside the centroid, as no organ is symmetric.
    apex_m = rng.uniform(-1.0, 1.0, 2) * (0.004, 0.003)
    height_m = HEIGHT_M * rng.uniform(0.97, 1.03)
    # Rings crowd at the rim, where the dome is steep.
    radius = np.sin(np.linspace(0.0, np.pi / 2, ring_count + 1)[1:])
    profile = (1.0 - radius**2.3) ** 0.62 if shape is None else shape.profile(radius)
    xy_m = apex_m + radius[:, None, None] * (outline_m - apex_m)
    z_m = np.broadcast_to(height_m * profile[:, None, None], (ring_count, side_count, 1))
    vertices_m = np.vstack([[*apex_m, height_m], np.concatenate([xy_m, z_m], -1).reshape(-1, 3)])
    if shape is not None and not shape.is_convex:
        vertices_m[:, 2] *= shape.raised(vertices_m[:, :2])
        vertices_m[:, 2] *= height_m / vertices_m[:, 2].max()
    if relief is not None:
        at_vertex = np.concatenate([[0.0], np.repeat(radius, side_count)])
        vertices_m[:, 2] += relief.height_m(vertices_m[:, :2], at_vertex)
    faces = _fan_and_rings(ring_count, side_count)
    normals = smooth_normals(vertices_m, faces)
    uv = 0.5 + vertices_m[:, :2] / TEXTURE_SPAN_M
    return Organ(DrawnMesh(vertices_m, faces, normals, uv), outline_m, float(height_m), is_convex)


def _outline(angle: Array, rng: np.random.Generator) -> Array:
    """A superellipse-like outline with two faint waves; their amplitudes keep it convex."""
    a_m, b_m = SEMI_AXES_M
    exponent = rng.uniform(2.05, 2.2)
    radius_m = (np.abs(np.cos(angle) / a_m) ** exponent + np.abs(np.sin(angle) / b_m) ** exponent) ** (
        -1.0 / exponent
    )
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

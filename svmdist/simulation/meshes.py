"""What is rendered: meshes with smooth normals, textures of tissue and floor, the instrument's parts and plate.

PyBullet draws its own cylinders and spheres as coarse prisms, up to 13 % too thin, which ruins metric vision: round
parts are meshes of 64 sides. Textures are smooth on the scale of pixels, so that frames stay small as lossless PNG. The
distal marker is a coloured sphere about the tool's origin; the parts that touch it are slimmer or stand beside it, so
that its silhouette's centroid is the projection of that origin.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.geometry import Mesh
from svmdist.kinematics import DHChain
from svmdist.perturbations import Perturbations
from svmdist.profile.robot import Fiducial, Instrument
from svmdist.samples import Image
from svmdist.transforms import Array, make_transform, rotation_x, rotation_z, transform_points
from svmdist.vision.tags import tag_dictionary

SIDE_COUNT, TEXTURE_PX = 64, 1024
_TISSUE_STREAM, _FLOOR_STREAM = 2, 3
TEXTURE_SPAN_M = 0.07  # the tissue's texture covers a square of this side about the tissue frame's origin


@dataclass(frozen=True)
class DrawnMesh(Mesh):
    """A mesh in its part's frame, with unit `normals` (v, 3) and texture coordinates `uv` (v, 2) in 0–1."""

    normals: Array
    uv: Array

    def transformed(self, T_other_this: Array) -> DrawnMesh:
        """The same mesh in another frame, by a transform of shape (4, 4)."""
        vertices_m = transform_points(T_other_this, self.vertices_m)
        return DrawnMesh(vertices_m, self.faces, self.normals @ T_other_this[:3, :3].T, self.uv)


def loft(x_m: Array, half_y_m: Array, half_z_m: Array, roundness: float = 2.0) -> DrawnMesh:
    """Sweep superellipses along x, with flat caps: section i stands at x_m[i], with half-axes half_y_m[i], half_z_m[i].

    `roundness` 2 gives ellipses, 4 boxes with rounded edges. Half-axes that are concave over x make a convex body.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, SIDE_COUNT, endpoint=False)
    y, z = (np.sign(wave) * np.abs(wave) ** (2.0 / roundness) for wave in (np.cos(angle), np.sin(angle)))
    grid = np.stack(np.broadcast_arrays(x_m[:, None], half_y_m[:, None] * y, half_z_m[:, None] * z), -1)
    # Two triangles between neighbouring sections and sides, then a cap at each end with a normal of its own.
    a = np.arange(grid.size // 3).reshape(grid.shape[:2])
    b = np.roll(a, -1, axis=1)
    inner, outer = np.stack([a[:-1], b[:-1], b[1:]], -1), np.stack([a[:-1], b[1:], a[1:]], -1)
    sides = np.concatenate([inner.reshape(-1, 3), outer.reshape(-1, 3)])
    points_m, faces, normals = grid.reshape(-1, 3), sides, smooth_normals(grid.reshape(-1, 3), sides)
    for ring, direction in ((grid[0], -1.0), (grid[-1], 1.0)):
        here = len(points_m) + np.arange(SIDE_COUNT)
        following, centre = np.roll(here, -1), np.full(SIDE_COUNT, here[0] + SIDE_COUNT)
        cap = np.stack([here, following, centre] if direction > 0 else [following, here, centre], -1)
        points_m, faces = np.vstack([points_m, ring, ring.mean(axis=0)]), np.vstack([faces, cap])
        normals = np.vstack([normals, np.tile([direction, 0.0, 0.0], (SIDE_COUNT + 1, 1))])
    return DrawnMesh(points_m, faces, normals, np.full((len(points_m), 2), 0.5))


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
    count, half_m = 33, 0.16
    axis = np.linspace(-half_m, half_m, count)
    x, y, z = (each.ravel() for each in np.meshgrid(axis, axis, 0.0))
    vertices_m = np.stack([x, y, z], -1)
    a = np.arange(count * count).reshape(count, count)[:-1, :-1].reshape(-1, 1)
    faces = np.vstack([a + np.array(corners) for corners in ((0, 1, count + 1), (0, count + 1, count))])
    return DrawnMesh(vertices_m, faces, smooth_normals(vertices_m, faces), 0.5 + vertices_m[:, :2] / (2.0 * half_m))


def make_retractor() -> DrawnMesh:
    """A flat steel blade along +x from its tip at the origin; `occlusion` swings it over the instrument."""
    x_m = np.array([0.0, 0.0008, 0.002, 0.004, 0.008, 0.09])
    half_y_m = np.array([0.0035, 0.0052, 0.0062, 0.0068, 0.007, 0.007])
    return loft(x_m, half_y_m, np.array([0.0006, 0.0007, *[0.0008] * 4]), roundness=3.0)


def tissue_texture(seed: int) -> Image:
    """Red-pink mottling with a few faint, branching vessels; BGR, shape (1024, 1024, 3)."""
    rng = np.random.default_rng([seed, _TISSUE_STREAM])
    mottling = 0.9 * _smooth_noise(rng, 8, 8) + 0.3 * _smooth_noise(rng, 17, 17)
    colour = np.array([92.0, 84.0, 214.0]) + mottling[..., None] * np.array([38.0, 36.0, 18.0])
    lines = np.zeros((TEXTURE_PX, TEXTURE_PX), np.uint8)
    for _ in range(5):
        _grow_vessel(lines, rng, rng.uniform(0.25, 0.75, 2) * TEXTURE_PX, rng.uniform(0.0, 2.0 * np.pi), width_px=9.0)
    vessels = cv2.GaussianBlur(lines, (0, 0), 4.0).astype(np.float64)[..., None] / 255.0
    colour += vessels * np.array([-22.0, -34.0, -48.0])
    return np.asarray(np.rint(colour).clip(0, 255), np.uint8)


def floor_texture(seed: int) -> Image:
    """Dull beige-brown folds, low in saturation; BGR, shape (1024, 1024, 3)."""
    folds = _smooth_noise(np.random.default_rng([seed, _FLOOR_STREAM]), 7, 3)[..., None]
    colour = np.array([104.0, 112.0, 122.0]) + folds * np.array([13.0, 14.0, 14.0])
    return np.asarray(np.rint(colour).clip(0, 255), np.uint8)


def _smooth_noise(rng: np.random.Generator, *counts: int) -> Array:
    """Noise with so many bumps along y and along x of the texture; mean 0 and about -1 to 1."""
    cells = rng.uniform(-1.0, 1.0, counts)
    return np.asarray(cv2.resize(cells, (TEXTURE_PX, TEXTURE_PX), interpolation=cv2.INTER_CUBIC), np.float64)


def _grow_vessel(canvas: Image, rng: np.random.Generator, start_px: Array, heading_rad: float, width_px: float) -> None:
    position = start_px
    for step in range(16):
        following = position + 24.0 * np.array([np.cos(heading_rad), np.sin(heading_rad)])
        start, end = np.rint(16.0 * np.array([position, following])).astype(int).tolist()
        cv2.line(canvas, start, end, 255, max(1, round(width_px)), cv2.LINE_AA, shift=4)
        position = following
        heading_rad += rng.normal(0.0, 0.22)
        width_px *= 0.93
        if width_px > 5.0 and step in (4, 9):
            _grow_vessel(canvas, rng, position, heading_rad + rng.choice([-0.8, 0.8]), width_px * 0.7)


SHAFT_RGBA, MARKER_RGBA = (0.13, 0.13, 0.145, 1.0), (0.0, 0.62, 0.70, 1.0)
STEEL_RGBA, DARK_STEEL_RGBA = (0.62, 0.63, 0.65, 1.0), (0.45, 0.46, 0.48, 1.0)
GREY_RGBA = (0.42, 0.42, 0.44, 1.0)  # of a worn or a bright shaft: twice as bright as a threshold on darkness accepts
BLUE_RGBA = (0.16, 0.27, 0.52, 1.0)
RING_LENGTH_M, RING_RADIUS_M = 0.0018, 0.00235
"""A ring about the fork's tines that shows about as many pixels as the coloured sphere: 9 mm² from the side."""
CELL_PX = 48  # texture pixels to a cell of the tag: some ten for each pixel of the image
WHITE, BLACK = 225, 22  # printed paper; white stays below saturation under the scene's light

Rgba = tuple[float, ...]


@dataclass(frozen=True)
class Part:
    """A convex mesh that the DH row `link` carries at `T_link_part`, shape (4, 4), in one colour or with a texture."""

    name: str
    link: str
    mesh: DrawnMesh
    colour_rgba: Rgba = (1.0, 1.0, 1.0, 1.0)
    texture_bgr: Image | None = None
    T_link_part: Array = field(default_factory=lambda: np.eye(4))


def make_parts(instrument: Instrument, chain: DHChain, perturbations: Perturbations) -> tuple[Part, ...]:
    """Build the parts for the chain's last four links: roll, wrist pitch, wrist yaw, jaw (as in dVRK tools).

    In the roll's frame the shaft runs along +y, away from the tip; in the wrist's frames the tip lies along +x and the
    jaws turn about z.
    """
    roll, wrist_pitch, wrist_yaw, jaw = (row.name for row in chain.rows[-4:])
    wrist_length_m = chain.rows[-3].a_m  # from the wrist's pitch axis to the tool's origin
    wrist_m, marker_m = instrument.wrist_radius_m, instrument.knuckle_radius_m
    T_roll_shaft = make_transform(rotation_z(np.pi / 2), np.zeros(3))
    # The jaw's frame is turned by its α of π/2 against the wrist's.
    T_jaw_wrist = make_transform(rotation_x(-np.pi / 2), np.zeros(3))
    shaft_m, length_m = instrument.shaft_radius_m, instrument.shaft_length_m
    shaft_end_m = 2.2 * wrist_m
    # Many short rings: TinyRenderer walks the bounding box of every triangle, and long ones are slow.
    rings_m = np.linspace(shaft_end_m + 0.0006, length_m, 60)
    shaft = revolve(np.append(shaft_end_m, rings_m), np.append(shaft_m - 0.0006, np.full(60, shaft_m)))
    collar = revolve(np.array([0.8 * wrist_m, shaft_end_m + 0.0002]), np.array([wrist_m, shaft_m - 0.0004]))
    fork_m = marker_m + 0.0004  # the fork's tines stand beside the distal marker
    bridge_x_m = -wrist_length_m + np.array([0.0, 0.3, 0.45]) * wrist_length_m
    bridge_z_m = np.array([0.9 * wrist_m, fork_m + 0.0003, fork_m])
    bridge = loft(bridge_x_m, np.array([0.9, 0.5, 0.3]) * wrist_m, bridge_z_m, roundness=2.6)
    tine = bar((-0.62 * wrist_length_m, 0.0006), 0.0005, 0.0003)
    tines = [tine.transformed(make_transform(np.eye(3), [0.0, 0.0, z_m])) for z_m in (-fork_m - 1e-4, fork_m + 1e-4)]
    # A jaw's blade runs from inside the distal marker to a rounded tip; thin across the hinge, wider along it.
    x = np.array([0.06, 0.4, 0.8, 0.93, 0.98, 1.0]) * instrument.jaw_length_m
    half_width = np.array([0.75, 0.95, 0.72, 0.55, 0.38, 0.12]) * instrument.jaw_radius_m
    half_thickness = np.array([0.5, 0.52, 0.42, 0.34, 0.24, 0.08]) * instrument.jaw_radius_m
    blade, aside_m = loft(x, half_thickness, half_width, roundness=2.8), 0.55 * instrument.jaw_radius_m
    left, right = (make_transform(np.eye(3), [0.0, y_m, 0.0]) for y_m in (-aside_m, aside_m))
    tip, ring_m, grey, blue = (perturbations[name] for name in ("tip", "ring", "shaft_grey", "shaft_blue"))
    shaft_rgba = _between(_between(SHAFT_RGBA, GREY_RGBA, grey), BLUE_RGBA, blue)
    parts = (
        Part("shaft", roll, shaft.transformed(T_roll_shaft), shaft_rgba),
        Part("collar", roll, collar.transformed(T_roll_shaft), STEEL_RGBA),
        Part("hinge", roll, sphere(wrist_m), DARK_STEEL_RGBA),
        Part("bridge", wrist_pitch, bridge, STEEL_RGBA),
        Part("left_tine", wrist_pitch, tines[0], STEEL_RGBA),
        Part("right_tine", wrist_pitch, tines[1], STEEL_RGBA),
        Part("knuckle", wrist_yaw, sphere(marker_m), _between(MARKER_RGBA, STEEL_RGBA, 1.0 if ring_m else tip)),
        Part("fixed_jaw", wrist_yaw, blade.transformed(left), STEEL_RGBA),
        Part("moving_jaw", jaw, blade.transformed(T_jaw_wrist @ right), STEEL_RGBA),
    )
    if not ring_m:
        return parts
    ends_m = -1e-3 * ring_m + 0.5 * RING_LENGTH_M * np.array([-1.0, 1.0])
    return (*parts, Part("ring", wrist_pitch, revolve(ends_m, np.full(2, RING_RADIUS_M)), MARKER_RGBA))


def _between(start: Rgba, end: Rgba, share: float) -> Rgba:
    """A colour on the way from one to another; exactly the first one at a share of 0."""
    return tuple(x + share * (y - x) for x, y in zip(start, end, strict=True))


def make_plate(fiducial: Fiducial) -> Part:
    """A profile's plate in the tag's frame: face at z = 0, x right, y up."""
    dictionary = tag_dictionary(fiducial.family)
    cells = cv2.aruco.generateImageMarker(dictionary, fiducial.id, dictionary.markerSize + 2)  # with its black border
    with_margin = np.pad(np.where(cells > 0, WHITE, BLACK).astype(np.uint8), 1, constant_values=WHITE)
    texture = with_margin.repeat(CELL_PX, axis=0).repeat(CELL_PX, axis=1)
    # A box 0.6 mm thick up to the face at z = 0, which alone shows the texture.
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    top = np.column_stack([corners * fiducial.plate_side_m / 2.0, np.zeros(4)])
    bottom = top - [0.0, 0.0, 0.0006]
    sheets = [top, bottom[::-1]]
    sheets += [np.array([bottom[i], bottom[(i + 1) % 4], top[(i + 1) % 4], top[i]]) for i in range(4)]
    vertices_m = np.concatenate(sheets)
    crosses = [np.cross(sheet[1] - sheet[0], sheet[2] - sheet[0]) for sheet in sheets]
    normals = np.repeat([cross / np.linalg.norm(cross) for cross in crosses], 4, axis=0)
    # The other sheets show the margin's corner.
    uv = np.concatenate([0.5 + corners / 2.0, np.full((20, 2), 0.01)])
    faces = (4 * np.arange(6)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    plate, texture_bgr = DrawnMesh(vertices_m, faces, normals, uv), np.repeat(texture[..., None], 3, axis=2)
    return Part("plate", fiducial.link, plate, texture_bgr=texture_bgr, T_link_part=fiducial.T_link_tag)

"""The instrument's parts and its fiducial plate: a mesh for each, the link that carries it, and how it looks.

The distal marker is a coloured sphere about the tool's origin. The parts that touch it are slimmer or stand beside
it. The camera sees nearly all of it, so its silhouette's centroid is the projection of the tool's origin.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from svmdist.errors import SimulationError
from svmdist.kinematics import DHChain
from svmdist.perturbations.chosen import UNPERTURBED, Perturbations
from svmdist.profile.robot import Fiducial, Instrument
from svmdist.samples import Image
from svmdist.simulation.meshes import DrawnMesh, bar, loft, revolve, sphere
from svmdist.transforms import Array, make_transform, rotation_x, rotation_z

SHAFT_RGBA = (0.13, 0.13, 0.145, 1.0)
STEEL_RGBA = (0.62, 0.63, 0.65, 1.0)
DARK_STEEL_RGBA = (0.45, 0.46, 0.48, 1.0)
MARKER_RGBA = (0.0, 0.62, 0.70, 1.0)
GREY_RGBA = (0.42, 0.42, 0.44, 1.0)
"""Of a worn or a bright shaft: twice as bright as a threshold on darkness accepts."""
BLUE_RGBA = (0.16, 0.27, 0.52, 1.0)
RING_LENGTH_M, RING_RADIUS_M = 0.0018, 0.00235
"""A ring about the fork's tines that shows about as many pixels as the coloured sphere: 9 mm² from the side."""
THICKNESS_M = 0.0006
CELL_PX = 48  # texture pixels to a cell of the tag: some ten for each pixel of the image
WHITE, BLACK = 225, 22  # printed paper; white stays below saturation under the scene's light

Rgba = tuple[float, float, float, float]


@dataclass(frozen=True)
class Part:
    """A convex mesh that the DH row `link` carries at `T_link_part`, shape (4, 4), in one colour or with a texture."""

    name: str
    link: str
    mesh: DrawnMesh
    colour_rgba: Rgba = (1.0, 1.0, 1.0, 1.0)
    texture_bgr: Image | None = None
    T_link_part: Array = field(default_factory=lambda: np.eye(4))


def make_parts(
    instrument: Instrument, chain: DHChain, perturbations: Perturbations = UNPERTURBED
) -> tuple[Part, ...]:
    """Build the parts for the chain's last four links: roll, wrist pitch, wrist yaw, jaw (as in dVRK tools).

    In the roll's frame the shaft runs along +y, away from the tip; in the wrist's frames the tip lies along +x and the
    jaws turn about z. Perturbations change colours: tip, ring, shaft_grey and shaft_blue.
    """
    roll, wrist_pitch, wrist_yaw, jaw = (row.name for row in chain.rows[-4:])
    wrist_length_m = chain.rows[-3].a_m  # from the wrist's pitch axis to the tool's origin
    wrist_m, marker_m = instrument.wrist_radius_m, instrument.knuckle_radius_m
    T_roll_shaft = make_transform(rotation_z(np.pi / 2), np.zeros(3))
    # The jaw's frame is turned by its α of π/2 against the wrist's.
    T_jaw_wrist = make_transform(rotation_x(-np.pi / 2), np.zeros(3))
    shaft_m, length_m = instrument.shaft_radius_m, instrument.shaft_length_m
    neck_m = 2.2 * wrist_m
    # Many short rings: TinyRenderer walks the bounding box of every triangle, and long ones are slow.
    rings_m = np.linspace(neck_m + 0.0006, length_m, 60)
    shaft = revolve(np.append(neck_m, rings_m), np.append(shaft_m - 0.0006, np.full(60, shaft_m)))
    collar = revolve(np.array([0.8 * wrist_m, neck_m + 0.0002]), np.array([wrist_m, shaft_m - 0.0004]))
    fork_m = marker_m + 0.0004  # the fork's tines stand beside the distal marker
    bridge_x_m = -wrist_length_m + np.array([0.0, 0.3, 0.45]) * wrist_length_m
    bridge_z_m = np.array([0.9 * wrist_m, fork_m + 0.0003, fork_m])
    bridge = loft(bridge_x_m, np.array([0.9, 0.5, 0.3]) * wrist_m, bridge_z_m, roundness=2.6)
    tine = bar((-0.62 * wrist_length_m, 0.0006), 0.0005, 0.0003)
    tines = [tine.transformed(_shift(0.0, side * (fork_m + 0.0001))) for side in (-1.0, 1.0)]
    # A jaw's blade runs from inside the distal marker to a rounded tip; thin across the hinge, wider along it.
    x = np.array([0.06, 0.4, 0.8, 0.93, 0.98, 1.0]) * instrument.jaw_length_m
    half_width = np.array([0.75, 0.95, 0.72, 0.55, 0.38, 0.12]) * instrument.jaw_radius_m
    half_thickness = np.array([0.5, 0.52, 0.42, 0.34, 0.24, 0.08]) * instrument.jaw_radius_m
    blade, aside_m = loft(x, half_thickness, half_width, roundness=2.8), 0.55 * instrument.jaw_radius_m
    tip, ring_m, grey, blue = (perturbations[name] for name in ("tip", "ring", "shaft_grey", "shaft_blue"))
    shaft_rgba = _between(_between(SHAFT_RGBA, GREY_RGBA, grey), BLUE_RGBA, blue)
    tip_rgba = _between(MARKER_RGBA, STEEL_RGBA, 1.0 if ring_m else tip)
    parts = (
        Part("shaft", roll, shaft.transformed(T_roll_shaft), shaft_rgba),
        Part("collar", roll, collar.transformed(T_roll_shaft), STEEL_RGBA),
        Part("hinge", roll, sphere(wrist_m), DARK_STEEL_RGBA),
        Part("bridge", wrist_pitch, bridge, STEEL_RGBA),
        Part("left_tine", wrist_pitch, tines[0], STEEL_RGBA),
        Part("right_tine", wrist_pitch, tines[1], STEEL_RGBA),
        Part("knuckle", wrist_yaw, sphere(marker_m), tip_rgba),
        Part("fixed_jaw", wrist_yaw, blade.transformed(_shift(-aside_m, 0.0)), STEEL_RGBA),
        Part("moving_jaw", jaw, blade.transformed(T_jaw_wrist @ _shift(aside_m, 0.0)), STEEL_RGBA),
    )
    if not ring_m:
        return parts
    ends_m = -1e-3 * ring_m + 0.5 * RING_LENGTH_M * np.array([-1.0, 1.0])
    return (*parts, Part("ring", wrist_pitch, revolve(ends_m, np.full(2, RING_RADIUS_M)), MARKER_RGBA))


def _shift(y_m: float, z_m: float) -> Array:
    return make_transform(np.eye(3), [0.0, y_m, z_m])


def _between(start: Rgba, end: Rgba, share: float) -> Rgba:
    """A colour on the way from one to another; exactly the first one at a share of 0."""
    r, g, b, a = (x + share * (y - x) for x, y in zip(start, end, strict=True))
    return r, g, b, a


def make_plate(fiducial: Fiducial) -> Part:
    """Make the fiducial plate of a profile in the tag's frame: the face at z = 0, x to the right and y up.

    Raises SimulationError for a tag that the family does not have.
    """
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{fiducial.family}"))
    count = len(dictionary.bytesList)
    if fiducial.id >= count:
        raise SimulationError(
            f"no tag {fiducial.id} in the family {fiducial.family}: its ids go from 0 to {count - 1}"
        )
    cell_count = dictionary.markerSize + 2  # with the black border of one cell
    cells = cv2.aruco.generateImageMarker(dictionary, fiducial.id, cell_count)
    with_margin = np.pad(np.where(cells > 0, WHITE, BLACK).astype(np.uint8), 1, constant_values=WHITE)
    texture = with_margin.repeat(CELL_PX, axis=0).repeat(CELL_PX, axis=1)
    # A box from z = -THICKNESS_M to the face at z = 0, which alone shows the texture.
    half_m = fiducial.plate_side_m / 2.0
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    top = np.column_stack([corners * half_m, np.zeros(4)])
    bottom = top - [0.0, 0.0, THICKNESS_M]
    sheets = [top, bottom[::-1]]
    sheets += [np.array([bottom[i], bottom[(i + 1) % 4], top[(i + 1) % 4], top[i]]) for i in range(4)]
    vertices_m = np.concatenate(sheets)
    crosses = [np.cross(sheet[1] - sheet[0], sheet[2] - sheet[0]) for sheet in sheets]
    normals = np.repeat([cross / np.linalg.norm(cross) for cross in crosses], 4, axis=0)
    # The other sheets show the margin's corner.
    uv = np.concatenate([0.5 + corners / 2.0, np.full((20, 2), 0.01)])
    halves = np.array([[0, 1, 2], [0, 2, 3]])
    faces = (4 * np.arange(6)[:, None, None] + halves).reshape(-1, 3)
    plate, texture_bgr = DrawnMesh(vertices_m, faces, normals, uv), np.repeat(texture[..., None], 3, axis=2)
    return Part("plate", fiducial.link, plate, texture_bgr=texture_bgr, T_link_part=fiducial.T_link_tag)

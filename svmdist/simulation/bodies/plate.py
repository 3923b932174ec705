"""The fiducial plate on the instrument: a thin white box whose face carries a tag.

It lives in the tag's frame: the face at z = 0, x to the right and y up as one reads the tag.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from svmdist.errors import SimulationError
from svmdist.profile import Fiducial
from svmdist.samples import Image
from svmdist.simulation.bodies.meshes import DrawnMesh
from svmdist.transforms import Array

THICKNESS_M = 0.0006
CELL_PX = 48
"""Texture pixels to a cell of the tag: some ten for each pixel of the image."""
WHITE, BLACK = 225, 22
"""Printed paper; white stays below saturation under the scene's light."""

_DICTIONARIES = {
    "16h5": cv2.aruco.DICT_APRILTAG_16h5,
    "25h9": cv2.aruco.DICT_APRILTAG_25h9,
    "36h10": cv2.aruco.DICT_APRILTAG_36h10,
    "36h11": cv2.aruco.DICT_APRILTAG_36h11,
}


@dataclass(frozen=True)
class Plate:
    """The plate's mesh in the tag's frame, what is printed on it, and where a link carries it."""

    mesh: DrawnMesh
    texture: Image
    link: str
    T_link_tag: Array


def make_plate(fiducial: Fiducial) -> Plate:
    """Make the plate of a profile; raises SimulationError for a tag that the family does not have."""
    dictionary = cv2.aruco.getPredefinedDictionary(_DICTIONARIES[fiducial.family])
    count = len(dictionary.bytesList)
    if fiducial.id >= count:
        raise SimulationError(
            f"no tag {fiducial.id} in the family {fiducial.family}: its ids go from 0 to {count - 1}"
        )
    cell_count = dictionary.markerSize + 2  # with the black border of one cell
    cells = cv2.aruco.generateImageMarker(dictionary, fiducial.id, cell_count)
    with_margin = np.pad(np.where(cells > 0, WHITE, BLACK).astype(np.uint8), 1, constant_values=WHITE)
    texture = with_margin.repeat(CELL_PX, axis=0).repeat(CELL_PX, axis=1)
    texture_bgr = np.repeat(texture[..., None], 3, axis=2)
    return Plate(_box(fiducial.plate_side_m), texture_bgr, fiducial.link, fiducial.T_link_tag)


def _box(side_m: float) -> DrawnMesh:
    """A box from z = -THICKNESS_M to the face at z = 0, which alone shows the texture."""
    half_m = side_m / 2.0
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
    return DrawnMesh(vertices_m, faces, normals, uv)

"""What stands at each pixel of a drawn image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.simulation.views import FAR_M, NEAR_M
from svmdist.transforms import Array

NO_PART = -1
Points = NDArray[np.float32]
"""Images of places, shape (h, w, 3): a float32 tells 10 nm at 0.1 m."""


@dataclass(frozen=True)
class Surfaces:
    """A pinhole image's depths along the optical axis in m, float32 (h, w), and the parts of instruments that it shows.

    `behind_m` is the depth of tissue and floor, also where something is before them; `is_still` where they are seen.
    `part`, int16 (h, w), numbers the frames `T_camera_part`, shape (4, 4) each; `NO_PART` stands for anything else.
    """

    camera: Camera
    depth_m: NDArray[np.float32]
    behind_m: NDArray[np.float32]
    is_still: NDArray[np.bool_]
    part: NDArray[np.int16]
    T_camera_part: tuple[Array, ...]

    def points_m(self, depth_m: NDArray[np.float32]) -> Points:
        """What pixels show, in the camera's frame, shape (h, w, 3), by their depths, shape (h, w)."""
        K = self.camera.K
        column, row = np.arange(depth_m.shape[1]), np.arange(depth_m.shape[0])
        x = ((column - K[0, 2]) / K[0, 0]).astype(np.float32) * depth_m
        y = ((row - K[1, 2]) / K[1, 1]).astype(np.float32)[:, None] * depth_m
        return np.stack([x, y, depth_m], -1)


def metric_depth_m(buffer: NDArray[np.float32]) -> NDArray[np.float32]:
    """Depths along the optical axis in m of OpenGL's depth buffer, 0 at NEAR_M and 1 at FAR_M."""
    return np.asarray(FAR_M * NEAR_M / (FAR_M - buffer.astype(np.float64) * (FAR_M - NEAR_M)), np.float32)

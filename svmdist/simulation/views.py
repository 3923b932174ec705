"""The project's pinhole camera as OpenGL's view and projection matrices, written column by column."""

from __future__ import annotations

import numpy as np

from svmdist.camera import R_OPENGL_OPENCV, Camera
from svmdist.transforms import Array, inverse

NEAR_M, FAR_M = 0.01, 0.4
R4_OPENGL_OPENCV: Array = np.block([[R_OPENGL_OPENCV, np.zeros((3, 1))], [np.zeros((1, 3)), 1.0]])

PIXEL_SHIFT = {"tiny": (-0.5, 0.5), "egl": (0.0, 0.0)}
"""Where each renderer puts a pixel's centre, against OpenGL: TinyRenderer samples pixels at a corner.
Measured with silhouettes of spheres all over the image, which agree with `Camera.project` to 0.03 px."""


def view_matrix(T_world_camera: Array) -> list[float]:
    """OpenGL's view matrix, 16 numbers, of a camera that stands at `T_world_camera`, shape (4, 4)."""
    return [float(value) for value in (R4_OPENGL_OPENCV @ inverse(T_world_camera)).T.ravel()]


def projection_matrix(camera: Camera, shift_px: tuple[float, float]) -> list[float]:
    """OpenGL's projection matrix, 16 numbers, for the intrinsics K, moved by `shift_px`.

    OpenGL puts the image's borders at -1 and 1; in pixel coordinates they lie at -0.5 and size - 0.5.
    """
    width, height, K = camera.width_px, camera.height_px, camera.K
    centre_x, centre_y = K[0, 2] + 0.5 + shift_px[0], K[1, 2] + 0.5 + shift_px[1]
    P = np.zeros((4, 4))
    P[0, 0], P[0, 2] = 2.0 * K[0, 0] / width, 1.0 - 2.0 * centre_x / width
    P[1, 1], P[1, 2] = 2.0 * K[1, 1] / height, 2.0 * centre_y / height - 1.0
    P[2, 2], P[2, 3] = (FAR_M + NEAR_M) / (NEAR_M - FAR_M), 2.0 * FAR_M * NEAR_M / (NEAR_M - FAR_M)
    P[3, 2] = -1.0
    return [float(value) for value in P.T.ravel()]

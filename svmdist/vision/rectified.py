"""The geometry of a rectified stereo pair: rows correspond, and disparity is depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.camera import Camera
from svmdist.results import Failure
from svmdist.samples import RightView
from svmdist.transforms import Array

MAX_OFF_AXIS = 0.02
"""A right camera this far above, below, before or behind the left one, over the baseline, counts as beside it: rows of
both views then differ by half a pixel at a disparity of 25 px."""


@dataclass(frozen=True, slots=True)
class RectifiedPair:
    """The left camera's K, shape (3, 3), the baseline, and how far the principal points stand apart."""

    K: Array
    baseline_m: float
    offset_px: float

    def disparity_px(self, left_x_px: float, right_x_px: float) -> float:
        """Disparity of a point seen in both images, as if the principal points were one."""
        return left_x_px - right_x_px - self.offset_px

    def disparity_at(self, depth_m: float) -> float:
        """Disparity in px at a depth: f b / z."""
        return float(self.K[0, 0] * self.baseline_m / depth_m)

    def point(self, left_px: Array, disparity_px: float) -> tuple[Array, Array]:
        """The point of a left pixel (2,) and a disparity, (3,) in m, and its Jacobian by (u, v, d), (3, 3)."""
        fx, fy = self.K[0, 0], self.K[1, 1]
        z = fx * self.baseline_m / disparity_px
        x, y = (left_px[0] - self.K[0, 2]) / fx, (left_px[1] - self.K[1, 2]) / fy
        p_camera_m = np.array([x * z, y * z, z])
        J = np.zeros((3, 3))
        J[0, 0], J[1, 1] = z / fx, z / fy
        J[:, 2] = -p_camera_m / disparity_px
        return p_camera_m, J

    def points(self, left_px: Array, disparity_px: Array) -> Array:
        """Points of left pixels, shape (n, 2), and disparities, shape (n,): shape (n, 3) in m."""
        depth_m = self.K[0, 0] * self.baseline_m / disparity_px
        x = (left_px[:, 0] - self.K[0, 2]) / self.K[0, 0]
        y = (left_px[:, 1] - self.K[1, 2]) / self.K[1, 1]
        return np.stack([x * depth_m, y * depth_m, depth_m], -1)


def rectified_pair(left: Camera, right: RightView) -> RectifiedPair | Failure:
    """The pair's geometry; or what is wrong with it."""
    T, K, K_right = right.T_left_right, left.K, right.camera.K
    if T[0, 3] <= 0.0:
        return Failure("the right camera is not to the right of the left one: are the topics swapped?")
    if not np.allclose(T[:3, :3], np.eye(3), atol=1e-6):
        return Failure("the pair is not rectified: the right camera is turned")
    if np.abs(T[1:3, 3]).max() > MAX_OFF_AXIS * T[0, 3]:
        return Failure("the right camera is not beside the left one, along its x axis")
    same_focal = np.allclose(np.delete(K - K_right, 2, axis=1), 0.0, atol=1e-3)
    if not same_focal or abs(K[1, 2] - K_right[1, 2]) > 1e-3:
        return Failure("the pair is not rectified: focal lengths or rows of the principal points differ")
    if left.has_distortion or right.camera.has_distortion:
        return Failure("the pair is not rectified: the images are distorted")
    return RectifiedPair(K, float(T[0, 3]), float(K[0, 2] - K_right[0, 2]))

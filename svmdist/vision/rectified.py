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
both views then differ by half a pixel at a disparity of 25 px. Further off, both views are turned."""
MAX_TURN = 0.7
"""Sine of the angle between the baseline and the left camera's x axis beyond which it is no pair of a left and a right
view: turned by 45 degrees they would share little of what they show."""


@dataclass(frozen=True, slots=True)
class RectifiedPair:
    """The left camera's K, shape (3, 3), the baseline, and how far the principal points stand apart.

    Rows correspond in views turned by `R_rows_left`, shape (3, 3), None where they do as they are. Points are in the
    left camera's frame, and pixels those of the left view, in any case.
    """

    K: Array
    baseline_m: float
    offset_px: float
    R_rows_left: Array | None = None

    def homography(self, *, right: bool = False) -> Array:
        """What turns a view's pixels into those whose rows correspond, shape (3, 3)."""
        if self.R_rows_left is None:
            return np.eye(3)
        K = self.K.copy()
        K[0, 2] -= self.offset_px * right
        return np.asarray(K @ self.R_rows_left @ np.linalg.inv(K))

    def to_rows(self, pixel: Array, *, right: bool = False) -> Array:
        """A pixel (2,) of a view where rows correspond."""
        if self.R_rows_left is None:
            return pixel
        x, y, w = self.homography(right=right) @ np.array([pixel[0], pixel[1], 1.0])
        return np.array([x / w, y / w])

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
        u, v = self.to_rows(left_px)
        x, y = (u - self.K[0, 2]) / fx, (v - self.K[1, 2]) / fy
        p_rows_m = np.array([x * z, y * z, z])
        J = np.zeros((3, 3))
        J[0, 0], J[1, 1] = z / fx, z / fy
        J[:, 2] = -p_rows_m / disparity_px
        if self.R_rows_left is None:
            return p_rows_m, J
        moved = [self.to_rows(left_px + step) - self.to_rows(left_px - step) for step in 0.5 * np.eye(2)]
        J[:, :2] = J[:, :2] @ np.stack(moved, -1)
        return self.R_rows_left.T @ p_rows_m, self.R_rows_left.T @ J

    def depth_m(self, p_camera_m: Array) -> tuple[float, Array]:
        """A point's depth where rows correspond, which its disparity tells, and its derivative by the point, (3,)."""
        along = np.array([0.0, 0.0, 1.0]) if self.R_rows_left is None else self.R_rows_left[2]
        return float(along @ p_camera_m), along

    def points(self, rows_px: Array, disparity_px: Array) -> Array:
        """Points of pixels of the left view where rows correspond, shape (n, 2), and disparities (n,): (n, 3) in m."""
        depth_m = self.K[0, 0] * self.baseline_m / disparity_px
        x = (rows_px[:, 0] - self.K[0, 2]) / self.K[0, 0]
        y = (rows_px[:, 1] - self.K[1, 2]) / self.K[1, 1]
        points_m = np.stack([x * depth_m, y * depth_m, depth_m], -1)
        return points_m if self.R_rows_left is None else np.asarray(points_m @ self.R_rows_left)


def rectified_pair(left: Camera, right: RightView) -> RectifiedPair | Failure:
    """The pair's geometry; or what is wrong with it."""
    T, K, K_right = right.T_left_right, left.K, right.camera.K
    if T[0, 3] <= 0.0:
        return Failure("the right camera is not to the right of the left one: are the topics swapped?")
    if not np.allclose(T[:3, :3], np.eye(3), atol=1e-6):
        return Failure("the pair is not rectified: the right camera is turned")
    baseline_m = float(np.linalg.norm(T[:3, 3]))
    if np.linalg.norm(T[1:3, 3]) > MAX_TURN * baseline_m:
        return Failure("the right camera is not beside the left one: it is above, below, before or behind it")
    R_rows_left = None
    if np.abs(T[1:3, 3]).max() > MAX_OFF_AXIS * T[0, 3]:
        R_rows_left = _rows_along(T[:3, 3] / baseline_m)
    same_focal = np.allclose(np.delete(K - K_right, 2, axis=1), 0.0, atol=1e-3)
    if not same_focal or abs(K[1, 2] - K_right[1, 2]) > 1e-3:
        return Failure("the pair is not rectified: focal lengths or rows of the principal points differ")
    if left.has_distortion or right.camera.has_distortion:
        return Failure("the pair is not rectified: the images are distorted")
    along_m = float(T[0, 3]) if R_rows_left is None else baseline_m
    return RectifiedPair(K, along_m, float(K[0, 2] - K_right[0, 2]), R_rows_left)


def _rows_along(x: Array) -> Array:
    """The rotation, shape (3, 3), from the left camera to one whose x axis is `x`, with little else turned."""
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)])

"""What an image says about a link of the robot, as a filter takes it: residual, derivative, covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.cylinder import tangent_normal
from svmdist.transforms import Array, rotation_of, rotation_vector

MIN_DEPTH_M = 1e-3
STEP = 1e-6
"""Step of the central differences in m and rad: truncation and rounding are both below 1e-8 px of it."""


class LinkObservation(Protocol):
    """An observation of the frame of the DH row `link`, or of the tool where that is None."""

    @property
    def name(self) -> str:
        """What was observed, for a person."""

    @property
    def link(self) -> str | None:
        """The DH row whose frame was observed."""

    @property
    def covariance(self) -> Array:
        """Covariance of the residual, shape (m, m), in px²."""

    def residual(self, T_camera_link: Array) -> Array:
        """Measured minus predicted, shape (k, m) in px, for poses (k, 4, 4); inf where nothing can be seen."""


@dataclass(frozen=True, slots=True)
class PointsObservation:
    """Points of a link seen at pixels: the coloured region's centroid, or the corners of a tag.

    `p_link_m` has shape (n, 3), `pixels` (n, 2), the covariance (2n, 2n) in px², rows x1, y1, x2, …
    """

    name: str
    link: str | None
    camera: Camera
    p_link_m: Array
    pixels: Array
    covariance: Array

    def residual(self, T_camera_link: Array) -> Array:
        """Measured minus projected, shape (k, 2n), for poses of shape (k, 4, 4)."""
        p_camera_m = (
            self.p_link_m @ np.swapaxes(T_camera_link[:, :3, :3], 1, 2) + T_camera_link[:, None, :3, 3]
        )
        hidden = p_camera_m[..., 2].min(-1) < MIN_DEPTH_M
        p_camera_m[hidden] = np.array([0.0, 0.0, 1.0])
        projected = self.camera.project(p_camera_m.reshape(-1, 3)).reshape(len(T_camera_link), -1)
        return np.where(hidden[:, None], np.inf, self.pixels.ravel() - projected)


@dataclass(frozen=True, slots=True)
class ContourObservation:
    """One edge of the shaft's silhouette: the straight line through two pixels of an undistorted image.

    `pixels`, shape (2, 2), are where the observed stretch begins and ends, each uncertain across the line
    with `covariance`, shape (2, 2) in px². The shaft is a cylinder of `radius_m` about an axis of the link:
    `p_axis_m` and `axis`, shape (3,), in the link's frame, towards the tip. `side` tells the edges apart:
    +1 for the one to the right of the axis as it runs through the image, y being down, -1 for the left.
    """

    name: str
    link: str | None
    camera: Camera
    pixels: Array
    covariance: Array
    p_axis_m: Array
    axis: Array
    radius_m: float
    side: int

    def residual(self, T_camera_link: Array) -> Array:
        """Distances of the two pixels from the predicted edge, shape (k, 2), for poses of shape (k, 4, 4)."""
        axis = T_camera_link[:, :3, :3] @ self.axis
        p_axis_m = T_camera_link[:, :3, :3] @ self.p_axis_m + T_camera_link[:, :3, 3]
        line = tangent_normal(p_axis_m, axis, self.radius_m, self.side) @ np.linalg.inv(self.camera.K)
        distances = line[:, :2] @ self.pixels.T + line[:, 2:]
        return np.nan_to_num(distances / np.hypot(line[:, 0], line[:, 1])[:, None], nan=np.inf)


@dataclass(frozen=True, slots=True)
class PoseObservation:
    """A pose that was measured as a whole: `T_camera_seen` of a frame fixed on a link by `T_link_seen`, (4, 4).

    The covariance, shape (6, 6), is that of (δp, δθ) in the camera frame, as in `ToolPose`.
    """

    name: str
    link: str | None
    T_link_seen: Array
    T_camera_seen: Array
    covariance: Array

    def residual(self, T_camera_link: Array) -> Array:
        """(δp, δθ) from predicted to measured, shape (k, 6) in m and rad, for poses of shape (k, 4, 4)."""
        predicted = T_camera_link @ self.T_link_seen
        turns = self.T_camera_seen[:3, :3] @ np.swapaxes(predicted[:, :3, :3], 1, 2)
        return np.hstack([self.T_camera_seen[:3, 3] - predicted[:, :3, 3], rotation_vector(turns)])


def pose_derivative(observation: LinkObservation, T_camera_link: Array) -> Array:
    """Derivative of the residual by (δp, δθ) of the link's pose in the camera frame, shape (m, 6).

    Central differences: exact to 1e-6 of what they are, and one formula for every kind of observation.
    """
    poses = np.repeat(T_camera_link[None], 12, axis=0)
    for index, step in enumerate((STEP, -STEP)):
        for column in range(3):
            poses[2 * column + index, column, 3] += step
            turn = rotation_of(step * np.eye(3)[column])
            poses[6 + 2 * column + index, :3, :3] = turn @ T_camera_link[:3, :3]
    residuals = observation.residual(poses)
    if not np.all(np.isfinite(residuals)):
        return np.full((residuals.shape[1], 6), np.nan)
    return np.asarray((residuals[0::2] - residuals[1::2]).T / (2.0 * STEP))

"""What an image says about a link of the robot, as a filter takes it: residual, derivatives, covariance.

`covariance` is that of what changes from frame to frame. What stays alike, an observation's own error, is a vector of
numbers of variance one that lasts for `own_s` seconds; `spread` turns it into the residual's unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from svmdist.camera import Camera
from svmdist.transforms import Array, rotation_vector, transform_points
from svmdist.vision.cylinder import tangent_normal
from svmdist.vision.sphere import apparent_radius_px

MIN_DEPTH_M = 1e-3
POINT_S = 30.0
"""What hides a part of the knuckle is fixed to it: its visible middle stays where it is on the tool."""
EDGE_S = 30.0
"""Shading beside an edge changes as the shaft turns in the light: in logs of 8 s hardly."""
POSE_S = 0.5
"""How a mark's edges fall on the pixels changes with every pixel of motion."""


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
        """Covariance of the residual's noise, shape (m, m)."""

    @property
    def own(self) -> str:
        """Observations of one such name have the same error of their own."""

    @property
    def own_s(self) -> float:
        """How long that lasts, in s: the time constant of its fading."""

    def spread(self, T_camera_link: Array, by_pose: Array, /) -> Array:
        """Derivative of the residual by the own error, (m, k), from the pose and the residual's derivative (m, 6)."""

    def residual(self, T_camera_link: Array) -> Array:
        """Measured minus predicted, shape (k, m), for poses (k, 4, 4); inf where nothing can be seen."""


@dataclass(frozen=True, slots=True)
class PointsObservation:
    """Points of a link seen at pixels: the coloured region's centroid, or the corners of a tag.

    `p_link_m` has shape (n, 3), `pixels` (n, 2), the covariance (2n, 2n) in px², rows x1, y1, x2, … The points may
    all be off by one offset fixed in the link's frame, of deviation `point_std_m` along each axis.
    """

    name: str
    link: str | None
    camera: Camera
    p_link_m: Array
    pixels: Array
    covariance: Array
    point_std_m: float = 0.0
    shade_px: float = 0.0
    own: str = "point"
    own_s: float = POINT_S

    def spread(self, T_camera_link: Array, by_pose: Array) -> Array:
        """Derivative by offset and shade, shape (2n, 4), in units of their deviations."""
        tilt = (self.pixels - self.camera.K[:2, 2]) / self.camera.K[[0, 1], [0, 1]]
        offset = -self.point_std_m * by_pose[:, :3] @ T_camera_link[:3, :3]
        return np.column_stack([offset, self.shade_px * tilt.ravel()])

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
class DisparityObservation:
    """How far apart, in px along x, the two views of a stereo pair show the origin of a link.

    `T_right_left` maps the left camera's coordinates to the right one's; the covariance has shape (1, 1) in px².
    The point may be off as in `PointsObservation`: the two rays differ in tilt by the disparity over the focal length.
    """

    name: str
    link: str | None
    left: Camera
    right: Camera
    T_right_left: Array
    disparity_px: float
    covariance: Array
    point_std_m: float = 0.0
    shade_px: float = 0.0
    own: str = "point"
    own_s: float = POINT_S

    def spread(self, T_camera_link: Array, by_pose: Array) -> Array:
        """Derivative by offset and shade, shape (1, 4), in units of their deviations."""
        offset = -self.point_std_m * by_pose[:, :3] @ T_camera_link[:3, :3]
        return np.column_stack([offset, [[self.shade_px * self.disparity_px / self.left.K[0, 0]]]])

    def residual(self, T_camera_link: Array) -> Array:
        """Measured minus predicted, shape (k, 1), for poses of shape (k, 4, 4)."""
        p_left_m = T_camera_link[:, :3, 3]
        p_right_m = transform_points(self.T_right_left, p_left_m)
        hidden = np.minimum(p_left_m[:, 2], p_right_m[:, 2]) < MIN_DEPTH_M
        ahead = np.array([0.0, 0.0, 1.0])
        left_px = self.left.project(np.where(hidden[:, None], ahead, p_left_m))
        right_px = self.right.project(np.where(hidden[:, None], ahead, p_right_m))
        off_px = self.disparity_px - (left_px[:, 0] - right_px[:, 0])
        return np.where(hidden, np.inf, off_px)[:, None]


@dataclass(frozen=True, slots=True)
class SizeObservation:
    """The radius in px of the disc that a sphere of `radius_m` about a link's origin shows.

    The covariance has shape (1, 1) in px²; `own_px` is how far the radius is off for good, by what is hidden.
    """

    name: str
    link: str | None
    camera: Camera
    radius_m: float
    radius_px: float
    covariance: Array
    own_px: float
    own_s: float = POINT_S

    @property
    def own(self) -> str:
        """A size errs in its own way."""
        return self.name

    def spread(self, _T_camera_link: Array, _by_pose: Array, /) -> Array:
        """Derivative by the own error, shape (1, 1)."""
        return np.array([[self.own_px]])

    def residual(self, T_camera_link: Array) -> Array:
        """Measured minus predicted, shape (k, 1), for poses of shape (k, 4, 4)."""
        p_m = T_camera_link[:, :3, 3]
        hidden = p_m[:, 2] < MIN_DEPTH_M
        p_m = np.where(hidden[:, None], np.array([0.0, 0.0, 1.0]), p_m)
        predicted_px = apparent_radius_px(p_m, self.radius_m, self.camera)
        return np.where(hidden, np.inf, self.radius_px - predicted_px)[:, None]


@dataclass(frozen=True, slots=True)
class ContourObservation:
    """One edge of the shaft's silhouette: the plane through the camera's centre and the edge touches the shaft.

    `normal`, shape (3,), is that plane's unit normal in the camera frame, turned to the shaft's side; `across`, shape
    (2, 3), holds two unit vectors square to it, along which it errs by the covariance, shape (2, 2) in rad². The
    shaft is a cylinder of `radius_m` about an axis of the link: `p_axis_m` and `axis`, shape (3,), in the link's
    frame, towards the tip. `side` tells the edges apart: +1 for the one to the right of the axis as it runs through
    the image, y being down, -1 for the left.
    """

    name: str
    link: str | None
    normal: Array
    across: Array
    covariance: Array
    p_axis_m: Array
    axis: Array
    radius_m: float
    side: int
    systematic: Array
    """Covariance of the own error, shape (2, 2) in rad²: shading stays as long as the light falls on the edge so."""
    own_s: float = EDGE_S

    @property
    def own(self) -> str:
        """Each edge errs in its own way."""
        return self.name

    def spread(self, _T_camera_link: Array, _by_pose: Array, /) -> Array:
        """Derivative by the own error, shape (2, 2)."""
        return np.asarray(np.linalg.cholesky(self.systematic))

    def residual(self, T_camera_link: Array) -> Array:
        """By what the normal is off the predicted one, shape (k, 2) in rad, for poses of shape (k, 4, 4)."""
        axis = T_camera_link[:, :3, :3] @ self.axis
        p_axis_m = T_camera_link[:, :3, :3] @ self.p_axis_m + T_camera_link[:, :3, 3]
        off = (self.normal - tangent_normal(p_axis_m, axis, self.radius_m, self.side)) @ self.across.T
        return np.where(np.isnan(off), np.inf, off)


@dataclass(frozen=True, slots=True)
class PoseObservation:
    """A pose that was measured as a whole: `T_camera_seen` of a frame fixed on a link by `T_link_seen`, (4, 4).

    The covariances, shape (6, 6), are those of (δp, δθ) in the camera frame, as in `ToolPose`; `systematic` is that of
    the own error.
    """

    name: str
    link: str | None
    T_link_seen: Array
    T_camera_seen: Array
    covariance: Array
    systematic: Array
    own_s: float = POSE_S

    @property
    def own(self) -> str:
        """Each mark errs in its own way."""
        return self.name

    def spread(self, _T_camera_link: Array, _by_pose: Array, /) -> Array:
        """Derivative by the own error, shape (6, 6)."""
        return np.asarray(np.linalg.cholesky(self.systematic))

    def residual(self, T_camera_link: Array) -> Array:
        """(δp, δθ) from predicted to measured, shape (k, 6) in m and rad, for poses of shape (k, 4, 4)."""
        predicted = T_camera_link @ self.T_link_seen
        turns = self.T_camera_seen[:3, :3] @ np.swapaxes(predicted[:, :3, :3], 1, 2)
        return np.hstack([self.T_camera_seen[:3, 3] - predicted[:, :3, 3], rotation_vector(turns)])

"""Measurements of points and of a sphere: pixels, disparity, and apparent size."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.filter.constants import AHEAD_M, EXACT, MIN_DEPTH_M, Deviations, SharedBias
from svmdist.estimation.filter.measurement import ConstantBias, PoseResidual
from svmdist.profile.settings import FilterSettings
from svmdist.transforms import Array, skew
from svmdist.vision.sphere import apparent_radius_px

MARKER = "distal marker"
POINT_CORRELATION_TIME_S = FilterSettings().point_correlation_time_s


class _PointBias(ABC):
    """The bias of a point: an offset in its link's frame, and what shading does to its pixels."""

    bias_size: ClassVar[int] = 4
    source: ClassVar[str] = MARKER
    point_std_m: float
    shading_bias_px: float

    def bias_jacobian(self, T_camera_link: Array, derivative: Array, /) -> Array:
        """Derivative by offset and shading, shape (..., m, 4), in units of their deviations."""
        # An offset in the link's frame moves the point as the link's own motion would; shading goes with the tilt.
        bias = np.empty((*derivative.shape[:-1], 4))
        bias[..., :3] = derivative[..., :3] @ T_camera_link[..., :3, :3]
        bias[..., :3] *= -np.asarray(self.point_std_m)[..., None, None]
        bias[..., 3] = np.asarray(self.shading_bias_px)[..., None] * self._tilt()
        return bias

    @abstractmethod
    def _tilt(self) -> Array:
        """Tilt of the measured rays, shape (..., m): what shading is proportional to."""


@dataclass(frozen=True)
class PointsMeasurement(_PointBias):
    """Points of a link seen at pixels: the coloured region's centroid, or the corners of a tag.

    `p_link_m` has shape (n, 3), `pixels` (n, 2), the covariance (2n, 2n) in px², rows x1, y1, x2, … The points may
    all be off by one offset fixed in the link's frame, of deviation `point_std_m` along each axis. Shading may draw
    the pixels outward by `shading_bias_px` (a deviation) times the tilt of their ray.
    """

    STACKED: ClassVar[tuple[str, ...]] = (
        "p_link_m",
        "pixels",
        "covariance",
        "point_std_m",
        "shading_bias_px",
    )

    name: str
    link: str | None
    camera: Camera
    p_link_m: Array
    pixels: Array
    covariance: Array
    point_std_m: float = 0.0
    shading_bias_px: float = 0.0
    bias_name: str = "point"
    correlation_time_s: float = POINT_CORRELATION_TIME_S
    deviations: Deviations = EXACT
    delay_std_s: float = 0.0

    def linearise(self, T_camera_link: Array) -> PoseResidual:
        """Measured minus projected, shape (..., 2n), about poses (..., 4, 4)."""
        arm_m = self.p_link_m @ np.swapaxes(T_camera_link[..., :3, :3], -1, -2)
        p_camera_m = arm_m + T_camera_link[..., None, :3, 3]
        visible = p_camera_m[..., 2].min(-1) >= MIN_DEPTH_M
        if not visible.all():
            p_camera_m = np.where(visible[..., None, None], p_camera_m, AHEAD_M)
        projected, J = self.camera.project_with_derivative(p_camera_m)
        derivative = np.empty((*J.shape[:-1], 6))
        derivative[..., :3] = -J
        np.matmul(J, skew(arm_m), out=derivative[..., 3:])
        shape = (*J.shape[:-3], -1)
        return PoseResidual.where_visible(
            visible, (self.pixels - projected).reshape(shape), derivative.reshape(*shape, 6)
        )

    def shared_biases(self, T_camera_link: Array, /) -> tuple[SharedBias, ...]:
        """Focal length and principal point."""
        biases = self.deviations.of_pixels(self.pixels, self.camera)
        shape = (*T_camera_link.shape[:-2], 2 * self.pixels.shape[-2])
        return tuple(
            SharedBias(bias.name, bias.jacobian.reshape(*shape, bias.jacobian.shape[-1])) for bias in biases
        )

    def _tilt(self) -> Array:
        K = self.camera.K
        tilt = (self.pixels - K[:2, 2]) / K[[0, 1], [0, 1]]
        return np.asarray(tilt.reshape(*tilt.shape[:-2], -1))


@dataclass(frozen=True)
class DisparityMeasurement(_PointBias):
    """How far apart, in px along x, the two views of a stereo pair show a point of a link: `p_link_m`, shape (3,).

    `T_right_left` maps the left camera's coordinates to the right one's; the covariance has shape (1, 1) in px².
    The point may be off as in `PointsMeasurement`: the two rays differ in tilt by the disparity over the focal length.
    """

    STACKED: ClassVar[tuple[str, ...]] = (
        "T_right_left",
        "disparity_px",
        "covariance",
        "point_std_m",
        "shading_bias_px",
        "lasting_std_px",
        "p_link_m",
    )

    name: str
    link: str | None
    left: Camera
    right: Camera
    T_right_left: Array
    disparity_px: float
    covariance: Array
    point_std_m: float = 0.0
    shading_bias_px: float = 0.0
    bias_name: str = "point"
    correlation_time_s: float = POINT_CORRELATION_TIME_S
    deviations: Deviations = EXACT
    delay_std_s: float = 0.0
    lasting_std_px: float = 0.0
    p_link_m: Array = field(default_factory=lambda: np.zeros(3))

    def linearise(self, T_camera_link: Array) -> PoseResidual:
        """Measured minus predicted, shape (..., 1), about poses (..., 4, 4)."""
        R_right_left = self.T_right_left[..., :3, :3]
        arm_m = (T_camera_link[..., :3, :3] @ np.asarray(self.p_link_m)[..., None])[..., 0]
        p_left_m = arm_m + T_camera_link[..., :3, 3]
        p_right_m = (R_right_left @ p_left_m[..., None])[..., 0] + self.T_right_left[..., :3, 3]
        visible = np.minimum(p_left_m[..., 2], p_right_m[..., 2]) >= MIN_DEPTH_M
        if not visible.all():
            p_left_m = np.where(visible[..., None], p_left_m, AHEAD_M)
            p_right_m = np.where(visible[..., None], p_right_m, AHEAD_M)
        left_px, J_left = self.left.project_with_derivative(p_left_m)
        right_px, J_right = self.right.project_with_derivative(p_right_m)
        residual = self.disparity_px - (left_px[..., 0] - right_px[..., 0])
        derivative = np.zeros((*residual.shape, 1, 6))
        derivative[..., :3] = J_right[..., :1, :] @ R_right_left - J_left[..., :1, :]
        derivative[..., 3:] = -derivative[..., :3] @ skew(arm_m)
        return PoseResidual.where_visible(visible, residual[..., None], derivative)

    def shared_biases(self, T_camera_link: Array, /) -> tuple[SharedBias, ...]:
        """Focal length, baseline, the right camera's rotation, and what lasts of the disparity itself."""
        arm_m = (T_camera_link[..., :3, :3] @ np.asarray(self.p_link_m)[..., None])[..., 0]
        p_left_m = arm_m + T_camera_link[..., :3, 3]
        disparity_px = np.asarray(self.disparity_px, np.float64)
        biases = self.deviations.of_disparity_at(p_left_m, self.right, disparity_px, self.T_right_left)
        lasting = np.broadcast_to(
            np.asarray(self.lasting_std_px)[..., None, None], (*disparity_px.shape, 1, 1)
        )
        return (*biases, SharedBias("disparity of the marker", lasting, self.correlation_time_s))

    def _tilt(self) -> Array:
        return np.asarray(self.disparity_px / self.left.K[0, 0])[..., None]


@dataclass(frozen=True)
class SizeMeasurement(ConstantBias):
    """The radius in px of the disc that a sphere of `radius_m` about a link's origin shows.

    The covariance has shape (1, 1) in px²; `bias_std_px` is how far the radius is off for good, by what is hidden.
    """

    STACKED: ClassVar[tuple[str, ...]] = ("radius_m", "radius_px", "covariance", "bias_std_px")
    bias_size: ClassVar[int] = 1
    source: ClassVar[str] = MARKER

    name: str
    link: str | None
    camera: Camera
    radius_m: float
    radius_px: float
    covariance: Array
    bias_std_px: float
    correlation_time_s: float = POINT_CORRELATION_TIME_S
    deviations: Deviations = EXACT

    def linearise(self, T_camera_link: Array) -> PoseResidual:
        """Measured minus predicted, shape (..., 1), about poses (..., 4, 4)."""
        p_m = T_camera_link[..., :3, 3]
        visible = p_m[..., 2] >= MIN_DEPTH_M
        if not visible.all():
            p_m = np.where(visible[..., None], p_m, AHEAD_M)
        predicted_px = self._predicted_px(p_m)
        derivative = np.zeros((*predicted_px.shape, 1, 6))
        # Of f r |p|^½ z^(-3/2), by its logarithm.
        slope = 0.5 * p_m / np.sum(p_m * p_m, -1, keepdims=True)
        slope[..., 2] -= 1.5 / p_m[..., 2]
        derivative[..., 0, :3] = -predicted_px[..., None] * slope
        return PoseResidual.where_visible(visible, (self.radius_px - predicted_px)[..., None], derivative)

    def bias_jacobian(self, _T_camera_link: Array, derivative: Array, /) -> Array:
        """Derivative by the bias, shape (..., 1, 1)."""
        return np.broadcast_to(np.asarray(self.bias_std_px)[..., None, None], (*derivative.shape[:-1], 1))

    def shared_biases(self, _T_camera_link: Array, /) -> tuple[SharedBias, ...]:
        """Focal length and the sphere's radius."""
        return self.deviations.of_radius(np.asarray(self.radius_px, np.float64))

    def _predicted_px(self, p_m: Array) -> Array:
        return apparent_radius_px(p_m, 1.0, self.camera) * self.radius_m

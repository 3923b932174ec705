"""The kinds of measurements: points, a sphere's size, disparity, an edge of the shaft's silhouette, and a pose."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.instrument.measurement import (
    AHEAD_M,
    EXACT,
    MIN_DEPTH_M,
    Deviations,
    LinkMeasurement,
    PoseResidual,
    SharedBias,
    edge_by_radius,
)
from svmdist.profile.settings import FilterSettings
from svmdist.transforms import Array, cross, inverse_right_jacobian, rotation_vector, skew
from svmdist.vision.lines import apparent_radius_px

MARKER = "distal marker"
POINT_CORRELATION_TIME_S = FilterSettings().point_correlation_time_s


class _PointBias(LinkMeasurement):
    """The bias of a point: an offset in its link's frame, and what shading does to its pixels."""

    source = MARKER
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

    STACKED = ("p_link_m", "pixels", "covariance", "point_std_m", "shading_bias_px")

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

    STACKED = (
        "T_right_left", "disparity_px", "covariance", "point_std_m", "shading_bias_px", "lasting_std_px", "p_link_m",
    )  # fmt: skip

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
class SizeMeasurement(LinkMeasurement):
    """The radius in px of the disc that a sphere about a link's origin shows; `bias_std_px` lasts."""

    STACKED = ("radius_m", "radius_px", "covariance", "bias_std_px")
    source = MARKER

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
        predicted_px = apparent_radius_px(p_m, 1.0, self.camera) * self.radius_m
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


EDGE_CORRELATION_TIME_S = FilterSettings().edge_correlation_time_s
POSE_CORRELATION_TIME_S = 0.5


class _MatrixBias(LinkMeasurement):
    """A bias of the residual itself, of covariance `bias_covariance`, shape (m, m)."""

    bias_covariance: Array

    @cached_property
    def _bias_root(self) -> Array:
        covariance = np.asarray(self.bias_covariance)
        lasts = covariance.any(axis=(-2, -1))  # where nothing of an error lasts, there is no bias
        root = np.zeros_like(covariance)
        root[lasts] = np.linalg.cholesky(covariance[lasts])
        return root

    def bias_jacobian(self, _T_camera_link: Array, _derivative: Array, /) -> Array:
        """Derivative by the bias, shape (..., m, m)."""
        return self._bias_root


@dataclass(frozen=True)
class ContourMeasurement(_MatrixBias):
    """One edge of the shaft's silhouette: the plane through the camera's centre and the edge touches the shaft.

    `normal`, shape (3,), is that plane's unit normal in the camera frame, turned to the shaft's side; `across`, shape
    (2, 3), holds two unit vectors square to it, along which it errs by the covariance, shape (2, 2) in rad². The
    shaft is a cylinder of `radius_m` about an axis of the link: `p_axis_m` and `axis`, shape (3,), in the link's
    frame, towards the tip. `side` tells the edges apart: +1 for the one to the right of the axis as it runs through
    the image, y being down, -1 for the left. `bias_covariance`, shape (2, 2) in rad², is that of the bias: shading
    stays as long as the light falls on the edge so.
    """

    STACKED = (
        "normal", "across", "covariance", "p_axis_m", "axis", "radius_m", "side", "bias_covariance",
    )  # fmt: skip
    source = "shaft"

    name: str
    link: str | None
    normal: Array
    across: Array
    covariance: Array
    p_axis_m: Array
    axis: Array
    radius_m: float
    side: int
    bias_covariance: Array
    correlation_time_s: float = EDGE_CORRELATION_TIME_S
    focal_px: tuple[float, float] = (1.0, 1.0)
    deviations: Deviations = EXACT

    def linearise(self, T_camera_link: Array) -> PoseResidual:
        """By what the normal is off the predicted one, shape (..., 2) in rad, about poses (..., 4, 4).

        The predicted normal n obeys n · n = 1, n · d = 0 and n · p = r for the axis through p along d. With e = n x d
        their differentials give dn = -(n · dd) d + e ((n · dd) (d · p) - n · dp) / (e · p). It is NaN inside the shaft.
        """
        R = T_camera_link[..., :3, :3]
        d = (R @ self.axis[..., None])[..., 0]
        arm_m = (R @ self.p_axis_m[..., None])[..., 0]
        p_m = arm_m + T_camera_link[..., :3, 3]
        radius_m, side = np.asarray(self.radius_m)[..., None], np.asarray(self.side)[..., None]
        along_m = (d * p_m).sum(-1, keepdims=True)
        foot_m = p_m - along_m * d
        left_m = cross(d, foot_m)
        square = (foot_m * foot_m).sum(-1, keepdims=True)
        is_outside = square > radius_m**2
        beside_m = side * np.sqrt(np.where(is_outside, square - radius_m**2, np.nan))
        n = (radius_m * foot_m + beside_m * left_m) / square  # as `tangent_normal`
        e = (beside_m * foot_m - radius_m * left_m) / square
        # dd = δθ x d, so that n · dd = -e · δθ; dp = δp + δθ x arm, so that n · dp = n · δp + (arm x n) · δθ.
        by_pose = np.empty((*n.shape, 6))
        slope = e / beside_m
        by_pose[..., :3] = -slope[..., :, None] * n[..., None, :]
        by_pose[..., 3:] = d[..., :, None] * e[..., None, :]
        by_pose[..., 3:] -= slope[..., :, None] * (cross(arm_m, n) + along_m * e)[..., None, :]
        residual = (self.across @ (self.normal - n)[..., None])[..., 0]
        return PoseResidual.where_visible(is_outside[..., 0], residual, -(self.across @ by_pose))

    def shared_biases(self, T_camera_link: Array, /) -> tuple[SharedBias, ...]:
        """Focal length, principal point, and the shaft's radius."""
        R = T_camera_link[..., :3, :3]
        d = (R @ self.axis[..., None])[..., 0]
        p_m = (R @ self.p_axis_m[..., None])[..., 0] + T_camera_link[..., :3, 3]
        radius_m = np.asarray(self.radius_m, np.float64)
        by_radius = edge_by_radius(p_m, d, radius_m, np.asarray(self.side))
        return self.deviations.of_edge(self.normal, self.across, by_radius, radius_m, np.array(self.focal_px))


@dataclass(frozen=True)
class PoseMeasurement(_MatrixBias):
    """A pose measured as a whole: `T_camera_frame` of a frame fixed on a link by `T_link_frame`, (4, 4)."""

    STACKED = ("T_link_frame", "T_camera_frame", "covariance", "bias_covariance")
    source = "tag"

    name: str
    link: str | None
    T_link_frame: Array
    T_camera_frame: Array
    covariance: Array
    bias_covariance: Array
    correlation_time_s: float = POSE_CORRELATION_TIME_S
    focal_px: tuple[float, float] = (1.0, 1.0)
    deviations: Deviations = EXACT

    def linearise(self, T_camera_link: Array) -> PoseResidual:
        """(δp, δθ) from predicted to measured, shape (..., 6) in m and rad, about poses (..., 4, 4)."""
        predicted = T_camera_link @ self.T_link_frame
        turn = self.T_camera_frame[..., :3, :3] @ np.swapaxes(predicted[..., :3, :3], -1, -2)
        residual = np.empty((*predicted.shape[:-2], 6))
        residual[..., :3] = self.T_camera_frame[..., :3, 3] - predicted[..., :3, 3]
        residual[..., 3:] = rotation_vector(turn)
        derivative = np.zeros((*predicted.shape[:-2], 6, 6))
        derivative[..., :3, :3] = -np.eye(3)
        derivative[..., :3, 3:] = skew(predicted[..., :3, 3] - T_camera_link[..., :3, 3])
        # exp([φ]) exp([-δθ]) = exp([φ - J⁻¹ δθ]), J the right Jacobian (Solà 2018, "A micro Lie theory", sec. 4.3).
        derivative[..., 3:, 3:] = -inverse_right_jacobian(residual[..., 3:])
        return PoseResidual(residual, derivative)

    def shared_biases(self, _T_camera_link: Array, /) -> tuple[SharedBias, ...]:
        """Focal length, principal point, the tag's size and mounting."""
        return self.deviations.of_tag(self.T_camera_frame, np.array(self.focal_px))

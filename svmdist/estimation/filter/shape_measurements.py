"""Measurements of more than points: an edge of the shaft's silhouette, and a pose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from svmdist.estimation.filter.constants import EXACT, Deviations, SharedBias, edge_by_radius
from svmdist.estimation.filter.measurement import ConstantBias, PoseResidual
from svmdist.profile.settings import FilterSettings
from svmdist.transforms import Array, cross, inverse_right_jacobian, rotation_vector, skew

EDGE_CORRELATION_TIME_S = FilterSettings().edge_correlation_time_s
POSE_CORRELATION_TIME_S = FilterSettings().pose_correlation_time_s


class _MatrixBias(ConstantBias):
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

    STACKED: ClassVar[tuple[str, ...]] = (
        "normal", "across", "covariance", "p_axis_m", "axis", "radius_m", "side", "bias_covariance",
    )  # fmt: skip
    bias_size: ClassVar[int] = 2
    source: ClassVar[str] = "shaft"

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
    """A pose that was measured as a whole: `T_camera_frame` of a frame fixed on a link by `T_link_frame`, (4, 4).

    The covariances, shape (6, 6), are those of (δp, δθ) in the camera frame, as in `ToolPose`: of the noise, and of
    the bias.
    """

    STACKED: ClassVar[tuple[str, ...]] = ("T_link_frame", "T_camera_frame", "covariance", "bias_covariance")
    bias_size: ClassVar[int] = 6
    source: ClassVar[str] = "tag"

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

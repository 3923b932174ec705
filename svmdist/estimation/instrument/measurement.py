"""A measurement of a link: residual of its pose, derivative, noise, bias, and the calibration parameters all share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from svmdist.camera import Camera
from svmdist.profile import Profile
from svmdist.profile.hand_eye import BASELINE, FOCAL_LENGTH, PRINCIPAL_POINT, SHAFT_RADIUS, TAG_SIZE
from svmdist.profile.robot import CameraError
from svmdist.transforms import Array, skew

FOR_EVER_S = np.inf
MIN_DEPTH_M = 1e-3  # what is nearer to the camera, or behind it, has no image
AHEAD_M = np.array([0.0, 0.0, 1.0])  # in place of a point that cannot be seen, so that it has a projection
NEAR_M = 1e-3  # A camera is no nearer to an edge than this: it bounds a derivative


@dataclass(frozen=True, slots=True)
class SharedBias:
    """What an error that several measurements share does to a residual: the derivative, (..., m, k), by its name."""

    name: str
    jacobian: Array
    correlation_time_s: float = FOR_EVER_S

    def scaled(self, factor: float) -> SharedBias:
        """The same in another unit of the residual."""
        return SharedBias(self.name, factor * self.jacobian, self.correlation_time_s)


@dataclass(frozen=True)
class Deviations:
    """Standard deviations of the constants, as a profile states them; fractions are of the constant itself."""

    camera: CameraError
    shaft_radius_fraction: float = 0.0
    marker_radius_fraction: float = 0.0
    tag_size_fraction: float = 0.0
    tag_position_m: float = 0.0
    tag_rotation_rad: float = 0.0

    @classmethod
    def of(cls, profile: Profile) -> Deviations:
        """The profile's."""
        instrument, tag = profile.instrument, profile.fiducial
        return cls(
            profile.camera_error,
            0.0 if instrument is None else instrument.shaft_radius_std_fraction,
            0.0 if instrument is None else instrument.knuckle_radius_std_fraction,
            0.0 if tag is None else tag.size_std_fraction,
            0.0 if tag is None else tag.position_std_m,
            0.0 if tag is None else tag.rotation_std_rad,
        )

    def of_pixels(self, pixels: Array, camera: Camera) -> tuple[SharedBias, ...]:
        """Of projected points, shape (..., 2): focal length and principal point."""
        focal = self.camera.focal_std_fraction * (pixels - camera.K[:2, 2])
        centre = np.broadcast_to(self.camera.centre_std_px * np.eye(2), (*pixels.shape, 2))
        return SharedBias(FOCAL_LENGTH, focal[..., None]), SharedBias(PRINCIPAL_POINT, centre)

    def of_disparity(
        self, p_right_m: Array, slope_right: Array, disparity_px: Array, T_right_left: Array
    ) -> tuple[SharedBias, ...]:
        """Of x in the left view less x in the right one, shape (...): focal length, and how the right camera stands."""
        focal = self.camera.focal_std_fraction * disparity_px[..., None, None]
        baseline_m = T_right_left[..., :3, 3]
        by_baseline = -(slope_right * baseline_m).sum(-1) * self.camera.baseline_std_fraction
        by_turn = (slope_right[..., None, :] @ skew(p_right_m))[
            ..., 0, :
        ] * self.camera.right_rotation_std_rad
        return (
            SharedBias(FOCAL_LENGTH, focal),
            SharedBias(BASELINE, by_baseline[..., None, None]),
            SharedBias("right camera's rotation", by_turn[..., None, :]),
        )

    def of_disparity_at(
        self, p_left_m: Array, right: Camera, disparity_px: Array, T_right_left: Array
    ) -> tuple[SharedBias, ...]:
        """The same of the disparity of points in the left camera, shape (..., 3), as the right camera sees them."""
        p_right_m = (T_right_left[..., :3, :3] @ p_left_m[..., None])[..., 0] + T_right_left[..., :3, 3]
        p_right_m = np.where(p_right_m[..., 2:] >= MIN_DEPTH_M, p_right_m, AHEAD_M)
        _, slope = right.project_with_derivative(p_right_m)
        return self.of_disparity(p_right_m, slope[..., 0, :], disparity_px, T_right_left)

    def of_radius(self, radius_px: Array) -> tuple[SharedBias, ...]:
        """Of a sphere's apparent radius, shape (...): focal length and the sphere's radius."""
        return (
            SharedBias(FOCAL_LENGTH, self.camera.focal_std_fraction * radius_px[..., None, None]),
            SharedBias("marker radius", self.marker_radius_fraction * radius_px[..., None, None]),
        )

    def of_edge(
        self, normal: Array, across: Array, by_radius: Array, radius_m: Array, focal_px: Array
    ) -> tuple[SharedBias, ...]:
        """Of the plane through an edge, measured normal (..., 3), and its predicted one's derivative by the radius."""
        flat = normal * np.array([1.0, 1.0, 0.0])
        focal = -self.camera.focal_std_fraction * (across @ flat[..., None])
        centre = -self.camera.centre_std_px * across[..., :, 2:] * (normal[..., None, :2] / focal_px)
        radius = across @ (by_radius * radius_m[..., None])[..., None] * self.shaft_radius_fraction
        return (
            SharedBias(FOCAL_LENGTH, focal),
            SharedBias(PRINCIPAL_POINT, centre),
            SharedBias(SHAFT_RADIUS, radius),
        )

    def of_tag(self, T_camera_tag: Array, focal_px: Array) -> tuple[SharedBias, ...]:
        """Of a tag's pose, shape (..., 4, 4): focal length, principal point, the tag's size, and how it is mounted."""
        p_m, R = T_camera_tag[..., :3, 3], T_camera_tag[..., :3, :3]
        focal = np.zeros((*p_m.shape[:-1], 6, 1))
        focal[..., 2, 0] = -self.camera.focal_std_fraction * p_m[..., 2]
        turn = np.array([[0.0, -1.0 / focal_px[1]], [1.0 / focal_px[0], 0.0], [0.0, 0.0]])
        centre = np.empty((*p_m.shape[:-1], 6, 2))
        centre[..., 3:, :] = self.camera.centre_std_px * turn
        centre[..., :3, :] = (
            self.camera.centre_std_px * p_m[..., 2, None, None] * (np.eye(3)[:, :2] / focal_px)
        )
        size = np.zeros((*p_m.shape[:-1], 6, 1))
        size[..., :3, 0] = -self.tag_size_fraction * p_m
        mounting = np.zeros((*p_m.shape[:-1], 6, 6))
        mounting[..., :3, :3] = self.tag_position_m * R
        mounting[..., 3:, 3:] = self.tag_rotation_rad * R
        return (
            SharedBias(FOCAL_LENGTH, focal),
            SharedBias(PRINCIPAL_POINT, centre),
            SharedBias(TAG_SIZE, size),
            SharedBias("tag mounting", mounting),
        )


def edge_by_radius(p_axis_m: Array, axis: Array, radius_m: Array, side: Array) -> Array:
    """Derivative by the radius, shape (..., 3), of the normal of the plane that touches a cylinder on one side."""
    foot_m = p_axis_m - (axis * p_axis_m).sum(-1, keepdims=True) * axis
    square = (foot_m * foot_m).sum(-1)
    beside_m = side * np.sqrt(np.maximum(square - radius_m**2, NEAR_M**2))
    e = beside_m[..., None] * foot_m - radius_m[..., None] * (skew(axis) @ foot_m[..., None])[..., 0]
    return np.asarray(e / (square * beside_m)[..., None])


EXACT = Deviations(
    CameraError(
        focal_std_fraction=0.0, centre_std_px=0.0, baseline_std_fraction=0.0, right_rotation_std_rad=0.0
    )
)
"""Constants that are taken to be right."""


@dataclass(frozen=True, slots=True)
class PoseResidual:
    """Measured minus predicted (m,), derivative (m, 6) by (δp, δθ) in the camera frame; inf and NaN where unseen."""

    residual: Array
    derivative: Array

    @classmethod
    def unseen(cls, size: int) -> PoseResidual:
        """What has no image: behind the camera, or around it."""
        return cls(np.full(size, np.inf), np.full((size, 6), np.nan))


class LinkMeasurement(ABC):
    """A measurement of the frame of the DH row `link`, or of the tool where that is None.

    `covariance` is that of what changes from frame to frame, the noise, shape (..., m, m). What stays alike, the
    bias, is a vector of numbers of variance one that fade with the time constant `correlation_time_s`.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]
    source: ClassVar[str]  # the detection that it is made of
    name: str  # what was measured, for a person
    link: str | None
    covariance: Array
    correlation_time_s: float

    @property
    def bias_name(self) -> str:
        """Measurements of one such name share one bias."""
        return self.name

    @abstractmethod
    def linearise(self, T_camera_link: Array) -> PoseResidual:
        """Residual and derivative about poses of the link, shape (..., 4, 4)."""

    @abstractmethod
    def bias_jacobian(self, T_camera_link: Array, derivative: Array, /) -> Array:
        """Derivative of the residual by the bias, (..., m, k), from the pose and the pose's derivative."""

    @abstractmethod
    def shared_biases(self, T_camera_link: Array, /) -> tuple[SharedBias, ...]:
        """What errors of constants do to the residual."""

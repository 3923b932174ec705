"""A measurement of a link, linearised: residual, derivative, noise, bias, and calibration parameters that all share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from svmdist.camera import Camera
from svmdist.profile import Profile
from svmdist.profile.hand_eye import BASELINE, FOCAL_LENGTH, PRINCIPAL_POINT, TAG_SIZE
from svmdist.profile.robot import CameraError
from svmdist.transforms import Array, skew

RIGHT_ROTATION = "right camera's rotation"
FOR_EVER_S = np.inf
ONE_PLACE_S = 100.0  # of what is left of a calibration, which is another error in another part of the view
ONE_FRAME_S = 1e-3  # of what is independent in every frame
MIN_DEPTH_M = 1e-3  # what is nearer to the camera, or behind it, has no image
AHEAD_M = np.array([0.0, 0.0, 1.0])  # in place of a point that cannot be seen, so that it has a projection


@dataclass(frozen=True, slots=True)
class BiasTerm:
    """A bias' Jacobian of a residual, (..., m, k); measurements share the bias, or calibration parameter, of a name."""

    name: str
    jacobian: Array
    correlation_time_s: float = FOR_EVER_S


@dataclass(frozen=True)
class Deviations:
    """The profile's standard deviations of the calibration parameters; fractions are of the parameter itself."""

    camera: CameraError
    shaft_radius_fraction: float = 0.0
    marker_radius_fraction: float = 0.0
    tag_size_fraction: float = 0.0
    tag_position_m: float = 0.0
    tag_rotation_rad: float = 0.0

    @classmethod
    def of(cls, profile: Profile) -> Deviations:
        """The profile's."""
        radii, of_tag = (0.0, 0.0), (0.0, 0.0, 0.0)
        if (instrument := profile.instrument) is not None:
            radii = instrument.shaft_radius_std_fraction, instrument.knuckle_radius_std_fraction
        if (tag := profile.fiducial) is not None:
            of_tag = tag.size_std_fraction, tag.position_std_m, tag.rotation_std_rad
        return cls(profile.camera_error, *radii, *of_tag)

    def of_pixels(self, pixel: Array, camera: Camera) -> tuple[BiasTerm, ...]:
        """Of a projected point, shape (2,): focal length and principal point."""
        focal = self.camera.focal_std_fraction * (pixel - camera.K[:2, 2])
        centre = self.camera.centre_std_px * np.eye(2)
        return BiasTerm(FOCAL_LENGTH, focal[:, None]), BiasTerm(PRINCIPAL_POINT, centre)

    def of_disparity(
        self, p_left_m: Array, right: Camera, disparity_px: Array, T_right_left: Array
    ) -> tuple[BiasTerm, ...]:
        """Of the disparities, shape (...), of points in the left camera, (..., 3), as the right camera sees them.

        They are x in the left view less x in the right one, both from the principal point, which is off with focal
        length and the right camera's pose.
        """
        p_right_m = (T_right_left[:3, :3] @ p_left_m[..., None])[..., 0] + T_right_left[:3, 3]
        p_right_m = np.where(p_right_m[..., 2:] >= MIN_DEPTH_M, p_right_m, AHEAD_M)
        slope = right.project_with_derivative(p_right_m)[1][..., :1, :]
        focal = self.camera.focal_std_fraction * disparity_px[..., None, None]
        by_baseline = -(slope * T_right_left[:3, 3]).sum(-1) * self.camera.baseline_std_fraction
        by_turn = slope @ skew(p_right_m) * self.camera.right_rotation_std_rad
        turned = BiasTerm(RIGHT_ROTATION, by_turn, ONE_PLACE_S)
        return BiasTerm(FOCAL_LENGTH, focal), BiasTerm(BASELINE, by_baseline[..., None]), turned

    def of_tag(self, T_camera_tag: Array, focal_px: Array) -> tuple[BiasTerm, ...]:
        """Of a tag's pose, shape (4, 4): focal length, principal point, the tag's size, and how it is mounted."""
        p_m, R = T_camera_tag[:3, 3], T_camera_tag[:3, :3]
        focal, centre, size, mounting = (np.zeros((6, count)) for count in (1, 2, 1, 6))
        focal[2, 0] = -self.camera.focal_std_fraction * p_m[2]
        centre[:3] = self.camera.centre_std_px * p_m[2] * (np.eye(3)[:, :2] / focal_px)
        centre[3, 1], centre[4, 0] = self.camera.centre_std_px * np.array([-1.0, 1.0]) / focal_px[::-1]
        size[:3, 0] = -self.tag_size_fraction * p_m
        mounting[:3, :3], mounting[3:, 3:] = self.tag_position_m * R, self.tag_rotation_rad * R
        names = FOCAL_LENGTH, PRINCIPAL_POINT, TAG_SIZE, "tag mounting"
        return tuple(map(BiasTerm, names, (focal, centre, size, mounting)))


EXACT = Deviations(
    CameraError(focal_std_fraction=0.0, centre_std_px=0.0, baseline_std_fraction=0.0, right_rotation_std_rad=0.0)
)
"""Calibration parameters without errors."""


@dataclass(frozen=True, slots=True)
class Linearised:
    """A measurement about a state: measured minus predicted, the residual, = H δ + Σ B ξ + noise."""

    residual: Array  # (..., m); as H not finite where the link cannot be seen
    H: Array  # (..., m, n), by δ, the error state, or (δp, δθ) of a link in the camera frame
    biases: tuple[BiasTerm, ...]  # the measurement's own, and calibration parameters
    noise: Array

    @property
    def is_finite(self) -> bool:
        """Whether the link could be seen."""
        return bool(np.isfinite(self.residual).all() and np.isfinite(self.H).all())


@dataclass(frozen=True, kw_only=True)
class LinkMeasurement(ABC):
    """A measurement of the frame of the DH row `link`, or of the tool where that is None; `name` is human-readable.

    What stays alike from frame to frame, the bias, is a vector of numbers of variance one. Where all measurements that
    it `rests_on`, by their names, are outliers, it is one: the end of what is no shaft is no shaft's end.
    """

    name: str
    covariance: Array  # of the noise, which changes from frame to frame, shape (m, m)
    link: str | None = None
    source: str = ""  # the detection that it is made of
    correlation_time_s: float  # with which the bias fades
    deviations: Deviations = EXACT
    T_view_left: Array | None = None  # for a right view: maps the left camera's coordinates to the right one's
    delay_s: float = 0.0  # of what the image shows, after the frame's stamp
    rests_on: tuple[str, ...] = ()

    @abstractmethod
    def in_view(self, T_view_link: Array, /) -> Linearised:
        """All that it says about a pose of the link, shape (4, 4), in the frame of the camera that sees it."""

    def about(self, residual: Array, H: Array, own: Array, shared: Iterable[BiasTerm], name: str = "") -> Linearised:
        """It about a pose, by its derivatives (m, 6), and by its own bias, (m, k), or one of that name, and others."""
        bias = BiasTerm(name or self.name, own, self.correlation_time_s)
        return Linearised(residual, H, (bias, *shared), self.covariance)

    def unseen(self) -> Linearised:
        """What has no image: behind the camera, or around it."""
        size = len(self.covariance)
        return Linearised(np.full(size, np.inf), np.full((size, 6), np.nan), (), self.covariance)

    def linearise(self, T_camera_link: Array) -> Linearised:
        """All that it says about a pose of the link, shape (4, 4), in the left camera's frame."""
        if self.T_view_left is None:
            return self.in_view(T_camera_link)
        T, camera = self.T_view_left @ T_camera_link, self.deviations.camera
        found = self.in_view(T)
        by_place, by_turn = found.H[:, :3], found.H[:, 3:]
        # The right camera is off by its place along the baseline, and turned about its own centre.
        baseline = camera.baseline_std_fraction * by_place @ self.T_view_left[:3, 3, None]
        turned = (by_turn - by_place @ skew(T[:3, 3])) * camera.right_rotation_std_rad
        biases = *found.biases, BiasTerm(BASELINE, baseline), BiasTerm(RIGHT_ROTATION, turned, ONE_PLACE_S)
        return replace(found, H=found.H @ np.kron(np.eye(2), self.T_view_left[:3, :3]), biases=biases)

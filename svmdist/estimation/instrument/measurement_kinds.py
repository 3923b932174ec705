"""The kinds of measurements: points, a sphere's size, disparity, sides and end of the shaft's outline, and a pose.

Each is the residual of one link's pose, with what lasts of its error and what errors of constants do to it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.instrument.measurement import (
    EXACT,
    MIN_DEPTH_M,
    Deviations,
    LinkMeasurement,
    PoseResidual,
    SharedBias,
    edge_by_radius,
)
from svmdist.profile.hand_eye import BASELINE
from svmdist.profile.settings import FilterSettings
from svmdist.transforms import Array, inverse_right_jacobian, rotation_vector, skew
from svmdist.vision.lines import apparent_radius_px, tangent_normal

MARKER = "distal marker"
END_BIAS, JAWS = "shaft's end", "jaws"
POINT_CORRELATION_TIME_S = FilterSettings().point_correlation_time_s
EDGE_CORRELATION_TIME_S = FilterSettings().edge_correlation_time_s
POSE_CORRELATION_TIME_S = 0.5
LASTING_OUTLINE = 0.75  # of the variance of what ends an outline in the image: what looks like it stays
ONE_FRAME_S = 1e-3  # of what is drawn anew in every frame


@dataclass(frozen=True, slots=True)
class PointError:
    """What of a point's error on an instrument lasts from frame to frame, under one name for all that show it.

    The point may be off by an offset fixed in the link's frame, of deviation `place_std_m` along each axis, and what is
    visible of it by another one, of `part_std_m`: where a side is hidden, or another part is coloured. Shading may
    draw the pixel outward by `shading_px` (a deviation) times the tilt of its ray. What is found between the shaft's
    end and the tips is off with that end, by `with_end_m` (3,) in the view's frame at the end's deviation, and with the
    jaws' length, by `with_jaws_m` along them.
    """

    name: str = "point"
    place_std_m: float = 0.0
    part_std_m: float = 0.0
    shading_px: float = 0.0
    correlation_time_s: float = POINT_CORRELATION_TIME_S
    with_end_m: Array | None = None
    with_jaws_m: float = 0.0

    def jacobian(self, tilt: Array, T_camera_link: Array, derivative: Array) -> Array:
        """Derivative of a residual (m,) by both offsets and shading, (m, 7), where shading does it by `tilt`, (m,)."""
        # An offset in the link's frame moves the point as the link's own motion would.
        by_offset = -derivative[:, :3] @ T_camera_link[:3, :3]
        return np.column_stack(
            [self.place_std_m * by_offset, self.part_std_m * by_offset, self.shading_px * tilt]
        )


POINT = PointError()


class _OfPoint(LinkMeasurement):
    """A measurement of a point of a link."""

    error: PointError

    @property
    def bias_name(self) -> str:
        """The point's: all that shows it errs with it."""
        return self.error.name

    @property
    def correlation_time_s(self) -> float:  # type: ignore[override]
        """The point's."""
        return self.error.correlation_time_s

    def of_outline(self, T_camera_link: Array) -> tuple[SharedBias, ...]:
        """What the shaft's end and the jaws' length do to what was found between them; nothing to others."""
        if self.error.with_end_m is None:
            return ()
        by_place = -self.linearise(T_camera_link).derivative[:, :3]
        by_length = np.zeros((len(by_place), 7))  # as the offset of the jaws' tip
        by_length[:, 0] = by_place @ T_camera_link[:3, 0] * self.error.with_jaws_m
        by_end, time_s = by_place @ self.error.with_end_m[:, None], POINT_CORRELATION_TIME_S
        return SharedBias(END_BIAS, by_end, time_s), SharedBias(JAWS, by_length, time_s)


@dataclass(frozen=True)
class PointMeasurement(_OfPoint):
    """A point of a link, `p_link_m` (3,), seen at a pixel (2,) with a covariance (2, 2) in px²."""

    source = MARKER

    name: str
    link: str | None
    camera: Camera
    p_link_m: Array
    pixel: Array
    covariance: Array
    error: PointError = POINT
    deviations: Deviations = EXACT

    def linearise(self, T_camera_link: Array) -> PoseResidual:
        """Measured minus projected, shape (2,), about a pose (4, 4)."""
        arm_m = T_camera_link[:3, :3] @ self.p_link_m
        p_camera_m = arm_m + T_camera_link[:3, 3]
        if p_camera_m[2] < MIN_DEPTH_M:
            return PoseResidual.unseen(2)
        pixel, J = self.camera.project_with_derivative(p_camera_m)
        return PoseResidual(self.pixel - pixel, np.concatenate([-J, J @ skew(arm_m)], 1))

    def bias_jacobian(self, T_camera_link: Array, derivative: Array, /) -> Array:
        """Derivative by offset and shading, shape (2, 7), in units of their deviations."""
        K = self.camera.K
        tilt = (self.pixel - K[:2, 2]) / np.diag(K)[:2]
        return self.error.jacobian(tilt, T_camera_link, derivative)

    def shared_biases(self, T_camera_link: Array, /) -> tuple[SharedBias, ...]:
        """Focal length, principal point, the shaft's end and the jaws' length."""
        return *self.deviations.of_pixels(self.pixel, self.camera), *self.of_outline(T_camera_link)


@dataclass(frozen=True)
class DisparityMeasurement(_OfPoint):
    """How far apart, in px along x, the two views of a stereo pair show a point of a link: `p_link_m`, shape (3,).

    `T_right_left` maps the left camera's coordinates to the right one's; the covariance has shape (1, 1) in px².
    Of shading the two rays differ in tilt by the disparity over the focal length.
    """

    source = "disparity"

    name: str
    link: str | None
    left: Camera
    right: Camera
    T_right_left: Array
    disparity_px: float
    covariance: Array
    error: PointError = POINT
    deviations: Deviations = EXACT
    lasting_std_px: float = 0.0
    p_link_m: Array = field(default_factory=lambda: np.zeros(3))

    def linearise(self, T_camera_link: Array) -> PoseResidual:
        """Measured minus predicted, shape (1,), about a pose (4, 4)."""
        R_right_left, t_right_left = self.T_right_left[:3, :3], self.T_right_left[:3, 3]
        arm_m = T_camera_link[:3, :3] @ self.p_link_m
        p_left_m = arm_m + T_camera_link[:3, 3]
        p_right_m = R_right_left @ p_left_m + t_right_left
        if min(p_left_m[2], p_right_m[2]) < MIN_DEPTH_M:
            return PoseResidual.unseen(1)
        left_px, J_left = self.left.project_with_derivative(p_left_m)
        right_px, J_right = self.right.project_with_derivative(p_right_m)
        by_place = (J_right[:1] @ R_right_left) - J_left[:1]
        residual = np.array([self.disparity_px - float(left_px[0] - right_px[0])])
        return PoseResidual(residual, np.concatenate([by_place, -by_place @ skew(arm_m)], 1))

    def bias_jacobian(self, T_camera_link: Array, derivative: Array, /) -> Array:
        """Derivative by offset and shading, shape (1, 7), in units of their deviations."""
        tilt = np.array([self.disparity_px / self.left.K[0, 0]])
        return self.error.jacobian(tilt, T_camera_link, derivative)

    def shared_biases(self, T_camera_link: Array, /) -> tuple[SharedBias, ...]:
        """Focal length, baseline, the right camera's rotation, the shaft's end, jaws, and what lasts of disparity."""
        p_left_m = T_camera_link[:3, :3] @ self.p_link_m + T_camera_link[:3, 3]
        disparity_px = np.asarray(self.disparity_px, np.float64)
        biases = self.deviations.of_disparity_at(p_left_m, self.right, disparity_px, self.T_right_left)
        lasting = np.array([[self.lasting_std_px]])
        return (
            *biases,
            *self.of_outline(T_camera_link),
            SharedBias("disparity of the marker", lasting, self.correlation_time_s),
        )


@dataclass(frozen=True)
class SizeMeasurement(LinkMeasurement):
    """The radius in px of the disc that a sphere about a link's origin shows; `bias_std_px` lasts."""

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
        """Measured minus predicted, shape (1,), about a pose (4, 4)."""
        p_m = T_camera_link[:3, 3]
        if p_m[2] < MIN_DEPTH_M:
            return PoseResidual.unseen(1)
        predicted_px = float(apparent_radius_px(p_m, self.radius_m, self.camera))
        # Of f r |p|^½ z^(-3/2), by its logarithm.
        slope = 0.5 * p_m / float(p_m @ p_m)
        slope[2] -= 1.5 / p_m[2]
        derivative = np.concatenate([-predicted_px * slope, np.zeros(3)])[None]
        return PoseResidual(np.array([self.radius_px - predicted_px]), derivative)

    def bias_jacobian(self, _T_camera_link: Array, _derivative: Array, /) -> Array:
        """Derivative by the bias, shape (1, 1)."""
        return np.array([[self.bias_std_px]])

    def shared_biases(self, _T_camera_link: Array, /) -> tuple[SharedBias, ...]:
        """Focal length and the sphere's radius."""
        return self.deviations.of_radius(np.asarray(self.radius_px, np.float64))


def _root(covariance: Array) -> Array:
    """A root of a bias' covariance, shape (m, m), as its derivative; zero where nothing of an error lasts."""
    return np.asarray(np.linalg.cholesky(covariance) if covariance.any() else np.zeros_like(covariance))


@dataclass(frozen=True)
class ContourMeasurement(LinkMeasurement):
    """One edge of the shaft's silhouette: the plane through the camera's centre and the edge touches the shaft.

    `normal`, shape (3,), is that plane's unit normal in the camera frame, turned to the shaft's side; `across`, shape
    (2, 3), holds two unit vectors square to it, along which it errs by the covariance, shape (2, 2) in rad². The
    shaft is a cylinder of `radius_m` about an axis of the link: `p_axis_m` and `axis`, shape (3,), in the link's
    frame, towards the tip. `side` tells the edges apart: +1 for the one to the right of the axis as it runs through
    the image, y being down, -1 for the left. `bias_covariance`, shape (2, 2) in rad², is that of the bias: shading
    stays as long as the light falls on the edge so.
    """

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

    def _axis(self, T_camera_link: Array) -> tuple[Array, Array]:
        """Direction (3,) of the axis in the camera frame, and from the link's origin to a point on it (3,)."""
        R = T_camera_link[:3, :3]
        return R @ self.axis, R @ self.p_axis_m

    def linearise(self, T_camera_link: Array) -> PoseResidual:
        """By what the normal is off the predicted one, shape (2,) in rad, about a pose (4, 4)."""
        d, arm_m = self._axis(T_camera_link)
        normal, by_point, by_direction = tangent_normal(
            T_camera_link[:3, 3] + arm_m, d, self.radius_m, self.side
        )
        if not np.isfinite(normal).all():  # the camera is inside the shaft
            return PoseResidual.unseen(2)
        by_turn = -by_point @ skew(arm_m) - by_direction @ skew(d)
        by_pose = np.concatenate([by_point, by_turn], 1)
        return PoseResidual(self.across @ (self.normal - normal), -(self.across @ by_pose))

    @cached_property
    def _lasting(self) -> Array:
        return _root(self.bias_covariance)

    def bias_jacobian(self, _T_camera_link: Array, _derivative: Array, /) -> Array:
        """Derivative by the bias, shape (2, 2)."""
        return self._lasting

    def shared_biases(self, T_camera_link: Array, /) -> tuple[SharedBias, ...]:
        """Focal length, principal point, and the shaft's radius."""
        d, arm_m = self._axis(T_camera_link)
        radius_m, focal_px = np.asarray(self.radius_m, np.float64), np.array(self.focal_px)
        by_radius = edge_by_radius(T_camera_link[:3, 3] + arm_m, d, radius_m, np.asarray(self.side))
        return self.deviations.of_edge(self.normal, self.across, by_radius, radius_m, focal_px)


@dataclass(frozen=True)
class EndMeasurement(LinkMeasurement):
    """Where the shaft's end is along its middle line: `pixel` (2,) along `towards_tip` (2,), with a variance (1, 1).

    The end is `ahead_m` before the hinge `p_hinge_m` (3,) on the axis (3,) of the link; of the dark part it is the end
    of the generatrix that faces the camera, `radius_m` off the axis. `model_std_m` is how wrong `ahead_m` may be, and
    `lasting_std_px` what lasts of the error in the image: a band or a plate that is taken for the end stays one.
    """

    source = "shaft"

    name: str
    link: str | None
    camera: Camera
    pixel: Array
    towards_tip: Array
    covariance: Array
    p_hinge_m: Array
    axis: Array
    ahead_m: float
    radius_m: float
    model_std_m: float
    lasting_std_px: float = 0.0
    bias_name: str = END_BIAS
    correlation_time_s: float = POINT_CORRELATION_TIME_S
    deviations: Deviations = EXACT

    def linearise(self, T_camera_link: Array) -> PoseResidual:
        """Measured minus predicted in px, shape (1,), about a pose (4, 4)."""
        d, arm_m = T_camera_link[:3, :3] @ self.axis, T_camera_link[:3, :3] @ self.p_hinge_m
        hinge_m = T_camera_link[:3, 3] + arm_m
        along_m = float(d @ hinge_m)
        foot_m = hinge_m - along_m * d
        distance_m = float(np.linalg.norm(foot_m))
        facing = foot_m / max(distance_m, MIN_DEPTH_M)
        point_m = hinge_m + self.ahead_m * d - self.radius_m * facing
        if point_m[2] < MIN_DEPTH_M or distance_m < MIN_DEPTH_M:
            return PoseResidual.unseen(1)
        pixel, J = self.camera.project_with_derivative(point_m)
        across = self.radius_m / distance_m * (np.eye(3) - np.outer(facing, facing))
        by_hinge = np.eye(3) - across @ (np.eye(3) - np.outer(d, d))
        by_axis = self.ahead_m * np.eye(3) + across @ (along_m * np.eye(3) + np.outer(d, hinge_m))
        by_pose = np.concatenate([by_hinge, -by_hinge @ skew(arm_m) - by_axis @ skew(d)], 1)
        residual = np.array([(self.pixel - pixel) @ self.towards_tip])
        return PoseResidual(residual, -(self.towards_tip @ J @ by_pose)[None])

    def bias_jacobian(self, T_camera_link: Array, derivative: Array, /) -> Array:
        """By where the end is along the shaft, in units of its deviation, shape (1, 1)."""
        by_place = -derivative[:, :3] @ T_camera_link[:3, :3] @ self.axis[:, None]
        return np.copysign(np.hypot(self.model_std_m * by_place, self.lasting_std_px), by_place)

    def shared_biases(self, _T_camera_link: Array, /) -> tuple[SharedBias, ...]:
        """Focal length and principal point, along the middle line."""
        biases = self.deviations.of_pixels(self.pixel, self.camera)
        return tuple(SharedBias(bias.name, (self.towards_tip @ bias.jacobian)[None]) for bias in biases)


@dataclass(frozen=True)
class PoseMeasurement(LinkMeasurement):
    """A pose measured as a whole: `T_camera_frame` of a frame fixed on a link by `T_link_frame`, (4, 4)."""

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
        """(δp, δθ) from predicted to measured, shape (6,) in m and rad, about a pose (4, 4)."""
        predicted = T_camera_link @ self.T_link_frame
        turn = rotation_vector(self.T_camera_frame[:3, :3] @ predicted[:3, :3].T)
        residual = np.concatenate([self.T_camera_frame[:3, 3] - predicted[:3, 3], turn])
        derivative = np.zeros((6, 6))
        derivative[:3, :3] = -np.eye(3)
        derivative[:3, 3:] = skew(predicted[:3, 3] - T_camera_link[:3, 3])
        # exp([φ]) exp([-δθ]) = exp([φ - J⁻¹ δθ]), J the right Jacobian (Solà 2018, "A micro Lie theory", sec. 4.3).
        derivative[3:, 3:] = -inverse_right_jacobian(turn)
        return PoseResidual(residual, derivative)

    @cached_property
    def _lasting(self) -> Array:
        return _root(self.bias_covariance)

    def bias_jacobian(self, _T_camera_link: Array, _derivative: Array, /) -> Array:
        """Derivative by the bias, shape (6, 6)."""
        return self._lasting

    def shared_biases(self, _T_camera_link: Array, /) -> tuple[SharedBias, ...]:
        """Focal length, principal point, the tag's size and mounting."""
        return self.deviations.of_tag(self.T_camera_frame, np.array(self.focal_px))


@dataclass(frozen=True)
class InRightView(LinkMeasurement):
    """A measurement by the right camera, as one of the link's pose in the left camera's frame.

    What is fixed on the instrument errs alike in both views; what an edge gets wrong is each view's own. The tool may
    have moved by `motion_std_m` along each axis between the views' stamps.
    """

    inner: LinkMeasurement
    T_right_left: Array
    deviations: Deviations
    motion_std_m: float = 0.0

    def __getattr__(self, name: str) -> object:
        """Link, covariance and correlation time are the inner measurement's."""
        if name in ("link", "covariance", "correlation_time_s", "source"):
            return getattr(self.inner, name)
        raise AttributeError(name)

    @property
    def name(self) -> str:  # type: ignore[override]
        """The measurement's, of the right view."""
        return f"right {self.inner.name}"

    @property
    def bias_name(self) -> str:
        """The inner measurement's where the bias is of something on the instrument."""
        return self.name if self.inner.bias_name == self.inner.name else self.inner.bias_name

    def linearise(self, T_camera_link: Array) -> PoseResidual:
        """The inner residual, its derivative by the pose in the left camera's frame."""
        found, R = self.inner.linearise(self.T_right_left @ T_camera_link), self.T_right_left[:3, :3]
        return PoseResidual(found.residual, found.derivative @ np.kron(np.eye(2), R))

    def bias_jacobian(self, T_camera_link: Array, derivative: Array, /) -> Array:
        """The inner measurement's."""
        R = self.T_right_left[:3, :3]
        return self.inner.bias_jacobian(
            self.T_right_left @ T_camera_link, derivative @ np.kron(np.eye(2), R.T)
        )

    def shared_biases(self, T_camera_link: Array, /) -> tuple[SharedBias, ...]:
        """Those of the inner measurement, baseline, the right camera's rotation, and motion between the views."""
        T, camera = self.T_right_left @ T_camera_link, self.deviations.camera
        by_pose = -self.inner.linearise(T).derivative
        by_place = by_pose[:, :3]
        # The right camera is off by its place along the baseline, and turned about its own centre.
        baseline = camera.baseline_std_fraction * by_place @ self.T_right_left[:3, 3][:, None]
        turned = camera.right_rotation_std_rad * (by_pose[:, 3:] - by_place @ skew(T[:3, 3]))
        moved = self.motion_std_m * by_place @ self.T_right_left[:3, :3]
        return (
            *self.inner.shared_biases(T),
            SharedBias(BASELINE, baseline),
            SharedBias("right camera's rotation", turned),
            SharedBias("motion between the views", moved, ONE_FRAME_S),
        )

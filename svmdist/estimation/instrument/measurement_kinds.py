"""The kinds of measurements: points, a sphere's size, disparity, sides and end of the shaft's outline, and a pose."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.instrument.measurement import MIN_DEPTH_M, BiasTerm, Linearised, LinkMeasurement
from svmdist.profile.hand_eye import FOCAL_LENGTH, PRINCIPAL_POINT, SHAFT_RADIUS
from svmdist.transforms import Array, inverse_right_jacobian, rotation_vector, skew
from svmdist.vision.lines import apparent_radius_px, tangent_normal

MARKER, SHAFT = "distal marker", "shaft"
END_BIAS, JAWS = "shaft's end", "jaws"
CORRELATED_OUTLINE = 0.75  # of the variance of what ends an outline in the image: the cause stays
NEAR_M = 1e-3  # A camera is no nearer to an edge than this: it bounds a derivative


@dataclass(frozen=True, slots=True)
class PointError:
    """The bias of a point on an instrument, under one name for all measurements that share it, as deviations.

    What is found between the shaft's end and the tips is off with both, as lastingly as by its own bias.
    """

    name: str = "point"
    place_std_m: float = 0.0  # of an offset that is fixed in the link's frame, along each axis
    part_std_m: float = 0.0  # of another one of what is visible: a side is hidden, or another part is coloured
    shading_px: float = 0.0  # by which shading draws the pixel outward, over the tilt of its ray
    with_end_m: Array | None = None  # at the deviation of the shaft's end, (3,) in the view's frame
    with_jaws_m: float = 0.0  # at that of the jaws' length, along them


@dataclass(frozen=True, kw_only=True)
class _OfPoint(LinkMeasurement):
    """A measurement of a point of a link, `p_link_m` (3,), whose error all share that shows it."""

    source: str = MARKER
    p_link_m: Array = field(default_factory=lambda: np.zeros(3))
    error: PointError = PointError()

    def about_point(
        self, residual: Array, H: Array, R: Array, tilt: Array, shared: Iterable[BiasTerm], *more: BiasTerm
    ) -> Linearised:
        """It about a pose of rotation `R`, where shading moves it by `tilt`, (m,)."""
        error, by_place = self.error, H[:, :3]
        # An offset in the link's frame moves the point as the link's own motion would.
        by_offset = by_place @ R
        # Both offsets and shading, in units of their deviations.
        bias = np.column_stack([error.place_std_m * by_offset, error.part_std_m * by_offset, error.shading_px * tilt])
        if error.with_end_m is not None:
            by_length = np.zeros((len(H), 7))  # as the offset of the jaws' tip
            by_length[:, 0] = by_place @ R[:, 0] * error.with_jaws_m
            by_end = BiasTerm(END_BIAS, by_place @ error.with_end_m[:, None], self.correlation_time_s)
            shared = *shared, by_end, BiasTerm(JAWS, by_length, self.correlation_time_s)
        return self.about(residual, H, bias, (*shared, *more), error.name)


@dataclass(frozen=True, kw_only=True)
class PointMeasurement(_OfPoint):
    """A point of a link, seen at a pixel (2,) with a covariance (2, 2) in px²."""

    camera: Camera
    pixel: Array

    def in_view(self, T_view_link: Array, /) -> Linearised:
        """Measured minus projected, shape (2,)."""
        K, R = self.camera.K, T_view_link[:3, :3]
        arm_m = R @ self.p_link_m
        p_camera_m = arm_m + T_view_link[:3, 3]
        if p_camera_m[2] < MIN_DEPTH_M:
            return self.unseen()
        pixel, J = self.camera.project_with_derivative(p_camera_m)
        H = np.concatenate([J, -J @ skew(arm_m)], 1)
        tilt = (self.pixel - K[:2, 2]) / np.diag(K)[:2]
        return self.about_point(self.pixel - pixel, H, R, tilt, self.deviations.of_pixels(self.pixel, self.camera))


@dataclass(frozen=True, kw_only=True)
class DisparityMeasurement(_OfPoint):
    """How far apart, in px along x, the two views of a stereo pair show a point of a link; covariance (1, 1) in px²."""

    source: str = "disparity"
    left: Camera
    right: Camera
    T_right_left: Array  # maps the left camera's coordinates to the right one's
    disparity_px: float
    bias_std_px: float = 0.0

    def in_view(self, T_view_link: Array, /) -> Linearised:
        """Measured minus predicted, shape (1,)."""
        R, R_right_left = T_view_link[:3, :3], self.T_right_left[:3, :3]
        arm_m = R @ self.p_link_m
        p_left_m = arm_m + T_view_link[:3, 3]
        p_right_m = R_right_left @ p_left_m + self.T_right_left[:3, 3]
        if min(p_left_m[2], p_right_m[2]) < MIN_DEPTH_M:
            return self.unseen()
        left_px, J_left = self.left.project_with_derivative(p_left_m)
        right_px, J_right = self.right.project_with_derivative(p_right_m)
        by_place = J_left[:1] - J_right[:1] @ R_right_left
        H = np.concatenate([by_place, -by_place @ skew(arm_m)], 1)
        residual = np.array([self.disparity_px - float(left_px[0] - right_px[0])])
        # Principal points that stand apart are part of a disparity, and not of what a focal length does to it, nor of
        # what both rays differ in tilt by, as shading has it: the disparity over the focal length.
        by_depth_px = np.array(self.disparity_px - (self.left.K[0, 2] - self.right.K[0, 2]))
        shared = self.deviations.of_disparity(p_left_m, self.right, by_depth_px, self.T_right_left)
        of_image = BiasTerm("disparity of the marker", np.array([[self.bias_std_px]]), self.correlation_time_s)
        return self.about_point(residual, H, R, by_depth_px[None] / self.left.K[0, 0], shared, of_image)


@dataclass(frozen=True, kw_only=True)
class SizeMeasurement(LinkMeasurement):
    """The radius in px of the disc that a sphere about a link's origin shows, with its bias."""

    source: str = MARKER
    camera: Camera
    radius_m: float
    radius_px: float
    bias_std_px: float
    hidden_std_px: float = 0.0  # as long as something hides a part of it

    def in_view(self, T_view_link: Array, /) -> Linearised:
        """Measured minus predicted, shape (1,)."""
        p_m = T_view_link[:3, 3]
        if p_m[2] < MIN_DEPTH_M:
            return self.unseen()
        predicted_px = float(apparent_radius_px(p_m, self.radius_m, self.camera))
        # Of f r |p|^½ z^(-3/2), by its logarithm.
        slope = 0.5 * p_m / float(p_m @ p_m)
        slope[2] -= 1.5 / p_m[2]
        H = np.concatenate([predicted_px * slope, np.zeros(3)])[None]
        fractions = self.deviations.camera.focal_std_fraction, self.deviations.marker_radius_fraction
        focal, radius = (np.array([[fraction * self.radius_px]]) for fraction in fractions)
        shared: tuple[BiasTerm, ...] = BiasTerm(FOCAL_LENGTH, focal), BiasTerm("marker radius", radius)
        if self.hidden_std_px:
            hidden = np.array([[self.hidden_std_px]])
            shared = *shared, BiasTerm("hidden marker", hidden, self.correlation_time_s)
        residual, bias = np.array([self.radius_px - predicted_px]), np.array([[self.bias_std_px]])
        return self.about(residual, H, bias, shared)


def bias_jacobian(covariance: Array) -> Array:
    """A derivative by a bias of that covariance, (m, m), which may be zero: a root of it."""
    return np.asarray(np.linalg.cholesky(covariance) if covariance.any() else np.zeros_like(covariance))


@dataclass(frozen=True, kw_only=True)
class ContourMeasurement(LinkMeasurement):
    """One edge of the shaft's silhouette: the plane through the camera's centre and the edge touches the shaft."""

    source: str = SHAFT
    normal: Array  # unit normal of that plane in the camera frame, turned to the shaft's side, (3,)
    across: Array  # two unit vectors square to it, along which it errs, (2, 3)
    by_bias: Array  # by that of shading, which stays as long as the light falls on the edge so, (2, 2) in rad
    p_axis_m: Array  # of the shaft's axis, in the link's frame, (3,)
    axis: Array  # its direction to the tip, (3,)
    radius_m: float
    side: int  # +1 for the edge to the right of the axis as it runs through the image, y being down, -1 for the left
    focal_px: Array = field(default_factory=lambda: np.ones(2))

    @cached_property
    def of_camera(self) -> tuple[BiasTerm, ...]:
        """What focal length and principal point do to it, whatever the pose."""
        error, flat = self.deviations.camera, self.normal * np.array([1.0, 1.0, 0.0])
        focal = -error.focal_std_fraction * (self.across @ flat[:, None])
        centre = -error.centre_std_px * self.across[:, 2:] * (self.normal[:2] / self.focal_px)
        return BiasTerm(FOCAL_LENGTH, focal), BiasTerm(PRINCIPAL_POINT, centre)

    def in_view(self, T_view_link: Array, /) -> Linearised:
        """By what the normal is off the predicted one, shape (2,) in rad."""
        d, arm_m = T_view_link[:3, :3] @ self.axis, T_view_link[:3, :3] @ self.p_axis_m
        point_m = T_view_link[:3, 3] + arm_m
        normal, by_point, by_direction = tangent_normal(point_m, d, self.radius_m, self.side)
        if not np.isfinite(normal).all():  # the camera is inside the shaft
            return self.unseen()
        H = self.across @ np.concatenate([by_point, -by_point @ skew(arm_m) - by_direction @ skew(d)], 1)
        foot_m = point_m - (d * point_m).sum() * d
        square_m2 = (foot_m * foot_m).sum()
        beside_m = self.side * np.sqrt(max(square_m2 - self.radius_m**2, NEAR_M**2))
        by_radius = (beside_m * foot_m - self.radius_m * (skew(d) @ foot_m)) / (square_m2 * beside_m)
        radius = self.across @ (by_radius * self.radius_m)[:, None] * self.deviations.shaft_radius_fraction
        shared = *self.of_camera, BiasTerm(SHAFT_RADIUS, radius)
        return self.about(self.across @ (self.normal - normal), H, self.by_bias, shared)


@dataclass(frozen=True, kw_only=True)
class EndMeasurement(LinkMeasurement):
    """Where the shaft's end is along its middle line: `pixel` (2,) along `towards_tip` (2,), with a variance (1, 1).

    The end is on the axis (3,) of the link; that of the dark part ends the generatrix that faces the camera.
    """

    source: str = SHAFT
    camera: Camera
    pixel: Array
    towards_tip: Array
    p_hinge_m: Array  # (3,) in the link's frame
    axis: Array
    ahead_m: float  # of the end before the hinge
    radius_m: float  # of the generatrix off the axis; 0 for the outline's end
    model_std_m: float  # how wrong `ahead_m` may be
    bias_std_px: float = 0.0  # a band or a plate that is taken for the end stays one

    @cached_property
    def of_camera(self) -> tuple[BiasTerm, ...]:
        """What focal length and principal point do to it, whatever the pose."""
        each = self.deviations.of_pixels(self.pixel, self.camera)
        return tuple(BiasTerm(one.name, (self.towards_tip @ one.jacobian)[None]) for one in each)

    def in_view(self, T_view_link: Array, /) -> Linearised:
        """Measured minus predicted in px, shape (1,); the bias is along the shaft in units of its deviation."""
        d, arm_m = T_view_link[:3, :3] @ self.axis, T_view_link[:3, :3] @ self.p_hinge_m
        hinge_m = T_view_link[:3, 3] + arm_m
        along_m = float(d @ hinge_m)
        foot_m = hinge_m - along_m * d
        distance_m = float(np.linalg.norm(foot_m))
        facing = foot_m / max(distance_m, MIN_DEPTH_M)
        point_m = hinge_m + self.ahead_m * d - self.radius_m * facing
        if point_m[2] < MIN_DEPTH_M or distance_m < MIN_DEPTH_M:
            return self.unseen()
        pixel, J = self.camera.project_with_derivative(point_m)
        across = self.radius_m / distance_m * (np.eye(3) - np.outer(facing, facing))
        by_hinge = np.eye(3) - across @ (np.eye(3) - np.outer(d, d))
        by_axis = self.ahead_m * np.eye(3) + across @ (along_m * np.eye(3) + np.outer(d, hinge_m))
        by_pose = np.concatenate([by_hinge, -by_hinge @ skew(arm_m) - by_axis @ skew(d)], 1)
        H = (self.towards_tip @ J @ by_pose)[None]
        by_place = H[:, :3] @ T_view_link[:3, :3] @ self.axis[:, None]
        bias = np.copysign(np.hypot(self.model_std_m * by_place, self.bias_std_px), by_place)
        residual = np.array([(self.pixel - pixel) @ self.towards_tip])
        return self.about(residual, H, bias, self.of_camera, END_BIAS)  # whichever view shows it


@dataclass(frozen=True, kw_only=True)
class PoseMeasurement(LinkMeasurement):
    """A pose measured as a whole: `T_camera_frame` of a frame fixed on a link by `T_link_frame`, (4, 4)."""

    source: str = "tag"
    T_link_frame: Array
    T_camera_frame: Array
    by_bias: Array  # derivative by the bias, (6, 6)
    focal_px: Array = field(default_factory=lambda: np.ones(2))
    correlation_time_s: float = 0.5

    def in_view(self, T_view_link: Array, /) -> Linearised:
        """(δp, δθ) from predicted to measured, shape (6,) in m and rad."""
        predicted = T_view_link @ self.T_link_frame
        turn = rotation_vector(self.T_camera_frame[:3, :3] @ predicted[:3, :3].T)
        residual = np.concatenate([self.T_camera_frame[:3, 3] - predicted[:3, 3], turn])
        H = np.zeros((6, 6))
        H[:3, :3] = np.eye(3)
        H[:3, 3:] = -skew(predicted[:3, 3] - T_view_link[:3, 3])
        # exp([φ]) exp([-δθ]) = exp([φ - J⁻¹ δθ]), J the right Jacobian (Solà 2018, "A micro Lie theory", sec. 4.3).
        H[3:, 3:] = inverse_right_jacobian(turn)
        shared = self.deviations.of_tag(self.T_camera_frame, self.focal_px)
        return self.about(residual, H, self.by_bias, shared)

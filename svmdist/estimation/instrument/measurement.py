"""A measurement of a link, linearised: residual, derivative, noise, bias, and calibration parameters that all share.

Its kinds are functions, each of what it compares: a point, a disparity, a sphere's size, an edge and the end of the
shaft's outline, a pose.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from svmdist.camera import Camera
from svmdist.kinematics import ShaftAxis
from svmdist.profile.hand_eye import BASELINE, FOCAL_LENGTH, PRINCIPAL_POINT, SHAFT_RADIUS, TAG_SIZE
from svmdist.profile.robot import CameraError, Fiducial
from svmdist.transforms import Array, inverse_right_jacobian, rotation_vector, skew
from svmdist.vision.lines import TangentPlane, apparent_radius_px, tangent_normal
from svmdist.vision.silhouette import Rim

MARKER, END_BIAS, JAWS = "distal marker", "shaft's end", "jaws"
RIGHT_ROTATION = "right camera's rotation"
FOR_EVER_S = np.inf
ONE_PLACE_S = 100.0  # of what is left of a calibration, which is another error in another part of the view
ONE_FRAME_S = 1e-3  # of what is independent in every frame
MIN_DEPTH_M = 1e-3  # what is nearer to the camera, or behind it, has no image; it bounds a derivative, too
AHEAD_M = np.array([0.0, 0.0, 1.0])  # in place of a point that cannot be seen, so that it has a projection


@dataclass(frozen=True, slots=True)
class BiasTerm:
    """A bias' Jacobian of a residual, (..., m, k); measurements share the bias, or calibration parameter, of a name."""

    name: str
    jacobian: Array
    correlation_time_s: float = FOR_EVER_S


def pixel_biases(pixel: Array, camera: Camera, error: CameraError) -> tuple[BiasTerm, ...]:
    """What cameras' errors do to a projected point, shape (2,): focal length and principal point."""
    focal = error.focal_std_fraction * (pixel - camera.K[:2, 2])
    centre = error.centre_std_px * np.eye(2)
    return BiasTerm(FOCAL_LENGTH, focal[:, None]), BiasTerm(PRINCIPAL_POINT, centre)


def disparity_biases(
    p_left_m: Array, right: Camera, disparity_px: Array, T_right_left: Array, error: CameraError
) -> tuple[BiasTerm, ...]:
    """The same of the disparities, shape (...), of points in the left camera, (..., 3), as the right camera sees them.

    They are x in the left view less x in the right one, both from the principal point, which is off with focal
    length and the right camera's pose.
    """
    p_right_m = (T_right_left[:3, :3] @ p_left_m[..., None])[..., 0] + T_right_left[:3, 3]
    p_right_m = np.where(p_right_m[..., 2:] >= MIN_DEPTH_M, p_right_m, AHEAD_M)
    slope = right.project_with_derivative(p_right_m)[1][..., :1, :]
    focal = error.focal_std_fraction * disparity_px[..., None, None]
    by_baseline = -(slope * T_right_left[:3, 3]).sum(-1) * error.baseline_std_fraction
    by_turn = slope @ skew(p_right_m) * error.right_rotation_std_rad
    turned = BiasTerm(RIGHT_ROTATION, by_turn, ONE_PLACE_S)
    return BiasTerm(FOCAL_LENGTH, focal), BiasTerm(BASELINE, by_baseline[..., None]), turned


def tag_biases(T_camera_tag: Array, focal_px: Array, error: CameraError, tag: Fiducial) -> tuple[BiasTerm, ...]:
    """The same of a tag's pose, shape (4, 4): focal length, principal point, the tag's size, and how it is mounted."""
    p_m, R = T_camera_tag[:3, 3], T_camera_tag[:3, :3]
    focal, centre, size, mounting = (np.zeros((6, count)) for count in (1, 2, 1, 6))
    focal[2, 0] = -error.focal_std_fraction * p_m[2]
    centre[:3] = error.centre_std_px * p_m[2] * (np.eye(3)[:, :2] / focal_px)
    centre[3, 1], centre[4, 0] = error.centre_std_px * np.array([-1.0, 1.0]) / focal_px[::-1]
    size[:3, 0] = -tag.size_std_fraction * p_m
    mounting[:3, :3], mounting[3:, 3:] = tag.position_std_m * R, tag.rotation_std_rad * R
    names = FOCAL_LENGTH, PRINCIPAL_POINT, TAG_SIZE, "tag mounting"
    return tuple(map(BiasTerm, names, (focal, centre, size, mounting)))


EXACT = CameraError(focal_std_fraction=0.0, centre_std_px=0.0, baseline_std_fraction=0.0, right_rotation_std_rad=0.0)


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


class Seen(NamedTuple):
    """What a measurement says about a pose of its link in the frame of the camera that sees it."""

    residual: Array  # (m,), measured minus predicted
    H: Array  # (m, 6), by (δp, δθ) of the link
    bias: Array  # (m, k), by its own bias
    shared: Sequence[BiasTerm]  # and by those that it shares with others


@dataclass(frozen=True, kw_only=True)
class LinkMeasurement:
    """A measurement of the frame of the DH row `link`, or of the tool where that is None; `name` is human-readable.

    What stays alike from frame to frame, the bias, is a vector of numbers of variance one. Where all measurements that
    it `rests_on`, by their names, are outliers, it is one: the end of what is no shaft is no shaft's end.
    """

    name: str
    in_view: InView  # about a pose of the link, (4, 4); None: not to be seen
    covariance: Array  # of the noise, which changes from frame to frame, shape (m, m)
    link: str | None = None
    source: str = ""  # the detection that it is made of
    bias: str = ""  # the name of its bias, where others share it
    correlation_time_s: float  # with which the bias fades
    camera_error: CameraError = EXACT
    T_view_left: Array | None = None  # for a right view: maps the left camera's coordinates to the right one's
    delay_s: float = 0.0  # of what the image shows, after the frame's stamp
    rests_on: tuple[str, ...] = ()

    def linearise(self, T_camera_link: Array) -> Linearised:
        """All that it says about a pose of the link, shape (4, 4), in the left camera's frame."""
        T_view_left, error = self.T_view_left, self.camera_error
        T = T_camera_link if T_view_left is None else T_view_left @ T_camera_link
        if (seen := self.in_view(self, T)) is None:  # behind the camera, or around it
            size = len(self.covariance)
            return Linearised(np.full(size, np.inf), np.full((size, 6), np.nan), (), self.covariance)
        H, biases = seen.H, (BiasTerm(self.bias or self.name, seen.bias, self.correlation_time_s), *seen.shared)
        if T_view_left is not None:
            by_place, by_turn = H[:, :3], H[:, 3:]
            # The right camera is off by its place along the baseline, and turned about its own centre.
            baseline = error.baseline_std_fraction * by_place @ T_view_left[:3, 3, None]
            turned = (by_turn - by_place @ skew(T[:3, 3])) * error.right_rotation_std_rad
            biases = *biases, BiasTerm(BASELINE, baseline), BiasTerm(RIGHT_ROTATION, turned, ONE_PLACE_S)
            H = H @ np.kron(np.eye(2), T_view_left[:3, :3])
        return Linearised(seen.residual, H, biases, self.covariance)


InView = Callable[[LinkMeasurement, Array], Seen | None]


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

    def about(
        self, residual: Array, H: Array, R: Array, tilt: Array, shared: Sequence[BiasTerm], time_s: float
    ) -> Seen:
        """A measurement of such a point about a pose of rotation `R`, where shading moves it by `tilt`, (m,)."""
        by_place = H[:, :3]
        # An offset in the link's frame moves the point as the link's own motion would.
        by_offset = by_place @ R
        # Both offsets and shading, in units of their deviations.
        bias = np.column_stack([self.place_std_m * by_offset, self.part_std_m * by_offset, self.shading_px * tilt])
        if self.with_end_m is not None:
            by_length = np.zeros((len(H), 7))  # as the offset of the jaws' tip
            by_length[:, 0] = by_place @ R[:, 0] * self.with_jaws_m
            by_end = BiasTerm(END_BIAS, by_place @ self.with_end_m[:, None], time_s)
            shared = *shared, by_end, BiasTerm(JAWS, by_length, time_s)
        return Seen(residual, H, bias, shared)


def point(camera: Camera, pixel: Array, p_link_m: Array, error: PointError) -> InView:
    """A point of a link, (3,), seen at a pixel (2,): measured minus projected, shape (2,)."""

    def in_view(one: LinkMeasurement, T_view_link: Array) -> Seen | None:
        K, R = camera.K, T_view_link[:3, :3]
        arm_m = R @ p_link_m
        p_camera_m = arm_m + T_view_link[:3, 3]
        if p_camera_m[2] < MIN_DEPTH_M:
            return None
        projected, J = camera.project_with_derivative(p_camera_m)
        H = np.concatenate([J, -J @ skew(arm_m)], 1)
        tilt, shared = (pixel - K[:2, 2]) / np.diag(K)[:2], pixel_biases(pixel, camera, one.camera_error)
        return error.about(pixel - projected, H, R, tilt, shared, one.correlation_time_s)

    return in_view


def disparity(
    cameras: tuple[Camera, Camera],
    T_right_left: Array,
    disparity_px: float,
    p_link_m: Array,
    error: PointError,
    bias_std_px: float = 0.0,
) -> InView:
    """How far apart, in px along x, left and right camera show a point of a link: measured minus predicted, (1,)."""
    left, right = cameras
    # Principal points that stand apart are part of a disparity, and not of what a focal length does to it, nor of what
    # both rays differ in tilt by, as shading has it: the disparity over the focal length.
    by_depth_px = np.array(disparity_px - (left.K[0, 2] - right.K[0, 2]))

    def in_view(one: LinkMeasurement, T_view_link: Array) -> Seen | None:
        R, R_right_left, time_s = T_view_link[:3, :3], T_right_left[:3, :3], one.correlation_time_s
        arm_m = R @ p_link_m
        p_left_m = arm_m + T_view_link[:3, 3]
        p_right_m = R_right_left @ p_left_m + T_right_left[:3, 3]
        if min(p_left_m[2], p_right_m[2]) < MIN_DEPTH_M:
            return None
        left_px, J_left = left.project_with_derivative(p_left_m)
        right_px, J_right = right.project_with_derivative(p_right_m)
        by_place = J_left[:1] - J_right[:1] @ R_right_left
        H = np.concatenate([by_place, -by_place @ skew(arm_m)], 1)
        residual = np.array([disparity_px - float(left_px[0] - right_px[0])])
        shared = disparity_biases(p_left_m, right, by_depth_px, T_right_left, one.camera_error)
        found = error.about(residual, H, R, by_depth_px[None] / left.K[0, 0], shared, time_s)
        of_image = BiasTerm("disparity of the marker", np.array([[bias_std_px]]), time_s)
        return found._replace(shared=(*found.shared, of_image))

    return in_view


def sphere_size(
    camera: Camera,
    radius_m: float,
    radius_std_fraction: float,
    radius_px: float,
    bias_std_px: float,
    hidden_std_px: float = 0.0,
) -> InView:
    """The radius in px of the disc that a sphere about a link's origin shows: measured minus predicted, shape (1,).

    `hidden_std_px` is as long as something hides a part of it.
    """

    def in_view(one: LinkMeasurement, T_view_link: Array) -> Seen | None:
        p_m = T_view_link[:3, 3]
        if p_m[2] < MIN_DEPTH_M:
            return None
        predicted_px = float(apparent_radius_px(p_m, radius_m, camera))
        # Of f r |p|^½ z^(-3/2), by its logarithm.
        slope = 0.5 * p_m / float(p_m @ p_m)
        slope[2] -= 1.5 / p_m[2]
        H = np.concatenate([predicted_px * slope, np.zeros(3)])[None]
        fractions = one.camera_error.focal_std_fraction, radius_std_fraction
        focal, radius = (np.array([[fraction * radius_px]]) for fraction in fractions)
        shared: tuple[BiasTerm, ...] = BiasTerm(FOCAL_LENGTH, focal), BiasTerm("marker radius", radius)
        if hidden_std_px:
            shared = *shared, BiasTerm("hidden marker", np.array([[hidden_std_px]]), one.correlation_time_s)
        return Seen(np.array([radius_px - predicted_px]), H, np.array([[bias_std_px]]), shared)

    return in_view


def bias_jacobian(covariance: Array) -> Array:
    """A derivative by a bias of that covariance, (m, m), which may be zero: a root of it."""
    return np.asarray(np.linalg.cholesky(covariance) if covariance.any() else np.zeros_like(covariance))


def edge(
    contour: TangentPlane,
    across: Array,
    by_bias: Array,
    shaft: ShaftAxis,
    radius_m: float,
    radius_std_fraction: float,
    focal_px: Array,
    error: CameraError,
) -> InView:
    """One edge of the shaft's silhouette: by what its plane's normal is off the predicted one, shape (2,) in rad.

    `across`, (2, 3), are unit vectors square to the normal along which it errs, and `by_bias`, (2, 2) in rad, is by the
    bias of shading, which stays as long as the light falls on the edge so.
    """
    # What focal length and principal point do to it, whatever the pose.
    flat = contour.normal * np.array([1.0, 1.0, 0.0])
    focal = -error.focal_std_fraction * (across @ flat[:, None])
    centre = -error.centre_std_px * across[:, 2:] * (contour.normal[:2] / focal_px)
    of_camera = BiasTerm(FOCAL_LENGTH, focal), BiasTerm(PRINCIPAL_POINT, centre)

    def in_view(_: LinkMeasurement, T_view_link: Array) -> Seen | None:
        d, arm_m = T_view_link[:3, :3] @ shaft.axis, T_view_link[:3, :3] @ shaft.p_axis_m
        point_m = T_view_link[:3, 3] + arm_m
        normal, by_point, by_direction = tangent_normal(point_m, d, radius_m, contour.side)
        if not np.isfinite(normal).all():  # the camera is inside the shaft
            return None
        H = across @ np.concatenate([by_point, -by_point @ skew(arm_m) - by_direction @ skew(d)], 1)
        foot_m = point_m - (d * point_m).sum() * d
        square_m2 = (foot_m * foot_m).sum()
        beside_m = contour.side * np.sqrt(max(square_m2 - radius_m**2, MIN_DEPTH_M**2))
        by_radius = (beside_m * foot_m - radius_m * (skew(d) @ foot_m)) / (square_m2 * beside_m)
        radius = across @ (by_radius * radius_m)[:, None] * radius_std_fraction
        return Seen(across @ (contour.normal - normal), H, by_bias, (*of_camera, BiasTerm(SHAFT_RADIUS, radius)))

    return in_view


def shaft_end(
    camera: Camera,
    rim: Rim,
    axis: Array,
    p_hinge_m: Array,
    ahead_m: float,
    radius_m: float,
    model_std_m: float,
    bias_std_px: float,
    error: CameraError,
) -> InView:
    """Where the shaft's end is along its middle line in the image: measured minus predicted in px, shape (1,).

    It is so far ahead of the hinge, which is at `p_hinge_m`, (3,) in the link's frame, along the axis (3,): `ahead_m`
    and how wrong that may be. That of the dark part ends the generatrix that faces the camera, at `radius_m` off the
    axis; the outline's is on it. A band or a plate that is taken for the end stays one, `bias_std_px` off.
    """
    towards_tip, each = rim.towards_tip, pixel_biases(rim.pixel, camera, error)
    of_camera = [BiasTerm(one.name, (towards_tip @ one.jacobian)[None]) for one in each]

    def in_view(_: LinkMeasurement, T_view_link: Array) -> Seen | None:
        d, arm_m = T_view_link[:3, :3] @ axis, T_view_link[:3, :3] @ p_hinge_m
        hinge_m = T_view_link[:3, 3] + arm_m
        along_m = float(d @ hinge_m)
        foot_m = hinge_m - along_m * d
        distance_m = float(np.linalg.norm(foot_m))
        facing = foot_m / max(distance_m, MIN_DEPTH_M)
        point_m = hinge_m + ahead_m * d - radius_m * facing
        if point_m[2] < MIN_DEPTH_M or distance_m < MIN_DEPTH_M:
            return None
        pixel, J = camera.project_with_derivative(point_m)
        across = radius_m / distance_m * (np.eye(3) - np.outer(facing, facing))
        by_hinge = np.eye(3) - across @ (np.eye(3) - np.outer(d, d))
        by_axis = ahead_m * np.eye(3) + across @ (along_m * np.eye(3) + np.outer(d, hinge_m))
        by_pose = np.concatenate([by_hinge, -by_hinge @ skew(arm_m) - by_axis @ skew(d)], 1)
        H = (towards_tip @ J @ by_pose)[None]
        by_place = H[:, :3] @ T_view_link[:3, :3] @ axis[:, None]
        bias = np.copysign(np.hypot(model_std_m * by_place, bias_std_px), by_place)
        return Seen(np.array([(rim.pixel - pixel) @ towards_tip]), H, bias, of_camera)

    return in_view


def pose(T_link_frame: Array, T_camera_frame: Array, by_bias: Array, shared: Sequence[BiasTerm] = ()) -> InView:
    """A pose measured as a whole, of a frame that is fixed on a link: (δp, δθ) from predicted to measured, (6,)."""

    def in_view(_: LinkMeasurement, T_view_link: Array) -> Seen | None:
        predicted = T_view_link @ T_link_frame
        turn = rotation_vector(T_camera_frame[:3, :3] @ predicted[:3, :3].T)
        H = np.zeros((6, 6))
        H[:3, :3] = np.eye(3)
        H[:3, 3:] = -skew(predicted[:3, 3] - T_view_link[:3, 3])
        # exp([φ]) exp([-δθ]) = exp([φ - J⁻¹ δθ]), J the right Jacobian (Solà 2018, "A micro Lie theory", sec. 4.3).
        H[3:, 3:] = inverse_right_jacobian(turn)
        residual = np.concatenate([T_camera_frame[:3, 3] - predicted[:3, 3], turn])
        return Seen(residual, H, by_bias, shared)

    return in_view

"""What is known of a shaft before looking, and what an image and kinematics say of its pose, as residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.camera import Camera
from svmdist.errors import ProfileError
from svmdist.estimation.instrument.measurement import Deviations, SharedBias, edge_by_radius
from svmdist.estimation.instrument.model import NECK_PER_RADIUS
from svmdist.estimation.instrument.shaft_detection import Contour, DistalMarker, Rim, ShaftDetection
from svmdist.kinematics import DHChain, frame_transforms, joint_axis, rows_behind_insertion
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.robot import Instrument, KinematicError
from svmdist.profile.settings import ShaftSettings
from svmdist.results import Failure
from svmdist.transforms import Array, inverse, make_transform, rotation_of, rotation_vector, skew
from svmdist.vision.lines import apparent_radius_px, tangent_normal
from svmdist.vision.silhouette import WristPoint, WristShape

OUTLINE_END_STD_RADII = 0.25  # of the cylinder's end in an outline: clevises differ, a bent wrist hides them
UNKNOWN_OUTLINE_END_STD_RADII = 0.45  # without the profile's word: real instruments had 0 and 0.9 radii
JAW_TIP_STD = 0.35  # of an outline's tip over the length of closed, straight jaws: they open and turn

MAX_TURN_RAD = 0.5  # of one step: beyond it the derivatives of the residuals say nothing
OUTLINE_END_PER_RADIUS = 0.9
"""The clevis of a da Vinci instrument of 8 mm reaches so far beyond the wrist's pitch axis, over the shaft's radius."""


@dataclass(frozen=True, slots=True)
class ShaftModel:
    """The instrument behind its shaft's frame S: origin on the wrist's hinge, z along the shaft to the tip.

    `T_shaft_tool` is the wrist as the joints bend it, `bend_std_rad` how wrong that may be about each axis
    across the shaft. `R_camera_shaft` (3, 3) is that of the nominal kinematics, None without the robot's base,
    with `rotation_std_rad`. The dark part ends `neck_m` behind the hinge.
    """

    T_shaft_tool: Array
    bend_std_rad: float
    R_camera_shaft: Array | None
    rotation_std_rad: float
    radius_m: float
    neck_m: float
    knuckle_radius_m: float
    marker_std_m: float  # of the distal marker's place at the tool's origin, and of the wrist's length
    outline_end_m: float  # how far before the hinge the outline stops being a cylinder's
    outline_end_std_m: float
    jaw_length_m: float
    jaws: Array  # the direction of straight, closed jaws in the tool's frame, shape (3,), of length 1


def shaft_model(
    robot: RobotState | Failure,
    chain: DHChain,
    instrument: Instrument,
    error: KinematicError,
    settings: ShaftSettings,
) -> ShaftModel:
    """What is known before looking: the instrument's sizes, the wrist's bend, and the nominal rotation."""
    state = robot if isinstance(robot, RobotState) else None
    q = None if state is None else state.q
    roll = roll_row(chain)
    T_base_shaft, T_shaft_tool = shaft_frames(chain, np.zeros(len(chain.joint_names)) if q is None else q)
    _, straight = shaft_frames(chain, np.zeros(len(chain.joint_names)))
    R_nominal, rotation_std_rad, bend_std_rad = None, np.pi, settings.unknown_bend_rad
    if state is not None and state.T_camera_base is not None:
        R_nominal = np.asarray((state.T_camera_base @ T_base_shaft)[:3, :3])
        moving = [row.name for row in chain.rows]
        first = moving.index(error.first_moving_joint) if error.first_moving_joint in moving else 0
        turning = sum(row.type == "revolute" for row in chain.rows[first : roll + 1])
        rotation_std_rad = float(np.hypot(error.camera_base_std_rad, error.joint_std_rad * np.sqrt(turning)))
        bend_std_rad = float(np.hypot(error.joint_std_rad, error.play_std_rad))
    elif q is not None:
        # How much the wrist is bent is known, but not to which side in the camera frame.
        tool = T_shaft_tool[:3, 3]
        bend_std_rad = max(0.05, float(np.arctan2(np.hypot(tool[0], tool[1]), tool[2])))
        T_shaft_tool = make_transform(T_shaft_tool[:3, :3], [0.0, 0.0, float(np.linalg.norm(tool))])
    return ShaftModel(
        T_shaft_tool,
        bend_std_rad,
        R_nominal,
        rotation_std_rad,
        instrument.shaft_radius_m,
        instrument.shaft_end_m or NECK_PER_RADIUS * instrument.wrist_radius_m,
        instrument.knuckle_radius_m,
        float(np.hypot(instrument.knuckle_position_std_m, error.length_std_m)),
        outline_end_m(instrument),
        instrument.shaft_radius_m
        * (UNKNOWN_OUTLINE_END_STD_RADII if instrument.outline_end_m is None else OUTLINE_END_STD_RADII),
        instrument.jaw_length_m,
        straight[2, :3].copy(),
    )


def wrist_shape(chain: DHChain, instrument: Instrument) -> WristShape:
    """What is to be seen beyond the outline's end, with the wrist straight."""
    _, T_shaft_tool = shaft_frames(chain, np.zeros(len(chain.joint_names)))
    ahead_m = max(float(T_shaft_tool[2, 3]) - outline_end_m(instrument), 0.0)
    length_m = ahead_m + instrument.jaw_length_m
    return WristShape(ahead_m / length_m, length_m / (2.0 * instrument.shaft_radius_m))


def outline_end_m(instrument: Instrument) -> float:
    """How far before the hinge the outline stops being the shaft's."""
    if instrument.outline_end_m is not None:
        return instrument.outline_end_m
    return OUTLINE_END_PER_RADIUS * instrument.shaft_radius_m


def roll_row(chain: DHChain) -> int:
    """The row whose joint turns the shaft about itself; the wrist is behind it."""
    turns = rows_behind_insertion(chain)
    if len(turns) < 2:
        raise ProfileError(
            "the method shaft needs a chain that slides along its shaft, turns it, and has a wrist"
        )
    return turns[0]


def shaft_frames(chain: DHChain, q: Array) -> tuple[Array, Array]:
    """`T_base_shaft` and `T_shaft_tool` at joints `q`, shape (n_joints,)."""
    frames = frame_transforms(chain, q)
    roll = roll_row(chain)
    z, on_axis_m = joint_axis(chain, frames, roll)
    _, hinge_m = joint_axis(chain, frames, roll + 1)
    x = frames[roll, :3, 0] - z * float(z @ frames[roll, :3, 0])
    x /= np.linalg.norm(x)
    origin_m = on_axis_m + z * float(z @ (hinge_m - on_axis_m))
    T_base_shaft = make_transform(np.stack([x, np.cross(z, x), z], -1), origin_m)
    return T_base_shaft, inverse(T_base_shaft) @ frames[-1] @ chain.T_last_tool


FREE_RAD, FREE_M = 3.0, 0.1  # deviations of what nothing is known of: half a turn, a whole scene


@dataclass(frozen=True, slots=True)
class ShaftState:
    """The shaft's frame, shape (4, 4), and the wrist's bend about its x and y axes, shape (2,), in rad."""

    T: Array
    bend: Array

    def retracted(self, step: Array) -> ShaftState:
        """The state after a step of the tangent space, shape (8,), shortened where it would turn the shaft too far."""
        step = step * min(1.0, MAX_TURN_RAD / max(float(np.linalg.norm(step[3:])), 1e-12))
        T = make_transform(rotation_of(step[3:6]) @ self.T[:3, :3], self.T[:3, 3] + step[:3])
        return ShaftState(T, self.bend + step[6:])


@dataclass(frozen=True, slots=True)
class Landmarks:
    """What of the image a fit takes for true."""

    shaft: ShaftDetection
    marker: DistalMarker | None


@dataclass(frozen=True, slots=True)
class Residual:
    """Measured minus predicted, whitened, (k,), the prediction's derivative, (k, 8), and that by `constants`."""

    name: str
    whitened: Array
    derivative: Array
    constants: tuple[SharedBias, ...] = ()


def bent_tool(state: ShaftState, model: ShaftModel) -> tuple[Array, Array]:
    """The tool behind the bent wrist: `T_camera_tool`, shape (4, 4), and its derivative (δp, δθ), shape (6, 8)."""
    bend = np.array([state.bend[0], state.bend[1], 0.0])
    R = state.T[:3, :3] @ rotation_of(bend)
    arm_m = R @ model.T_shaft_tool[:3, 3]
    derivative = np.zeros((6, 8))
    derivative[:3, :3] = derivative[3:, 3:6] = np.eye(3)
    derivative[3:, 6:] = state.T[:3, :3] @ left_jacobian(bend)[:, :2]
    derivative[:3, 3:] = -skew(arm_m) @ derivative[3:, 3:]
    return make_transform(R @ model.T_shaft_tool[:3, :3], state.T[:3, 3] + arm_m), derivative


def contour_residual(
    contour: Contour,
    whitening: Array,
    state: ShaftState,
    model: ShaftModel,
    camera: Camera,
    deviations: Deviations,
) -> Residual:
    """The plane that touches the shaft along one side; `whitening`, shape (2, 3), is the plane's own."""
    hinge_m, d, radius_m = state.T[:3, 3], state.T[:3, 2], np.array(model.radius_m)
    normal, by_point, by_direction = tangent_normal(hinge_m, d, model.radius_m, contour.side)
    derivative = np.zeros((2, 8))
    derivative[:, :3] = whitening @ by_point
    derivative[:, 3:6] = -whitening @ by_direction @ skew(d)
    by_radius = edge_by_radius(hinge_m, d, radius_m, np.array(contour.side))
    focal_px = np.diag(camera.K)[:2]
    constants = deviations.of_edge(contour.plane.normal, whitening, by_radius, radius_m, focal_px)
    off = whitening @ (contour.plane.normal - normal)
    return Residual(f"side {contour.side:+d}", off, derivative, constants)


def rim_residual(
    rim: Rim, state: ShaftState, model: ShaftModel, camera: Camera, settings: ShaftSettings
) -> Residual:
    """Where the dark part ends: the end of the generatrix that faces the camera. An outline's end is on the axis."""
    ahead_m, radius_m, model_std_m = -model.neck_m, model.radius_m, settings.end_model_std_m
    if rim.is_outline:
        ahead_m, radius_m, model_std_m = model.outline_end_m, 0.0, model.outline_end_std_m
    hinge_m, d = state.T[:3, 3], state.T[:3, 2]
    along_m = float(d @ hinge_m)
    foot_m = hinge_m - along_m * d
    distance_m = float(np.linalg.norm(foot_m))
    facing = foot_m / distance_m
    point_m = hinge_m + ahead_m * d - radius_m * facing
    across = (np.eye(3) - np.outer(facing, facing)) / distance_m
    by_hinge = np.eye(3) - radius_m * across @ (np.eye(3) - np.outer(d, d))
    by_direction = ahead_m * np.eye(3) + radius_m * across @ (along_m * np.eye(3) + np.outer(d, hinge_m))
    pixel, by_point = camera.project_with_derivative(point_m)
    model_std_px = model_std_m * camera.K[0, 0] / point_m[2]
    std_px = float(np.hypot(rim.std_px, model_std_px))
    off = float((rim.pixel - pixel) @ rim.towards_tip) / std_px
    # The deviation depends on the depth, too.
    slope = rim.towards_tip @ by_point / std_px
    slope[2] -= off * model_std_px**2 / (point_m[2] * std_px**2)
    derivative = np.zeros((1, 8))
    derivative[0, :3] = slope @ by_hinge
    derivative[0, 3:6] = -slope @ by_direction @ skew(d)
    return Residual("rim", np.array([off]), derivative)


def marker_residual(
    marker: DistalMarker, state: ShaftState, model: ShaftModel, camera: Camera, deviations: Deviations
) -> Residual:
    """The marker's middle at the tool's origin."""
    T, by_state = bent_tool(state, model)
    pixel, by_point = camera.project_with_derivative(T[:3, 3])
    place = SharedBias("marker place", model.marker_std_m * by_point)
    biases = (*deviations.of_pixels(marker.centre_px, camera), place)
    constants = tuple(bias.scaled(1.0 / marker.std_px) for bias in biases)
    off = (marker.centre_px - pixel) / marker.std_px
    return Residual("distal marker", off, by_point @ by_state[:3] / marker.std_px, constants)


def size_residual(
    marker: DistalMarker, state: ShaftState, model: ShaftModel, camera: Camera, deviations: Deviations
) -> Residual:
    """The radius of a marker that is visible as a whole."""
    T, by_state = bent_tool(state, model)
    tool_m, measured_px, std_px = T[:3, 3], marker.radius_px or 0.0, marker.radius_std_px
    radius_px = float(apparent_radius_px(tool_m, model.knuckle_radius_m, camera))
    slope = radius_px * 0.5 * tool_m / float(tool_m @ tool_m)
    slope[2] -= 1.5 * radius_px / tool_m[2]
    constants = tuple(bias.scaled(1.0 / std_px) for bias in deviations.of_radius(np.array(radius_px)))
    off = np.array([(measured_px - radius_px) / std_px])
    return Residual("size", off, (slope @ by_state[:3] / std_px)[None], constants)


def tip_residual(wrist: WristPoint, state: ShaftState, model: ShaftModel, camera: Camera) -> Residual:
    """The outline's tip: closed jaws that go on as the wrist does. How long it looks tells how far that is turned."""
    T, by_state = bent_tool(state, model)
    arm_m, depth_m = model.jaw_length_m * (T[:3, :3] @ model.jaws), float(T[2, 3])
    pixel, by_point = camera.project_with_derivative(T[:3, 3] + arm_m)
    std_px = JAW_TIP_STD * model.jaw_length_m * float(camera.K[0, 0]) / depth_m
    off = (wrist.tip_px - pixel) / std_px
    # The deviation depends on the depth, too.
    moved = by_point @ (by_state[:3] - skew(arm_m) @ by_state[3:]) / std_px
    return Residual("jaws' tip", off, moved - np.outer(off, by_state[2] / depth_m))


def prior_residual(state: ShaftState, start: Array, model: ShaftModel) -> Residual:
    """Nominal kinematics: the shaft's rotation, the wrist's bend, and no more than a scene's size from the start."""
    R_prior, std_rad = start[:3, :3], FREE_RAD
    if model.R_camera_shaft is not None:
        R_prior, std_rad = model.R_camera_shaft, model.rotation_std_rad
    turn = rotation_vector(state.T[:3, :3] @ R_prior.T)
    away_m = state.T[:3, 3] - start[:3, 3]
    off = -np.concatenate([turn / std_rad, state.bend / model.bend_std_rad, away_m / FREE_M])
    derivative = np.zeros((8, 8))
    derivative[:3, 3:6] = np.linalg.inv(left_jacobian(turn)) / std_rad
    derivative[3:5, 6:] = np.eye(2) / model.bend_std_rad
    derivative[5:, :3] = np.eye(3) / FREE_M
    return Residual("nominal kinematics", off, derivative)


def left_jacobian(vector_rad: Array) -> Array:
    """J (3, 3) with exp([v + δ]) = exp([J δ]) exp([v]) to first order (Solà 2018, eq. 145)."""
    K = skew(vector_rad)
    angle = float(np.linalg.norm(vector_rad))
    if angle < 1e-4:  # the next terms of the series are below 1e-13
        return np.asarray(np.eye(3) + 0.5 * K + K @ K / 6.0)
    first, second = (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * K + second * (K @ K))

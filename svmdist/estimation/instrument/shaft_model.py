"""What is known of a shaft before looking, and what an image and kinematics say of its pose, as residuals."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from svmdist.camera import Camera
from svmdist.errors import ProfileError
from svmdist.estimation.instrument.measurement import EXACT, Deviations, SharedBias, edge_by_radius
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

DEFAULT = ShaftSettings()
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
    marker_std_m: float = 0.0
    """How far the distal marker may be from the tool's origin, along each axis, and how wrong the wrist's length is."""
    outline_end_m: float = 0.0
    """How far before the hinge the outline stops being a cylinder's, and how wrong that may be."""
    outline_end_std_m: float = 0.0
    jaw_length_m: float = 0.0
    jaws: Array = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    """The direction of straight, closed jaws in the tool's frame, shape (3,), of length 1."""


def shaft_model(
    robot: RobotState | Failure,
    chain: DHChain,
    instrument: Instrument,
    error: KinematicError,
    settings: ShaftSettings = DEFAULT,
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
        straight_m = [0.0, 0.0, float(np.linalg.norm(tool))]
        T_shaft_tool = make_transform(np.eye(3), straight_m) @ make_transform(
            T_shaft_tool[:3, :3], np.zeros(3)
        )
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


NO_FOCAL_PX = np.ones(2)  # where no deviation asks for it
FREE_RAD, FREE_M = 3.0, 0.1
"""Standard deviations of an angle and of a place of which nothing is known: half a turn, a whole scene."""


@dataclass(frozen=True, slots=True)
class ShaftState:
    """The shaft's frame, shape (4, 4), and the wrist's bend about its x and y axes, shape (2,), in rad."""

    T: Array
    bend: Array

    def retracted(self, step: Array) -> ShaftState:
        """The state after a step of the tangent space, shape (8,)."""
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


@dataclass(frozen=True, slots=True)
class BentTool:
    """The tool behind the bent wrist: `T_camera_tool`, shape (4, 4), and its derivative (δp, δθ), shape (6, 8)."""

    T: Array
    derivative: Array

    @staticmethod
    def of(state: ShaftState, model: ShaftModel) -> BentTool:
        """The tool of a state."""
        bend = np.array([state.bend[0], state.bend[1], 0.0])
        R = state.T[:3, :3] @ rotation_of(bend)
        arm_m = R @ model.T_shaft_tool[:3, 3]
        derivative = np.zeros((6, 8))
        derivative[:3, :3] = derivative[3:, 3:6] = np.eye(3)
        derivative[3:, 6:] = state.T[:3, :3] @ left_jacobian(bend)[:, :2]
        derivative[:3, 3:] = -skew(arm_m) @ derivative[3:, 3:]
        return BentTool(make_transform(R @ model.T_shaft_tool[:3, :3], state.T[:3, 3] + arm_m), derivative)


def contour_residual(
    contour: Contour,
    whitening: Array,
    state: ShaftState,
    radius_m: float,
    focal_px: Array = NO_FOCAL_PX,
    deviations: Deviations = EXACT,
) -> Residual:
    """The plane that touches the shaft along one side; `whitening`, shape (2, 3), is the plane's own."""
    d = state.T[:3, 2]
    normal, by_point, by_direction = tangent_normal(state.T[:3, 3], d, radius_m, contour.side)
    derivative = np.zeros((2, 8))
    derivative[:, :3] = whitening @ by_point
    derivative[:, 3:6] = -whitening @ by_direction @ skew(d)
    by_radius = edge_by_radius(state.T[:3, 3], d, np.array(radius_m), np.array(contour.side))
    constants = deviations.of_edge(contour.plane.normal, whitening, by_radius, np.array(radius_m), focal_px)
    off = whitening @ (contour.plane.normal - normal)
    return Residual(f"side {contour.side:+d}", off, derivative, constants)


def rim_residual(
    rim: Rim, state: ShaftState, model: ShaftModel, camera: Camera, settings: ShaftSettings
) -> Residual:
    """Where the dark part ends: the end of the generatrix that faces the camera. An outline's end is on the axis."""
    ahead_m, radius_m, model_std_m = -model.neck_m, model.radius_m, settings.end_model_std_m
    if rim.is_outline:
        ahead_m, radius_m = model.outline_end_m, 0.0
        model_std_m = model.outline_end_std_m
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


def marker_residuals(
    marker: DistalMarker, tool: BentTool, model: ShaftModel, camera: Camera, deviations: Deviations = EXACT
) -> list[Residual]:
    """The marker's middle at the tool's origin, and its radius where the whole of it is visible."""
    tool_m, by_state = tool.T[:3, 3], tool.derivative[:3]
    pixel, by_point = camera.project_with_derivative(tool_m)
    biases = deviations.of_pixels(marker.centre_px, camera)
    place = SharedBias("marker place", model.marker_std_m * by_point)
    constants = tuple(bias.scaled(1.0 / marker.std_px) for bias in (*biases, place))
    off = (marker.centre_px - pixel) / marker.std_px
    found = [Residual("distal marker", off, by_point @ by_state / marker.std_px, constants)]
    if marker.radius_px is not None:
        radius_px = float(apparent_radius_px(tool_m, model.knuckle_radius_m, camera))
        slope = radius_px * 0.5 * tool_m / float(tool_m @ tool_m)
        slope[2] -= 1.5 * radius_px / tool_m[2]
        off = np.array([(marker.radius_px - radius_px) / marker.radius_std_px])
        biases = deviations.of_radius(np.array(radius_px))
        constants = tuple(bias.scaled(1.0 / marker.radius_std_px) for bias in biases)
        found.append(Residual("size", off, (slope @ by_state / marker.radius_std_px)[None], constants))
    return found


def tip_residual(wrist: WristPoint, tool: BentTool, model: ShaftModel, camera: Camera) -> Residual:
    """The outline's tip: closed jaws that go on as the wrist does. How long it looks tells how far that is turned."""
    along = tool.T[:3, :3] @ model.jaws
    arm_m = model.jaw_length_m * along
    pixel, by_point = camera.project_with_derivative(tool.T[:3, 3] + arm_m)
    std_px = JAW_TIP_STD * model.jaw_length_m * float(camera.K[0, 0]) / float(tool.T[2, 3])
    by_state = tool.derivative[:3] - skew(arm_m) @ tool.derivative[3:]
    off = (wrist.tip_px - pixel) / std_px
    # The deviation depends on the depth, too.
    derivative = by_point @ by_state / std_px - np.outer(off, tool.derivative[2] / float(tool.T[2, 3]))
    return Residual("jaws' tip", off, derivative)


def prior_residual(state: ShaftState, start: Array, model: ShaftModel) -> Residual:
    """Nominal kinematics: the shaft's rotation, the wrist's bend, and no more than a scene's size from the start."""
    is_known = model.R_camera_shaft is not None
    R_prior = model.R_camera_shaft if model.R_camera_shaft is not None else start[:3, :3]
    std_rad = model.rotation_std_rad if is_known else FREE_RAD
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

"""What is known of a shaft before looking: its sizes, its frame, the wrist's bend, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from svmdist.errors import ProfileError
from svmdist.estimation.instrument.model import NECK_PER_RADIUS
from svmdist.kinematics.dh import DHChain, frame_transforms, joint_axis, rows_behind_insertion
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile import Instrument, KinematicError
from svmdist.profile.settings import ShaftSettings
from svmdist.results import Failure
from svmdist.transforms import Array, inverse, make_transform
from svmdist.vision.wrist_outline import WristShape

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
        turning = sum(row.joint == "revolute" for row in chain.rows[first : roll + 1])
        rotation_std_rad = float(np.hypot(error.camera_base_std_rad, error.joint_std_rad * np.sqrt(turning)))
        bend_std_rad = float(np.hypot(error.joint_std_rad, error.play_std_rad))
    elif q is not None:
        # How much the wrist is bent is known, but not to which side in the camera frame.
        tool = T_shaft_tool[:3, 3]
        bend_std_rad = max(0.05, float(np.arctan2(np.hypot(tool[0], tool[1]), tool[2])))
        T_shaft_tool = make_transform(np.eye(3), [0.0, 0.0, float(np.linalg.norm(tool))]) @ make_transform(
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
        * (
            settings.unknown_outline_end_std_radii
            if instrument.outline_end_m is None
            else settings.outline_end_std_radii
        ),
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
    """`T_base_shaft` and `T_shaft_tool` at joints `q`, shape (n_joints,).

    The shaft's frame: z along the roll's axis, which is the insertion's, to the tip; its origin is the point of that
    axis next to the wrist's pitch axis.
    """
    frames = frame_transforms(chain, q)
    roll = roll_row(chain)
    z, on_axis_m = joint_axis(chain, frames, roll)
    _, hinge_m = joint_axis(chain, frames, roll + 1)
    x = frames[roll, :3, 0] - z * float(z @ frames[roll, :3, 0])
    x /= np.linalg.norm(x)
    origin_m = on_axis_m + z * float(z @ (hinge_m - on_axis_m))
    T_base_shaft = make_transform(np.stack([x, np.cross(z, x), z], -1), origin_m)
    return T_base_shaft, inverse(T_base_shaft) @ frames[-1] @ chain.T_last_tool

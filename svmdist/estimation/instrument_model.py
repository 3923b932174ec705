"""The instrument as capsules: shaft, wrist, knuckle and jaws from the profile, posed by the tool and the wrist.

The last four rows of a chain are roll, wrist pitch, wrist yaw and jaw, as in the tools of a da Vinci. The
parts are placed by the joints' axes, which every DH convention has, and not by its link frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.errors import KinematicsError
from svmdist.estimation.pose import ToolPose
from svmdist.geometry.surfaces import Capsules
from svmdist.kinematics.chain import chain_of
from svmdist.kinematics.dh import DHChain, frame_transforms, select_joints
from svmdist.kinematics.jacobian import joint_axis
from svmdist.profile import Instrument, Profile
from svmdist.samples import JointSample
from svmdist.transforms import Array, inverse, transform_points

WRIST_ROWS = 4
WRIST_LENGTH_PER_RADIUS = 3.4
"""Distance from the wrist's hinge to the tool over the wrist's radius, where no chain tells: 9.1 / 2.7."""
NECK_PER_RADIUS = 2.2
"""The shaft begins this many radii of the wrist behind the hinge."""


@dataclass(frozen=True, slots=True)
class Wrist:
    """The bent wrist in one frame: where the hinge is, and unit vectors along shaft, jaws and the jaws' axis.

    `hinge_m`, `tool_m` are points; `shaft` points towards the tip; shape (3,) each.
    """

    hinge_m: Array
    tool_m: Array
    shaft: Array
    pivot: Array
    fixed_jaw: Array
    moving_jaw: Array


class InstrumentModel:
    """Capsules of one instrument."""

    def __init__(self, instrument: Instrument, chain: DHChain | None) -> None:
        self._instrument = instrument
        self._chain = chain if chain is not None and len(chain.rows) > WRIST_ROWS else None

    @classmethod
    def of(cls, profile: Profile) -> InstrumentModel | None:
        """The profile's instrument; None where it has none."""
        if profile.instrument is None:
            return None
        return cls(profile.instrument, chain_of(profile.robot) if profile.robot else None)

    def posed(self, pose: ToolPose, joints: JointSample | None = None) -> Capsules:
        """Capsules in the camera frame: with the wrist as the joints bend it, or straight without joints."""
        bent = self.bent_wrist(joints)
        wrist = self._straight_wrist(pose) if bent is None else moved(bent, pose.T_camera_tool)
        return build_capsules(self._instrument, wrist)

    def bent_wrist(self, joints: JointSample | None) -> Wrist | None:
        """The wrist in the tool frame; None without a chain or without its joints."""
        if self._chain is None or joints is None:
            return None
        try:
            q = select_joints(self._chain, joints.names, joints.positions)
        except KinematicsError:
            return None
        return wrist_in_tool(self._chain, q)

    def _straight_wrist(self, pose: ToolPose) -> Wrist:
        tool_m, axis, length_m = pose.position_m, pose.axis, self._wrist_length_m()
        side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        pivot = side / np.linalg.norm(side)
        return Wrist(tool_m - length_m * axis, tool_m, axis, pivot, axis, axis)

    def _wrist_length_m(self) -> float:
        if self._chain is None:
            return WRIST_LENGTH_PER_RADIUS * self._instrument.wrist_radius_m
        wrist = wrist_in_tool(self._chain, np.zeros(len(self._chain.joint_names)))
        return float(np.linalg.norm(wrist.hinge_m))


def wrist_in_tool(chain: DHChain, q: Array) -> Wrist:
    """The wrist in the tool frame at joints `q`, shape (n_joints,)."""
    frames = frame_transforms(chain, q)
    T_base_tool = frames[-1] @ chain.T_last_tool
    roll, pitch, yaw, jaw = range(len(chain.rows) - WRIST_ROWS, len(chain.rows))
    shaft, _ = joint_axis(chain, frames, roll)
    _, hinge_m = joint_axis(chain, frames, pitch)
    pivot, _ = joint_axis(chain, frames, yaw)
    jaw_axis, _ = joint_axis(chain, frames, jaw)
    tool_m = T_base_tool[:3, 3]
    moving = T_base_tool[:3, 0]
    opening = q[-1] if chain.rows[jaw].joint == "revolute" else 0.0
    fixed = _turned(moving, jaw_axis, -float(opening))
    return moved(Wrist(hinge_m, tool_m, shaft, pivot, fixed, moving), inverse(T_base_tool))


def moved(wrist: Wrist, T_other_this: Array) -> Wrist:
    """The same wrist in another frame, by a transform of shape (4, 4)."""
    hinge_m, tool_m = transform_points(T_other_this, [wrist.hinge_m, wrist.tool_m])
    R = T_other_this[:3, :3]
    return Wrist(hinge_m, tool_m, R @ wrist.shaft, R @ wrist.pivot, R @ wrist.fixed_jaw, R @ wrist.moving_jaw)


def build_capsules(instrument: Instrument, wrist: Wrist) -> Capsules:
    """Shaft, collar, fork, knuckle and both jaws about a wrist, in its frame.

    A blade wider than thick is three rods side by side; the shaft's flat end is a cap that stands half a
    radius before it, which is right within 0.06 radii at the rim.
    """
    shaft_m, wrist_m, knuckle_m = (
        instrument.shaft_radius_m,
        instrument.wrist_radius_m,
        instrument.knuckle_radius_m,
    )
    hinge, tool, back = wrist.hinge_m, wrist.tool_m, -wrist.shaft
    neck_m = NECK_PER_RADIUS * wrist_m
    far_m = max(instrument.shaft_length_m - 0.5 * shaft_m, neck_m + 0.5 * shaft_m)
    rods: list[tuple[Array, Array, float]] = [
        (hinge + (neck_m + 0.5 * shaft_m) * back, hinge + far_m * back, shaft_m),
        (hinge, hinge + neck_m * back, wrist_m),
        (hinge, hinge + 0.35 * (tool - hinge), 0.5 * wrist_m),
        (tool, tool, knuckle_m),
    ]
    tine_m = knuckle_m + 0.0005
    for side in (-1.0, 1.0):
        offset = side * tine_m * wrist.pivot
        rods.append((hinge + 0.3 * (tool - hinge) + offset, tool + offset, 0.0005))
    for jaw, other in ((wrist.fixed_jaw, wrist.moving_jaw), (wrist.moving_jaw, wrist.fixed_jaw)):
        rods += _blade(instrument, tool, jaw, other, wrist.pivot)
    starts, ends, radii = zip(*rods, strict=True)
    return Capsules(np.array(starts), np.array(ends), np.array(radii))


def _blade(
    instrument: Instrument, tool: Array, jaw: Array, other: Array, pivot: Array
) -> list[tuple[Array, Array, float]]:
    """A jaw as three rods: a long one in the middle, two shorter ones that give it its width."""
    length_m, radius_m = instrument.jaw_length_m, 0.5 * instrument.jaw_radius_m
    width = np.cross(other, jaw)
    width = pivot if np.linalg.norm(width) < 1e-6 else width / np.linalg.norm(width)
    outward = np.cross(jaw, width)  # away from the other jaw: closed blades lie side by side
    base = tool + 1.1 * radius_m * outward
    rods = [(base, base + (length_m - 0.6 * radius_m) * jaw, 0.6 * radius_m)]
    for side in (-1.0, 1.0):
        offset = side * 0.9 * radius_m * width
        rods.append((base + offset, base + offset + 0.72 * length_m * jaw, radius_m))
    return rods


def _turned(vector: Array, axis: Array, angle_rad: float) -> Array:
    """Rodrigues' rotation of a vector about a unit axis, shape (3,)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.asarray(c * vector + s * np.cross(axis, vector) + (1.0 - c) * (axis @ vector) * axis)

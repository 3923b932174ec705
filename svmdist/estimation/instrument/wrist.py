"""The wrist between shaft and jaws: where the joints put its hinge, and how they turn shaft and jaws.

Its parts are placed by the joints' axes, which every DH convention has, and not by its link frames. With all
joints of the wrist at zero the jaws continue the shaft.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.errors import KinematicsError
from svmdist.geometry.closest import cross
from svmdist.kinematics.dh import DHChain, WristRows, frame_transforms, joint_axis, select_joints, wrist_rows
from svmdist.samples import JointSample
from svmdist.transforms import Array


@dataclass(frozen=True, slots=True)
class Jaw:
    """A jaw's unit vectors, shape (3,) each: along it to its tip, away from the other jaw, and across both."""

    along: Array
    outward: Array
    beside: Array


@dataclass(frozen=True, slots=True)
class Wrist:
    """The bent wrist in one frame: where the hinge is, and unit vectors along shaft, jaws and the jaws' axis.

    `hinge_m`, `tool_m` are points; `shaft` points towards the tip; shape (3,) each.
    """

    hinge_m: Array
    tool_m: Array
    shaft: Array
    pivot: Array
    jaws: tuple[Jaw, Jaw]

    def vectors(self) -> Array:
        """All points and unit vectors, shape (10, 3)."""
        jaws = [vector for jaw in self.jaws for vector in (jaw.along, jaw.outward, jaw.beside)]
        return np.stack([self.hinge_m, self.tool_m, self.shaft, self.pivot, *jaws])

    @staticmethod
    def of(vectors: Array) -> Wrist:
        """The wrist with these points and vectors."""
        hinge_m, tool_m, shaft, pivot, *jaws = vectors
        return Wrist(hinge_m, tool_m, shaft, pivot, (Jaw(*jaws[:3]), Jaw(*jaws[3:])))


@dataclass(frozen=True, slots=True)
class WristKinematics:
    """How a chain's joints bend its wrist.

    `straight` is the jaws' direction in the tool frame, shape (3,): the shaft's, with the wrist's joints at zero.
    `length_m` is the distance from the hinge to the tool then.
    """

    chain: DHChain
    rows: WristRows
    straight: Array
    length_m: float

    @staticmethod
    def of(chain: DHChain) -> WristKinematics | None:
        """The chain's wrist; None for a chain without one."""
        rows = wrist_rows(chain)
        if rows is None:
            return None
        frames = frame_transforms(chain, np.zeros(len(chain.joint_names)))
        shaft, _ = joint_axis(chain, frames, rows.roll)
        _, hinge_m = joint_axis(chain, frames, rows.pitch)
        T_base_tool = frames[-1] @ chain.T_last_tool
        length_m = float(np.linalg.norm(T_base_tool[:3, 3] - hinge_m))
        return WristKinematics(chain, rows, np.asarray(T_base_tool[:3, :3].T @ shaft), length_m)

    def wrist_in_tool(self, frames: Array, q: Array) -> Wrist:
        """The wrist in the tool frame at joints `q`, shape (n_joints,), with the poses of all rows' frames there."""
        T_base_tool = frames[-1] @ self.chain.T_last_tool
        R, tool_m = T_base_tool[:3, :3], T_base_tool[:3, 3]
        shaft, _ = joint_axis(self.chain, frames, self.rows.roll)
        _, hinge_m = joint_axis(self.chain, frames, self.rows.pitch)
        pivot, _ = joint_axis(self.chain, frames, self.rows.yaw)
        jaw_axis, opening_rad = pivot, 0.0
        if self.rows.jaw is not None:
            jaw_axis, _ = joint_axis(self.chain, frames, self.rows.jaw)
            opening_rad = float(q[_joint_index(self.chain, self.rows.jaw)])
        hinge_m, shaft, pivot, jaw_axis = np.stack([hinge_m - tool_m, shaft, pivot, jaw_axis]) @ R
        return Wrist(hinge_m, np.zeros(3), shaft, pivot, jaws_of(self.straight, jaw_axis, opening_rad))


def wrist_in_tool(chain: DHChain, q: Array) -> Wrist:
    """The wrist in the tool frame at joints `q`, shape (n_joints,); raises KinematicsError for a chain without one.

    The tool turns with the moving jaw. A chain without a jaw's joint has its jaws closed.
    """
    kinematics = WristKinematics.of(chain)
    if kinematics is None:
        raise KinematicsError(
            "the chain has no wrist: nothing slides, or less than three joints turn behind it"
        )
    return kinematics.wrist_in_tool(frame_transforms(chain, q), q)


def joints_of(chain: DHChain | None, joints: JointSample | None) -> Array | None:
    """The chain's joints, shape (n_joints,); None without one of both, or where the sample lacks a joint."""
    if chain is None or joints is None:
        return None
    try:
        return select_joints(chain, joints.names, joints.positions)
    except KinematicsError:
        return None


def jaws_of(along: Array, axis: Array, opening_rad: float) -> tuple[Jaw, Jaw]:
    """Moving and fixed jaw: turning by the opening about the unit `axis` takes the fixed one to the moving one."""
    fixed = _turned(along, axis, -opening_rad)
    return _jaw(along, cross(axis, along)), _jaw(fixed, -cross(axis, fixed))


def _jaw(along: Array, outward: Array) -> Jaw:
    return Jaw(along, outward, cross(along, outward))


def _joint_index(chain: DHChain, row: int) -> int:
    return sum(other.joint != "fixed" for other in chain.rows[:row])


def _turned(vector: Array, axis: Array, angle_rad: float) -> Array:
    """Rodrigues' rotation of a vector about a unit axis, shape (3,)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.asarray(c * vector + s * cross(axis, vector) + (1.0 - c) * (axis @ vector) * axis)

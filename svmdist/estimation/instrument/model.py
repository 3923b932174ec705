"""The instrument as capsules: shaft, wrist, knuckle and jaws from the profile, posed by the tool and the wrist.

The parts are placed by the joints' axes, which every DH convention has, and not by its link frames. With all
joints of the wrist at zero the jaws continue the shaft.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.errors import KinematicsError
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.geometry.surfaces import Capsules, join
from svmdist.kinematics.chain import chain_of
from svmdist.kinematics.dh import DHChain, frame_transforms, select_joints
from svmdist.kinematics.jacobian import joint_axis, row_index
from svmdist.kinematics.wrist import WristRows, wrist_rows
from svmdist.profile import Fiducial, Instrument, Profile
from svmdist.samples import JointSample
from svmdist.transforms import Array, inverse, transform_points

WRIST_LENGTH_PER_RADIUS = 3.4
"""Distance from the wrist's hinge to the tool over the wrist's radius, where no chain tells: 9.1 / 2.7."""
NECK_PER_RADIUS = 2.2
"""The shaft begins this many radii of the wrist behind the hinge."""
BLADE_RODS = (
    (0.0, 0.62, 0.43, 0.50),
    (0.0, 0.62, -0.43, 0.50),
    (0.62, 0.85, 0.30, 0.38),
    (0.62, 0.85, -0.30, 0.38),
    (0.0, 1.0, 0.0, 0.25),
)
"""A tapering blade, wider than thick: where a rod begins and ends over the jaw's length, how far beside the middle
it lies and how thick it is, both over the jaw's radius. The last one ends with its cap."""
PLATE_RADIUS_M, PLATE_RODS = 0.0003, 7
"""Half of the thickness of a printed plate; rods 1.4 mm apart stand in for one of 9 mm."""
BLADE_OFFSET = 0.55
"""A blade's middle plane stands this many radii of the jaw outside the plane where the jaws meet."""


@dataclass(frozen=True, slots=True)
class Jaw:
    """A jaw's unit vectors, shape (3,) each: along it to its tip, and away from the other jaw."""

    along: Array
    outward: Array


@dataclass(frozen=True, slots=True)
class Wrist:
    """The bent wrist in one frame: where the hinge is, and unit vectors along shaft, jaws and the jaws' axis.

    `hinge_m`, `tool_m` are points; `shaft` points towards the tip; shape (3,) each.
    """

    hinge_m: Array
    tool_m: Array
    shaft: Array
    pivot: Array
    jaws: tuple[Jaw, ...]


class InstrumentModel:
    """Capsules of one instrument."""

    def __init__(
        self, instrument: Instrument, chain: DHChain | None, fiducial: Fiducial | None = None
    ) -> None:
        self._instrument = instrument
        self._chain = chain if chain is not None and wrist_rows(chain) is not None else None
        self._fiducial = fiducial

    @classmethod
    def of(cls, profile: Profile) -> InstrumentModel | None:
        """The profile's instrument; None where it has none."""
        if profile.instrument is None:
            return None
        chain = chain_of(profile.robot) if profile.robot else None
        return cls(profile.instrument, chain, profile.fiducial)

    def posed(self, pose: ToolPose, joints: JointSample | None = None, has_plate: bool = False) -> Capsules:
        """Capsules in the camera frame: with the wrist as the joints bend it, or straight without joints.

        `has_plate` adds the plate of the profile's fiducial, where joints tell how its link stands.
        """
        q = joints_of(self._chain, joints)
        if self._chain is None or q is None:
            return build_capsules(self._instrument, self._straight_wrist(pose))
        body = build_capsules(self._instrument, moved(wrist_in_tool(self._chain, q), pose.T_camera_tool))
        if not has_plate or self._fiducial is None:
            return body
        frames = frame_transforms(self._chain, q)
        T_base_link = frames[row_index(self._chain, self._fiducial.link)]
        T_tool_tag = inverse(frames[-1] @ self._chain.T_last_tool) @ T_base_link @ self._fiducial.T_link_tag
        return join(body, plate_capsules(self._fiducial).transformed(pose.T_camera_tool @ T_tool_tag))

    def _straight_wrist(self, pose: ToolPose) -> Wrist:
        tool_m, axis, length_m = pose.position_m, pose.axis, self._wrist_length_m()
        side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        pivot = side / np.linalg.norm(side)
        return Wrist(tool_m - length_m * axis, tool_m, axis, pivot, _jaws(axis, pivot, 0.0))

    def _wrist_length_m(self) -> float:
        if self._chain is None:
            return WRIST_LENGTH_PER_RADIUS * self._instrument.wrist_radius_m
        wrist = wrist_in_tool(self._chain, np.zeros(len(self._chain.joint_names)))
        return float(np.linalg.norm(wrist.hinge_m))


def joints_of(chain: DHChain | None, joints: JointSample | None) -> Array | None:
    """The chain's joints, shape (n_joints,); None without one of both, or where the sample lacks a joint."""
    if chain is None or joints is None:
        return None
    try:
        return select_joints(chain, joints.names, joints.positions)
    except KinematicsError:
        return None


def wrist_in_tool(chain: DHChain, q: Array) -> Wrist:
    """The wrist in the tool frame at joints `q`, shape (n_joints,); raises KinematicsError for a chain without one.

    The tool turns with the moving jaw. A chain without a jaw's joint has its jaws closed.
    """
    rows = wrist_rows(chain)
    if rows is None:
        raise KinematicsError(
            "the chain has no wrist: nothing slides, or less than three joints turn behind it"
        )
    frames = frame_transforms(chain, q)
    T_base_tool = frames[-1] @ chain.T_last_tool
    shaft, _ = joint_axis(chain, frames, rows.roll)
    _, hinge_m = joint_axis(chain, frames, rows.pitch)
    pivot, _ = joint_axis(chain, frames, rows.yaw)
    jaw_axis, opening_rad = pivot, 0.0
    if rows.jaw is not None:
        jaw_axis, _ = joint_axis(chain, frames, rows.jaw)
        opening_rad = float(q[_joint_index(chain, rows.jaw)])
    along = T_base_tool[:3, :3] @ _straight_in_tool(chain, rows)
    wrist = Wrist(hinge_m, T_base_tool[:3, 3], shaft, pivot, _jaws(along, jaw_axis, opening_rad))
    return moved(wrist, inverse(T_base_tool))


def _straight_in_tool(chain: DHChain, rows: WristRows) -> Array:
    """The jaws' direction in the tool frame, shape (3,): the shaft's, with the wrist's joints at zero."""
    frames = frame_transforms(chain, np.zeros(len(chain.joint_names)))
    shaft, _ = joint_axis(chain, frames, rows.roll)
    return np.asarray((frames[-1] @ chain.T_last_tool)[:3, :3].T @ shaft)


def _joint_index(chain: DHChain, row: int) -> int:
    return sum(other.joint != "fixed" for other in chain.rows[:row])


def _jaws(along: Array, axis: Array, opening_rad: float) -> tuple[Jaw, ...]:
    """Moving and fixed jaw: turning by the opening about the unit `axis` takes the fixed one to the moving one."""
    fixed = _turned(along, axis, -opening_rad)
    return Jaw(along, np.cross(axis, along)), Jaw(fixed, -np.cross(axis, fixed))


def moved(wrist: Wrist, T_other_this: Array) -> Wrist:
    """The same wrist in another frame, by a transform of shape (4, 4)."""
    hinge_m, tool_m = transform_points(T_other_this, [wrist.hinge_m, wrist.tool_m])
    R = T_other_this[:3, :3]
    jaws = tuple(Jaw(R @ jaw.along, R @ jaw.outward) for jaw in wrist.jaws)
    return Wrist(hinge_m, tool_m, R @ wrist.shaft, R @ wrist.pivot, jaws)


def build_capsules(instrument: Instrument, wrist: Wrist) -> Capsules:
    """Shaft, collar, fork, knuckle and both jaws about a wrist, in its frame.

    Parts wider than thick are rods side by side; the shaft's flat end is a cap that stands half a radius before
    it, which is right within 0.06 radii at the rim.
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
        (tool, tool, knuckle_m),
    ]
    tine_m = knuckle_m + 0.0005
    for side in (-1.0, 1.0):
        offset = side * tine_m * wrist.pivot
        rods.append((hinge + 0.3 * (tool - hinge) + offset, tool + offset, 0.0005))
        bridge = side * max(tine_m - 0.42 * wrist_m, 0.0) * wrist.pivot
        rods.append((hinge + bridge, hinge + 0.3 * (tool - hinge) + bridge, 0.5 * wrist_m))
    for jaw in wrist.jaws:
        rods += _blade(instrument, tool, jaw)
    starts, ends, radii = zip(*rods, strict=True)
    return Capsules(np.array(starts), np.array(ends), np.array(radii))


def plate_capsules(fiducial: Fiducial) -> Capsules:
    """A tag's plate in the tag's frame, as rods side by side under its face at z = 0."""
    half_m = 0.5 * fiducial.plate_side_m - PLATE_RADIUS_M
    across_m = np.linspace(-half_m, half_m, PLATE_RODS)
    low = np.full(PLATE_RODS, -PLATE_RADIUS_M)
    starts, ends = (np.stack([np.full(PLATE_RODS, end_m), across_m, low], -1) for end_m in (-half_m, half_m))
    return Capsules(starts, ends, np.full(PLATE_RODS, PLATE_RADIUS_M))


def _blade(instrument: Instrument, tool: Array, jaw: Jaw) -> list[tuple[Array, Array, float]]:
    length_m, half_width_m = instrument.jaw_length_m, instrument.jaw_radius_m
    base = tool + BLADE_OFFSET * half_width_m * jaw.outward
    beside = np.cross(jaw.along, jaw.outward)
    rods = []
    for start, end, offset, radius in BLADE_RODS:
        radius_m = radius * half_width_m
        end_m = end * length_m - (radius_m if end == 1.0 else 0.0)
        axis = base + offset * half_width_m * beside
        rods.append((axis + start * length_m * jaw.along, axis + max(end_m, 0.0) * jaw.along, radius_m))
    return rods


def _turned(vector: Array, axis: Array, angle_rad: float) -> Array:
    """Rodrigues' rotation of a vector about a unit axis, shape (3,)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.asarray(c * vector + s * np.cross(axis, vector) + (1.0 - c) * (axis @ vector) * axis)

"""The instrument as capsules, posed by the tool and the wrist, and its shaft as a camera sees it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from svmdist import kinematics as dh
from svmdist.camera import Camera
from svmdist.errors import KinematicsError
from svmdist.geometry import Capsules, join
from svmdist.profile import Profile
from svmdist.profile.robot import Fiducial, Instrument
from svmdist.results import ToolEstimate, ToolPose
from svmdist.samples import JointSample
from svmdist.transforms import Array, cross, inverse
from svmdist.vision.lines import tangent_normal

# Shape facts of this model, as lengths over the radii that a profile gives: they say which capsules model which
# part, and have no meaning apart from one another. What differs between instruments is in the profile.
WRIST_LENGTH_PER_RADIUS = 3.4  # from the wrist's hinge to the tool, without a chain: 9.1 / 2.7
SHAFT_END_PER_RADIUS = 2.2  # the shaft begins this many radii of the wrist behind the hinge
SHAFT_CAP = 0.5  # from a flat end of the shaft to its capsule's, in radii: half of the cap is beyond it
TINE_RADIUS_M = 0.0005  # of the fork's capsules beside the distal marker, however large that is
FORK_BEGIN = 0.3  # where the fork's tines leave its bridges, over the way from the hinge to the tool
BLADE_CAPSULES = (
    (0.0, 0.62, 0.43, 0.50),
    (0.0, 0.62, -0.43, 0.50),
    (0.62, 0.85, 0.30, 0.38),
    (0.62, 0.85, -0.30, 0.38),
    (0.0, 1.0, 0.0, 0.25),
)
"""A tapering blade, wider than thick: where a capsule begins and ends over the jaw's length, how far beside the middle
it lies and how thick it is, both over the jaw's radius. The last one ends with its cap."""
PLATE_RADIUS_M, PLATE_CAPSULES = 0.0003, 7
"""Half of the thickness of a printed plate; capsules 1.4 mm apart model one of 9 mm."""
BLADE_OFFSET = 0.55  # of a blade's middle plane from the one where the jaws meet, in radii of the jaw
NEAR_M = 1e-3  # what is nearer to the camera has no image
FINE = 200  # points of the axis among which the visible ones are chosen
SECTIONS = 24  # of the visible shaft
HINGE = 1  # the capsule that starts at the wrist's hinge: see `capsules_about`


@dataclass(frozen=True, slots=True)
class Wrist:
    """The bent wrist: points `hinge_m` and `tool_m`, unit vectors along shaft and the jaws' axis, (3,)."""

    hinge_m: Array
    tool_m: Array
    shaft: Array
    pivot: Array
    jaws: Array  # unit vectors of each along it to its tip, away from the other jaw and across both, (2, 3, 3)


def wrist_in_tool(chain: dh.DHChain, q: Array, frames: Array | None = None) -> Wrist:
    """The wrist in the tool frame at joints `q`, shape (n_joints,); raises KinematicsError for a chain without one.

    The shaft turns about itself, the wrist about its hinge and the tool, and a jaw may open. `frames` are the poses of
    all rows' frames there, where they are known.
    """
    rows, frames = dh.rows_behind_insertion(chain), dh.frame_transforms(chain, q) if frames is None else frames
    if len(rows) < 3:
        raise KinematicsError("the chain has no wrist: nothing slides, or less than three joints turn behind it")
    T_base_tool = frames[-1] @ chain.T_last_tool
    R, tool_m = T_base_tool[:3, :3], T_base_tool[:3, 3]
    (shaft, _), (_, hinge_m), (pivot, _), *jaw = (dh.joint_axis(chain, frames, row) for row in rows)
    jaw_axis, opening_rad = pivot, 0.0
    if jaw:
        jaw_axis, opening_rad = jaw[0][0], float(q[np.searchsorted(chain.moving_rows, rows[3])])
    hinge_m, shaft, pivot, jaw_axis = np.stack([hinge_m - tool_m, shaft, pivot, jaw_axis]) @ R
    return Wrist(hinge_m, np.zeros(3), shaft, pivot, _jaws(_straight(chain)[0], jaw_axis, opening_rad))


@lru_cache(maxsize=16)
def _straight(chain: dh.DHChain) -> tuple[Array, float]:
    """Of a straight wrist, where jaws point in the tool frame, a unit vector, (3,), and how far off the hinge is in m.

    It is the same for every pose.
    """
    frames = dh.frame_transforms(chain, np.zeros(len(chain.joint_names)))
    (shaft, _), (_, hinge_m) = (dh.joint_axis(chain, frames, row) for row in dh.rows_behind_insertion(chain)[:2])
    T_base_tool = frames[-1] @ chain.T_last_tool
    return np.asarray(T_base_tool[:3, :3].T @ shaft), float(np.linalg.norm(T_base_tool[:3, 3] - hinge_m))


def joints_of(chain: dh.DHChain | None, joints: JointSample | None) -> Array | None:
    """The chain's joints, shape (n_joints,); None without one of both, or where the sample lacks a joint."""
    if chain is None or joints is None:
        return None
    try:
        return dh.select_joints(chain, joints.names, joints.positions)
    except KinematicsError:
        return None


def _jaws(along: Array, axis: Array, opening_rad: float) -> Array:
    """Moving and fixed jaw: turning by the opening about the unit `axis` takes the fixed one to the moving one."""
    c, s = np.cos(-opening_rad), np.sin(-opening_rad)  # Rodrigues' rotation about a unit axis
    fixed = np.asarray(c * along + s * cross(axis, along) + (1.0 - c) * (axis @ along) * axis)
    pairs = ((along, cross(axis, along)), (fixed, -cross(axis, fixed)))
    return np.array([(ahead, outward, cross(ahead, outward)) for ahead, outward in pairs])


@dataclass(frozen=True, slots=True)
class InstrumentModel:
    """Capsules of one instrument."""

    instrument: Instrument
    chain: dh.DHChain | None  # with a wrist
    fiducial: Fiducial | None

    @classmethod
    def of(cls, profile: Profile) -> InstrumentModel | None:
        """The profile's instrument; None where it has none."""
        if profile.instrument is None:
            return None
        chain = dh.chain_of(profile.robot) if profile.robot else None
        has_wrist = chain is not None and len(dh.rows_behind_insertion(chain)) >= 3
        return cls(profile.instrument, chain if has_wrist else None, profile.fiducial)

    def posed(self, tool: ToolEstimate) -> Capsules:
        """Capsules in the camera frame, bent by the joints where there are any, with the plate where it has one."""
        chain, pose, q = self.chain, tool.pose, joints_of(self.chain, tool.joints)
        if chain is None or q is None:
            return capsules_about(self.instrument, self._wrist_without_joints(pose), pose.jaw_scale)
        frames = dh.frame_transforms(chain, q)
        body = capsules_about(self.instrument, wrist_in_tool(chain, q, frames), pose.jaw_scale)
        if tool.has_plate and (tag := self.fiducial) is not None:
            T_tool_link = inverse(frames[-1] @ chain.T_last_tool) @ frames[dh.row_index(chain, tag.link)]
            body = join(body, plate_capsules(tag).transformed(T_tool_link @ tag.T_link_tag))
        return body.transformed(pose.T_camera_tool)

    def _wrist_without_joints(self, pose: ToolPose) -> Wrist:
        axis, chain = pose.axis, self.chain
        side = cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        pivot = side / np.linalg.norm(side)
        if chain is not None and pose.hinge is not None:
            hinge_m, jaws = pose.hinge.position_m, pose.T_camera_tool[:3, :3] @ _straight(chain)[0]
        else:
            length_m = _straight(chain)[1] if chain else WRIST_LENGTH_PER_RADIUS * self.instrument.wrist_radius_m
            hinge_m, jaws = pose.position_m - length_m * axis, axis
        return Wrist(hinge_m, pose.position_m, axis, pivot, _jaws(jaws, pivot, 0.0))


def capsules_about(instrument: Instrument, wrist: Wrist, jaw_scale: float = 1.0) -> Capsules:
    """The instrument's capsules about a wrist, in its frame, with jaws longer than the profile's by a factor."""
    shaft_m, wrist_m, marker_m = instrument.shaft_radius_m, instrument.wrist_radius_m, instrument.knuckle_radius_m
    hinge, tool, back = wrist.hinge_m, wrist.tool_m, -wrist.shaft
    end_m = SHAFT_END_PER_RADIUS * wrist_m
    far_m = max(instrument.shaft_length_m - SHAFT_CAP * shaft_m, end_m + SHAFT_CAP * shaft_m)
    capsules: list[tuple[Array, Array, float]] = [
        (hinge + (end_m + SHAFT_CAP * shaft_m) * back, hinge + far_m * back, shaft_m),
        (hinge, hinge + end_m * back, wrist_m),
        (tool, tool, marker_m),
    ]
    tine_m, fork = marker_m + TINE_RADIUS_M, hinge + FORK_BEGIN * (tool - hinge)
    for side in (-1.0, 1.0):
        offset = side * tine_m * wrist.pivot
        capsules.append((fork + offset, tool + offset, TINE_RADIUS_M))
        bridge = side * max(tine_m - 0.42 * wrist_m, 0.0) * wrist.pivot
        capsules.append((hinge + bridge, fork + bridge, 0.5 * wrist_m))
    half_width_m, length_m = instrument.jaw_radius_m, instrument.jaw_length_m
    for ahead, outward, beside in wrist.jaws:
        base, along = tool + BLADE_OFFSET * half_width_m * outward, jaw_scale * ahead
        for start, end, aside, radius in BLADE_CAPSULES:
            radius_m = radius * half_width_m
            to_m = max(end * length_m - (radius_m if end == 1.0 else 0.0), 0.0)
            axis = base + aside * half_width_m * beside
            capsules.append((axis + start * length_m * along, axis + to_m * along, radius_m))
    starts, ends, radii = zip(*capsules, strict=True)
    return Capsules(np.array(starts), np.array(ends), np.array(radii))


def plate_capsules(fiducial: Fiducial) -> Capsules:
    """A tag's plate in the tag's frame, as capsules side by side under its face at z = 0."""
    half_m = 0.5 * fiducial.plate_side_m - PLATE_RADIUS_M
    across_m = np.linspace(-half_m, half_m, PLATE_CAPSULES)
    low = np.full(PLATE_CAPSULES, -PLATE_RADIUS_M)
    starts, ends = (np.stack([np.full(PLATE_CAPSULES, end_m), across_m, low], -1) for end_m in (-half_m, half_m))
    return Capsules(starts, ends, np.full(PLATE_CAPSULES, PLATE_RADIUS_M))


@dataclass(frozen=True, slots=True)
class ShaftSections:
    """The visible shaft cut across in the image, from its end on: n cuts, evenly along it."""

    axis_m: Array  # points of the axis in the camera frame, (n, 3)
    middles_px: Array  # between both sides, (n, 2)
    across: Array  # unit vectors from one side to the other, (n, 2)
    half_px: Array  # from a middle to either side, (n,)
    length_px: float  # from first to last

    @property
    def outline_px(self) -> Array:
        """The outline, shape (2 n, 2): along one side away from the tip, and back along the other."""
        aside_px = self.half_px[:, None] * self.across
        return np.concatenate([self.middles_px - aside_px, (self.middles_px + aside_px)[::-1]])


def shaft_sections(camera: Camera, body: Capsules) -> ShaftSections | None:
    """The sections of an instrument's shaft, its first capsule, in the camera frame; None where it is not in view."""
    radius_m, far_m = float(body.radius_m[0]), body.end_m[0]
    along = (far_m - body.start_m[0]) / np.linalg.norm(far_m - body.start_m[0])
    # The capsule's round end models a flat one: see `capsules_about`.
    points_m = np.linspace(body.start_m[0] - SHAFT_CAP * radius_m * along, far_m, FINE)
    sides = [tangent_normal(points_m[0], along, radius_m, side)[0] for side in (-1, 1)]
    points_m = points_m[points_m[:, 2] > radius_m + NEAR_M]
    if len(points_m) < 2 or not np.isfinite(sides).all():
        return None
    both_px = np.stack([camera.project(points_m - radius_m * side) for side in sides])
    last_px = [camera.width_px - 1, camera.height_px - 1]
    visible = np.asarray(((both_px >= 0.0) & (both_px <= last_px)).all(-1).any(0))
    if np.count_nonzero(visible) < 2:
        return None
    visible[1:] |= visible[:-1].copy()  # one more: the outline reaches the picture's border
    middles_px = both_px.mean(0)
    way_px = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(middles_px[visible], axis=0), axis=1)))
    chosen = np.flatnonzero(visible)[np.searchsorted(way_px, np.linspace(0.0, way_px[-1], SECTIONS))]
    across_px = both_px[1, chosen] - both_px[0, chosen]
    width_px = np.linalg.norm(across_px, axis=1)
    across = across_px / width_px[:, None]
    return ShaftSections(points_m[chosen], middles_px[chosen], across, 0.5 * width_px, float(way_px[-1]))

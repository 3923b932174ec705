"""The references that estimates are held against: simulator's truth, kinematics, transforms or poses of the log."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial

import numpy as np

from svmdist.errors import KinematicsError, RecordingError, UsageError
from svmdist.estimation import plane_mapping as paper
from svmdist.estimation.plane_mapping import Equations
from svmdist.kinematics import forward_kinematics, select_joints
from svmdist.profile import Profile
from svmdist.recording.log import Recording
from svmdist.recording.messages import Kind, kind_of
from svmdist.recording.source import sanitize_list
from svmdist.recording.topics import Role
from svmdist.tracks import MAX_GAP_NS, LagEstimate, Sampled
from svmdist.transforms import Array, Stamps, frame_name

KINEMATICS_PRINTED_NOTE = (
    "eq. (28) as printed is the zero matrix, which makes (31) zero everywhere: the identity stands in for it;"
    " eq. (30) as printed is a reflection; eqs. (33), (34) as printed divide metres by 100 and are 10^4 too small"
)
MAX_CLOCK_STAMPS = 500  # so many moments show on which of two clocks the truth is


class Reference(StrEnum):
    """What counts as the truth, the strongest first."""

    GROUND_TRUTH = "ground_truth"  # svmdist's own truth, from the simulator
    TF = "tf"  # a pair of transforms of the log, as a tracking system publishes them
    SURFACE = "surface"  # the tool by transforms or poses, the tissue by the surface that both views show
    PLANE = "plane"  # the same, with the tissue where each image shows it on the profile's plane
    POSE = "pose"  # a pose topic for the tool, as CRTK's measured_cp
    KINEMATICS = "kinematics"  # DH kinematics of the log's joint states: eqs. (31)–(35), as in the paper


BY_POSES = (Reference.SURFACE, Reference.PLANE)
"""References whose tissue is seen in the images: their distances are those of given poses."""
PoseAt = Callable[[Stamps], Sampled]  # stamps, shape (n,), to poses, shape (n, 4, 4), and which of them are known


@dataclass(frozen=True, slots=True)
class TruthRules:
    """Which references to use (None: all of the log), and the frames (parent, child) of tool and tissue."""

    references: tuple[Reference, ...] | None = None
    tool_frames: tuple[str, str] | None = None
    tissue_frames: tuple[str, str] | None = None
    max_gap_ns: int = MAX_GAP_NS

    @property
    def wanted(self) -> tuple[Reference, ...]:
        """The references to try."""
        if self.references is not None:
            return self.references
        if self.tool_frames is not None:
            return (Reference.TF, Reference.KINEMATICS)
        return (Reference.GROUND_TRUTH, Reference.KINEMATICS)

    def of(self, log: Recording) -> tuple[Reference, ...]:
        """Those to try on a log: without ground truth in it, and any named, also its poses."""
        named = self.references or self.tool_frames
        has_truth = log.topic_of(Role.GROUND_TRUTH_DISTANCE) or log.topic_of(Role.GROUND_TRUTH_TF)
        return self.wanted if named or has_truth else (*self.wanted, Reference.POSE)


ANY_TRUTH = TruthRules()


def no_truth(log: Recording, references: Sequence[Reference], rules: TruthRules) -> str:
    """Why a log has none of some references, by its topics alone; empty where it may have one."""
    made_of = {
        Reference.GROUND_TRUTH: Kind.DISTANCE,
        Reference.TF: Kind.TRANSFORMS,
        Reference.POSE: Kind.POSE,
        Reference.KINEMATICS: Kind.JOINTS,
        **dict.fromkeys(BY_POSES, Kind.TRANSFORMS if rules.tool_frames else Kind.POSE),
    }
    topics = log.topics()
    if {made_of[one] for one in references} & {kind_of(one) for one in topics}:
        return ""
    lacking = ", ".join(f"no {made_of[one]} ({one})" for one in references)
    listed = sanitize_list(one.topic for one in topics)
    return f"{log.name}: there is no truth to compare with: {lacking}; the topics are {listed}"


def truth_rules(
    pairs: tuple[str, ...], profile: Profile, references: tuple[Reference, ...] | None, max_gap_ns: int = MAX_GAP_NS
) -> TruthRules:
    """Make rules from `parent:child` texts: the tissue is the child of that name in the profile, or the second one."""
    if len(pairs) > 2:
        raise UsageError(f"--truth-tf names the tool and the tissue: two at most, found {len(pairs)}")
    frames = []
    for text in pairs:
        parent, _, child = text.partition(":")
        if not (parent and child) or ":" in child:
            raise UsageError(f"--truth-tf {text}: expected PARENT:CHILD, as in camera:tool")
        frames.append((frame_name(parent), frame_name(child)))
    second = frames[1] if len(frames) == 2 else None
    tissue = next((pair for pair in frames if pair[1] == profile.frames.tissue), second)
    return TruthRules(references, next((pair for pair in frames if pair is not tissue), None), tissue, max_gap_ns)


@dataclass(frozen=True)
class Truth:
    """What holds at n stamps: planar, spatial distance and clearance in m, (n, 3), and `T_camera_tool`, (n, 4, 4).

    NaN is an unknown value; None: no poses are known.
    """

    distances_m: Array
    T_camera_tool: Array | None = None


def truth_at(
    recording: Recording, reference: Reference, stamps_ns: Stamps, equations: Equations, rules: TruthRules
) -> Truth:
    """What a reference says at stamps, or of the tool alone; RecordingError or KinematicsError where a log lacks it."""
    unknown_m = np.full(len(stamps_ns), np.nan)
    if reference is Reference.KINEMATICS and equations == "printed":
        # eqs. (33)–(35) as published, on the tool in the base frame, which the identity for (28) leaves. The
        # translation of the last row is zero, so that (30)'s reflection leaves the position as it is.
        in_base = _kinematic_poses(recording, rules.max_gap_ns)(stamps_ns)
        displacement_cm = paper.displacement_cm_as_published(in_base.values[:, :3, 3])
        planar_m = paper.planar_distance(displacement_cm) / 100.0
        return Truth(np.stack([planar_m, unknown_m, unknown_m], -1))
    has_truth = recording.topic_of(Role.GROUND_TRUTH_TF) is not None
    if reference is Reference.GROUND_TRUTH:
        tool = tool_track(recording, reference, rules)(stamps_ns).values if has_truth else None
        return Truth(recording.distance_track().at(stamps_ns, rules.max_gap_ns).values, tool)
    tool = tool_track(recording, reference, rules)(stamps_ns).values
    if not (rules.tissue_frames or has_truth):
        return Truth(np.stack([unknown_m] * 3, -1), tool)
    frames = recording.profile.frames
    pair = rules.tissue_frames or (frames.camera, frames.tissue)
    tissue = recording.transform_track(*pair, ground_truth=rules.tissue_frames is None)
    tool_m, tissue_m = tool[:, :3, 3], tissue.at(stamps_ns, rules.max_gap_ns).values[:, :3, 3]
    planar_m = paper.planar_distance(paper.displacement_cm_corrected(tool_m, tissue_m)) / 100.0
    return Truth(np.stack([planar_m, np.linalg.norm(tissue_m - tool_m, axis=-1), unknown_m], -1), tool)


def tool_track(log: Recording, reference: Reference, rules: TruthRules) -> PoseAt:
    """`T_camera_tool` by a reference; raises RecordingError or KinematicsError where the log has no such one."""
    frames, gap_ns = log.profile.frames, rules.max_gap_ns
    if reference in BY_POSES:
        reference = Reference.TF if rules.tool_frames else Reference.POSE
    if reference in (Reference.GROUND_TRUTH, Reference.TF):
        is_truth = reference is Reference.GROUND_TRUTH
        pair = (not is_truth and rules.tool_frames) or (frames.camera, frames.tool)
        return partial(log.transform_track(*pair, ground_truth=is_truth).at, max_gap_ns=gap_ns)
    if reference is Reference.KINEMATICS:
        return in_camera(log, frames.base, _kinematic_poses(log, gap_ns), gap_ns)
    poses = log.pose_track()
    return in_camera(log, poses.parent, partial(poses.at, max_gap_ns=gap_ns), gap_ns)


def in_camera(log: Recording, frame: str, in_frame: PoseAt, max_gap_ns: int = MAX_GAP_NS) -> PoseAt:
    """Poses of a frame ("": the camera's) in the camera frame; RecordingError where the log does not link the two."""
    camera = log.profile.frames.camera
    if frame in ("", "camera", camera) or frame == log.logged_camera.frame_id:
        return in_frame
    nominal = log.transform_track(camera, frame)

    def at(stamps_ns: Stamps) -> Sampled:
        T_camera_frame, T_frame_tool = nominal.at(stamps_ns, max_gap_ns), in_frame(stamps_ns)
        return Sampled(T_camera_frame.values @ T_frame_tool.values, T_camera_frame.valid & T_frame_tool.valid)

    return at


def _kinematic_poses(recording: Recording, max_gap_ns: int) -> PoseAt:
    """`T_base_tool` by DH kinematics of the measured joints, eq. (31)."""
    chain, joints = recording.chain, recording.joint_track()
    select_joints(chain, joints.names, joints.positions[:1])  # says at once which joints are missing

    def at(stamps_ns: Stamps) -> Sampled:
        q = joints.at(stamps_ns, max_gap_ns)
        selected = select_joints(chain, joints.names, q.values)
        # Joints that cannot be are no reference.
        valid = q.valid & chain.are_within_limits(selected).all(axis=-1)
        return Sampled(np.where(valid[:, None, None], forward_kinematics(chain, selected), np.nan), valid)

    return at


def reference_lag_ns(recording: Recording, reference: Reference, lag: LagEstimate | None) -> int:
    """Time offset from a reference's stamps to the images': the lag, or 0 where the reference has the images' clock.

    Of ground truth, the true tool is compared with the nominal one under either clock; the error of kinematics
    is mostly a constant. Where they cannot be separated it is the robot's: images are what is late.
    """
    lag_ns = lag.lag_ns if lag else 0
    if lag_ns == 0 or reference is not Reference.GROUND_TRUTH:
        return lag_ns
    recording, frames = replace(recording, lag=lag), recording.profile.frames
    try:
        nominal = tool_track(recording, Reference.KINEMATICS, ANY_TRUTH)
        true = recording.transform_track(frames.camera, frames.tool, ground_truth=True)
    except (RecordingError, KinematicsError):
        return lag_ns
    # Nominal joints are on the images' clock here: of truth on the robot's clock, they are late by the lag.
    stamps_ns = true.stamps_ns[:: max(1, len(true.stamps_ns) // MAX_CLOCK_STAMPS)]
    moments = [nominal(stamps_ns + late_ns) for late_ns in (0, lag_ns)]
    known = moments[0].valid & moments[1].valid
    if not known.any():
        return lag_ns
    expected = true.at(stamps_ns[known]).values[:, :3, 3]
    with_images, with_robot = (np.var(found.values[known, :3, 3] - expected, axis=0).mean() for found in moments)
    return 0 if with_images < with_robot else lag_ns

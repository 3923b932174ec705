"""What a robot reports of its tool at the stamps of images: by its joints or its poses, with their errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import KinematicsError, RecordingError
from svmdist.estimation.instrument.error_model import ErrorModel
from svmdist.kinematics.dh import DHChain, chain_of, shaft_of
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile import Profile
from svmdist.recording.log import Recording
from svmdist.results import Failure
from svmdist.samples import JointSample
from svmdist.tracks import JointTrack
from svmdist.transforms import Array, skew

Against = Literal["kinematics", "pose"]
NEAR_NS = 200_000_000
"""Joints within this of an image tell their rates."""


@dataclass(frozen=True)
class ReportedTool:
    """What the robot reports at stamps: poses in the base's frame (n, 4, 4), which are known, and their errors.

    `axes` (n, 3) are the shaft's directions, NaN where not known; `noise` (n, 3, 3) what differs from frame to frame;
    `shared` (n, 6, m) what errors of all frames do to place and direction, of the constants `names`.
    """

    T_base_tool: Array
    valid: NDArray[np.bool_]
    axes: Array
    noise: Array
    shared: Array
    names: tuple[str, ...] = ()


def default_reference(recording: Recording, profile: Profile) -> Against:
    """The joints where log and profile have them, else the poses; raises RecordingError where the log lacks both."""
    if profile.robot is not None and recording.topic_of("joints") is not None:
        names = recording.joint_track().names
        there = set(names)
        if all(
            there & {joint.name, *joint.aliases} for joint in profile.robot.joints if joint.type != "fixed"
        ):
            return "kinematics"
    if recording.topic_of("pose") is not None:
        return "pose"
    raise RecordingError(
        f"{recording.path.name}: no joint states of profile {profile.name}'s chain and no poses of"
        f" {profile.instrument_name}: hand-eye needs the one or the other"
    )


def reported_tool(
    recording: Recording, profile: Profile, against: Against, stamps_ns: NDArray[np.int64]
) -> ReportedTool:
    """What the robot reports, by its joints or its poses; RecordingError where the log lacks them."""
    if against == "pose":
        poses = recording.pose_track().at(stamps_ns)
        count = len(stamps_ns)
        noise = profile.settings.hand_eye.pose_std_m**2 * np.eye(3)
        return ReportedTool(
            poses.values,
            poses.valid,
            np.full((count, 3), np.nan),
            np.repeat(noise[None], count, 0),
            np.zeros((count, 6, 0)),
        )
    return _by_joints(recording, profile, stamps_ns)


def _by_joints(recording: Recording, profile: Profile, stamps_ns: NDArray[np.int64]) -> ReportedTool:
    """Forward kinematics with the deviations that the profile states: play differs, all else is shared."""
    if profile.robot is None:
        raise RecordingError(f"profile {profile.name} has no [robot]: kinematics need its chain")
    chain = chain_of(profile.robot)
    model = ErrorModel(chain, profile.kinematic_error)
    shaft, joints = shaft_of(chain), recording.joint_track()
    names, shared_columns = tuple(model.constant_columns), list(model.constant_columns.values())
    poses, axes, noise, shared = [], [], [], []
    sampled = joints.at(stamps_ns)
    for stamp_ns, positions, valid in zip(stamps_ns, sampled.values, sampled.valid, strict=True):
        state = _state(chain, joints, int(stamp_ns), positions) if valid else None
        if state is None:
            poses.append(np.full((4, 4), np.nan))
            axes.append(np.full(3, np.nan))
            noise.append(np.zeros((3, 3)))
            shared.append(np.zeros((6, len(shared_columns))))
            continue
        links = model.links(model.nominal(state), model.no_correction(), model.anchor_m(state))
        tool = links.link(None)
        std = np.sqrt(np.diag(model.prior(state)))[shared_columns]
        play = tool.derivative[:3] @ model.play_covariance @ tool.derivative[:3].T
        axis, turned = np.full(3, np.nan), np.zeros((3, len(shared_columns)))
        if shaft is not None:
            link = links.link(shaft.link)
            axis = link.T_camera_link[:3, :3] @ shaft.axis
            turned = -skew(axis) @ link.derivative[3:][:, shared_columns]
        poses.append(tool.T_camera_link)
        axes.append(axis)
        noise.append(play)
        shared.append(np.vstack([tool.derivative[:3][:, shared_columns], turned]) * std)
    return ReportedTool(
        np.reshape(poses, (-1, 4, 4)),
        np.asarray(sampled.valid),
        np.reshape(axes, (-1, 3)),
        np.reshape(noise, (-1, 3, 3)),
        np.reshape(shared, (-1, 6, len(shared_columns))),
        names,
    )


def _state(chain: DHChain, joints: JointTrack, stamp_ns: int, positions: Array) -> RobotState:
    """The robot with its base at the camera: what follows is in the base's frame."""
    near = np.abs(joints.stamps_ns - stamp_ns) <= NEAR_NS
    track = JointTrack(joints.stamps_ns[near], joints.names, joints.positions[near]) if near.any() else None
    sample = JointSample(stamp_ns, joints.names, positions)
    state = RobotState.of(chain, sample, np.eye(4), stamp_ns, track)
    if isinstance(state, Failure):
        raise KinematicsError(state.reason)
    return state

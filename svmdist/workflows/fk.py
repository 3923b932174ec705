"""Forward kinematics of a log: the tool's pose for each joint state, and its error against a pose topic."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import RecordingError
from svmdist.kinematics.chain import chain_of
from svmdist.kinematics.dh import MANY, forward_kinematics, select_joints
from svmdist.profile import Profile
from svmdist.recording.reader import Recording
from svmdist.recording.reading import Window
from svmdist.tracks import MAX_GAP_NS, JointTrack, PoseTrack
from svmdist.transforms import Array, inverse, rotation_angle
from svmdist.workflows.progress import Progress, Steps

BLOCK = 1 << 14


@dataclass(frozen=True)
class PoseErrors:
    """Kinematics against a pose topic: position error, shape (n,) in m, and angle, shape (n,) in rad.

    `frame_id` is the frame of the topic's poses. Where it is not the chain's base, a constant offset
    between the frames is part of the error.
    """

    stamps_ns: NDArray[np.int64]
    position_m: Array
    angle_rad: Array
    frame_id: str
    unpaired_count: int


@dataclass(frozen=True)
class ForwardKinematics:
    """Poses of the tool, (n, 4, 4) in the base's frame or the camera's, at the stamps of the joint states.

    `errors` are those against a pose topic, in the base's frame; None where the log has none.
    """

    stamps_ns: NDArray[np.int64]
    poses: Array
    errors: PoseErrors | None


def fk(
    recording: Recording,
    profile: Profile,
    max_gap_ns: int = MAX_GAP_NS,
    *,
    in_camera: bool = False,
    window: Window | None = None,
    on_progress: Progress | None = None,
) -> ForwardKinematics:
    """Compute the tool's pose for every joint state of a recording, or those in a window, by the profile's chain.

    With `in_camera` in the camera's frame, by the transform of a hand-eye file or of the log; joint states without a
    transform at their stamp are left out. `on_progress` is told of joint states as they are read. Raises
    RecordingError where there are no joint states, no transform, or the profile has no chain, and KinematicsError where
    the chain's joints are not in them.
    """
    if profile.robot is None:
        raise RecordingError(f"profile {profile.name} has no [robot]: kinematics need its chain")
    chain = chain_of(profile.robot)
    topic = recording.topic_of("joints")
    count = next((info.message_count for info in recording.topics() if info.topic == topic), None)
    joints = recording.joint_track(Steps(on_progress, count).advance)
    if window is not None:
        inside = window.places(joints.stamps_ns)
        if len(inside) == 0:
            raise RecordingError(f"{recording.path.name}: no joint state is between --start and --end")
        joints = JointTrack(joints.stamps_ns[inside], joints.names, joints.positions[inside])
    T_base_tool = np.empty((len(joints.stamps_ns), 4, 4))
    # In blocks: the joints in the chain's order, and what is computed of them, would be as large again.
    for block in _blocks(len(T_base_tool)):
        q = select_joints(chain, joints.names, joints.positions[block])
        T_base_tool[block] = forward_kinematics(chain, q)
    errors = None
    if recording.topic_of("pose") is not None:
        errors = _errors(joints.stamps_ns, T_base_tool, recording.pose_track(), max_gap_ns)
    if not in_camera:
        return ForwardKinematics(joints.stamps_ns, T_base_tool, errors)
    frames = profile.frames
    base = recording.transform_track(frames.camera, frames.base).at(joints.stamps_ns, max_gap_ns)
    poses = base.values[base.valid] @ T_base_tool[base.valid]
    return ForwardKinematics(joints.stamps_ns[base.valid], poses, errors)


def _blocks(count: int) -> Iterator[slice]:
    """Parts of so many rows, none of which is short unless all of it is: short ones are computed in another way."""
    starts = range(0, max(count - MANY, 1), BLOCK)
    yield from (slice(at, at + BLOCK) for at in starts[:-1])
    yield slice(starts[-1], count)


def _errors(
    stamps_ns: NDArray[np.int64], T_base_tool: Array, poses: PoseTrack, max_gap_ns: int
) -> PoseErrors:
    measured = poses.at(stamps_ns, max_gap_ns)
    valid = measured.valid
    difference = inverse(T_base_tool[valid]) @ measured.values[valid]
    return PoseErrors(
        stamps_ns[valid],
        np.linalg.norm(difference[:, :3, 3], axis=-1),
        rotation_angle(difference[:, :3, :3], np.eye(3)),
        poses.frame_id,
        int(np.count_nonzero(~valid)),
    )

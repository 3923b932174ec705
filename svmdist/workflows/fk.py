"""Forward kinematics of a log: the tool's pose for each joint state, and its error against a pose topic."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from svmdist.errors import RecordingError
from svmdist.kinematics import forward_kinematics, select_joints
from svmdist.recording.log import Recording
from svmdist.transforms import Array, Stamps, inverse, rotation_angle

BLOCK = 1 << 14


def fk_blocks(recording: Recording, *, in_camera: bool = False) -> Generator[tuple[Stamps, Array, Array]]:
    """Yield the tool's pose for every joint state in a recording's window, by the profile's chain, in blocks.

    Each has some thousand stamps of joint states, (n,), the poses, (n, 4, 4), in the base's frame, and the errors of
    all its joint states against the log's pose topic, (m, 2): position in m and angle in rad, NaN without a pose, with
    a constant offset where its frame is not the chain's base. With `in_camera`, poses are in the camera's frame, by the
    transform of a hand-eye file or of the log; joint states without one at their stamp are left out.

    Raises, before the first block, RecordingError without joint states, transform or chain, and KinematicsError where
    the chain's joints are not in the log.
    """
    chain, frames = recording.chain, recording.profile.frames
    joints = recording.joint_track()
    inside = recording.window.places(joints.stamps_ns)
    if len(inside) == 0:
        raise RecordingError(f"{recording.path.name}: no joint state is between --start and --end")
    poses = recording.pose_track() if recording.topic_of("pose") is not None else None
    base = recording.transform_track(frames.camera, frames.base) if in_camera else None
    for start in range(0, len(inside), BLOCK):
        places = inside[start : start + BLOCK]
        at_ns = joints.stamps_ns[places]
        T = forward_kinematics(chain, select_joints(chain, joints.names, joints.positions[places]))
        errors = np.full((len(T), 2), np.nan)
        if poses is not None:
            measured = poses.at(at_ns)
            difference = inverse(T[measured.valid]) @ measured.values[measured.valid]
            errors[measured.valid, 0] = np.linalg.norm(difference[:, :3, 3], axis=-1)
            errors[measured.valid, 1] = rotation_angle(difference[:, :3, :3], np.eye(3))
        if base is not None:
            T_camera_base = base.at(at_ns)
            at_ns, T = at_ns[T_camera_base.valid], (T_camera_base.values @ T)[T_camera_base.valid]
        yield at_ns, T, errors

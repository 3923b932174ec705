"""Forward kinematics of a log: the tool's pose for each joint state, and its error against a pose topic."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import RecordingError
from svmdist.kinematics.dh import DHChain, chain_of, forward_kinematics, select_joints
from svmdist.profile import Profile
from svmdist.recording.log import Recording, Window
from svmdist.tracks import MAX_GAP_NS, PoseTrack
from svmdist.transforms import Array, inverse, rotation_angle
from svmdist.workflows.parallel import Progress, Steps
from svmdist.workflows.stamped_rows import BLOCK, StampedRows


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


@dataclass(frozen=True)
class PoseBlock:
    """Some thousand poses of a log, one block after the other; `errors` are those of the block.

    `joint_count` is the number of joint states of all blocks.
    """

    stamps_ns: NDArray[np.int64]
    poses: Array
    errors: PoseErrors | None
    joint_count: int


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
    made = fk_blocks(
        recording, profile, max_gap_ns, in_camera=in_camera, window=window, on_progress=on_progress
    )
    with closing(made):
        blocks = list(made)
    errors = [block.errors for block in blocks if block.errors is not None]
    return ForwardKinematics(
        np.concatenate([block.stamps_ns for block in blocks]),
        np.concatenate([block.poses for block in blocks]),
        joined(errors) if errors else None,
    )


def joined(errors: Sequence[PoseErrors]) -> PoseErrors:
    """The errors of several blocks as one."""
    return PoseErrors(
        np.concatenate([one.stamps_ns for one in errors]),
        np.concatenate([one.position_m for one in errors]),
        np.concatenate([one.angle_rad for one in errors]),
        errors[0].frame_id,
        sum(one.unpaired_count for one in errors),
    )


def fk_blocks(
    recording: Recording,
    profile: Profile,
    max_gap_ns: int = MAX_GAP_NS,
    *,
    in_camera: bool = False,
    window: Window | None = None,
    on_progress: Progress | None = None,
) -> Generator[PoseBlock]:
    """Yield the same as `fk` block by block. Joint states and poses wait in temporary files, not in memory.

    What `fk` raises is raised before the first block.
    """
    if profile.robot is None:
        raise RecordingError(f"profile {profile.name} has no [robot]: kinematics need its chain")
    chain = chain_of(profile.robot)
    with ExitStack() as stack:
        joints = _joints(recording, chain, window, on_progress, stack)
        poses = _poses(recording, stack) if recording.topic_of("pose") is not None else None
        base = recording.transform_track(profile.frames.camera, profile.frames.base) if in_camera else None
        for block in _blocks(len(joints)):
            stamps_ns, q = joints.read(block.start, block.stop)
            T_base_tool = forward_kinematics(chain, q)
            errors = None if poses is None else _errors(stamps_ns, T_base_tool, *poses, max_gap_ns)
            if base is None:
                yield PoseBlock(stamps_ns, T_base_tool, errors, len(joints))
                continue
            at = base.at(stamps_ns, max_gap_ns)
            poses_in_camera = at.values[at.valid] @ T_base_tool[at.valid]
            yield PoseBlock(stamps_ns[at.valid], poses_in_camera, errors, len(joints))


def _joints(
    recording: Recording,
    chain: DHChain,
    window: Window | None,
    on_progress: Progress | None,
    stack: ExitStack,
) -> StampedRows:
    """The positions of a log's joints, in the chain's order, by stamp: all of them, or those in a window."""
    topic = recording.topic_of("joints")
    count = next((info.message_count for info in recording.topics() if info.topic == topic), None)
    rows: StampedRows | None = None
    order = np.zeros(0, np.intp)
    for sample in recording.joint_samples(Steps(on_progress, count).advance):
        if rows is None:
            places = np.arange(len(sample.names), dtype=np.float64)
            order = select_joints(chain, sample.names, places).astype(np.intp)
            rows = stack.enter_context(StampedRows(len(order)))
        rows.add(sample.stamp_ns, np.asarray(sample.positions, np.float64)[order])
    if rows is None:
        raise recording.no_joints()
    repeated = rows.finish()
    if repeated:
        recording.record_repeated_joints(repeated)
    return rows if window is None else _inside(recording, rows, window, len(order), stack)


def _inside(
    recording: Recording, rows: StampedRows, window: Window, width: int, stack: ExitStack
) -> StampedRows:
    """Those of the rows whose stamps are in a window; RecordingError where none is."""
    chosen = stack.enter_context(StampedRows(width))
    starts = range(0, len(rows), BLOCK)
    inside = window.places(np.concatenate([rows.read(at, at + BLOCK)[0] for at in starts]))
    if len(inside) == 0:
        raise RecordingError(f"{recording.path.name}: no joint state is between --start and --end")
    for at in starts:
        stamps_ns, values = rows.read(at, at + BLOCK)
        for place in inside[np.searchsorted(inside, at) : np.searchsorted(inside, at + BLOCK)] - at:
            chosen.add(int(stamps_ns[place]), values[place])
    chosen.finish()
    return chosen


def _poses(recording: Recording, stack: ExitStack) -> tuple[str, StampedRows]:
    """The frame of a log's poses, and the poses by stamp."""
    rows = stack.enter_context(StampedRows(16))
    frames: set[str] = set()
    for sample in recording.pose_samples():
        frames.add(sample.frame_id)
        rows.add(sample.stamp_ns, sample.T_frame_pose.reshape(16))
    if len(frames) != 1:
        raise recording.other_frames(sorted(frames))
    rows.finish()
    return frames.pop(), rows


def _blocks(count: int) -> Iterator[slice]:
    """Parts of so many rows."""
    yield from (slice(at, at + BLOCK) for at in range(0, count, BLOCK))


def _errors(
    stamps_ns: NDArray[np.int64], T_base_tool: Array, frame_id: str, poses: StampedRows, max_gap_ns: int
) -> PoseErrors:
    found_ns, rows = poses.around(int(stamps_ns[0]), int(stamps_ns[-1]))
    measured = PoseTrack(frame_id, found_ns, rows.reshape(-1, 4, 4)).at(stamps_ns, max_gap_ns)
    valid = measured.valid
    difference = inverse(T_base_tool[valid]) @ measured.values[valid]
    return PoseErrors(
        stamps_ns[valid],
        np.linalg.norm(difference[:, :3, 3], axis=-1),
        rotation_angle(difference[:, :3, :3], np.eye(3)),
        frame_id,
        int(np.count_nonzero(~valid)),
    )

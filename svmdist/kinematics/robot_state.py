"""What the robot reports at one instant, and what follows from it: the poses of its links, computed once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from svmdist.errors import KinematicsError
from svmdist.kinematics import DHChain, frame_transforms, row_index, select_joints
from svmdist.results import Failure
from svmdist.samples import JointSample
from svmdist.tracks import JointTrack
from svmdist.transforms import Array

NO_JOINTS = Failure("no joints near the image")
NO_CAMERA = Failure("no transform from the camera to the base near the image")


@dataclass(frozen=True, eq=False)
class RobotState:
    """Joints of a chain at a stamp, and the camera's pose: the nominal (uncorrected) kinematics of one frame.

    `q`, shape (n_joints,), is in the chain's order, in rad or m. Without `T_camera_base`, shape (4, 4), everything in
    the base frame is there, and what needs the camera raises ValueError. `track` holds the joints around the stamp,
    in the chain's order, where the log has them: `q` is their value `time_offset_s` after the stamp.
    """

    chain: DHChain
    stamp_ns: int
    q: Array
    T_camera_base: Array | None = None
    track: JointTrack | None = None
    time_offset_s: float = 0.0

    @classmethod
    def of(
        cls,
        chain: DHChain,
        joints: JointSample | None,
        T_camera_base: Array | None,
        stamp_ns: int,
        track: JointTrack | None = None,
    ) -> RobotState | Failure:
        """The state by a sample's joints, or why there is none; the camera's transform may be missing."""
        if joints is None:
            return NO_JOINTS
        if track is None or track.names != joints.names:
            track = JointTrack(np.zeros(0, np.int64), joints.names, np.zeros((0, len(joints.names))))
        try:
            selected = select_joints(chain, joints.names, np.vstack([joints.positions, track.positions]))
        except KinematicsError as problem:
            return Failure(str(problem))
        within = chain.are_within_limits(selected)
        if not within[0].all():
            return _limit_failure(chain, selected[0], int(np.argmin(within[0])))
        usable = within[1:].all(axis=1)  # one stray sample beside the image does no harm
        around = JointTrack(track.stamps_ns[usable], chain.joint_names, selected[1:][usable])
        return cls(chain, stamp_ns, selected[0], T_camera_base, around if usable.any() else None)

    def shifted(self, time_offset_s: float) -> RobotState:
        """The state with the joints at a time offset; extrapolated at their rate, unchanged without a track."""
        if self.track is None or time_offset_s == self.time_offset_s:
            return self
        q = self.track.near(self.stamp_ns + round(1e9 * time_offset_s))
        return RobotState(self.chain, self.stamp_ns, q, self.T_camera_base, self.track, time_offset_s)

    @cached_property
    def rates(self) -> Array:
        """Derivatives of the joints by time, shape (n_joints,), in rad/s or m/s; zero without a track."""
        if self.track is None:
            return np.zeros(len(self.q))
        return self.track.rate_near(self.stamp_ns + round(1e9 * self.time_offset_s))

    @cached_property
    def frames(self) -> Array:
        """Poses of all row frames in the base frame, shape (n_rows, 4, 4), not to be written to."""
        frames = frame_transforms(self.chain, self.q)
        frames.setflags(write=False)
        return frames

    @cached_property
    def frames_in_camera(self) -> Array:
        """Poses of all row frames in the camera frame, shape (n_rows, 4, 4)."""
        return np.asarray(self.base_in_camera @ self.frames)

    @cached_property
    def T_base_tool(self) -> Array:
        """Pose of the tool in the base frame, shape (4, 4)."""
        return np.asarray(self.frames[-1] @ self.chain.T_last_tool)

    @property
    def T_camera_tool(self) -> Array:
        """Pose of the tool in the camera frame, shape (4, 4): own methods read it."""
        return np.asarray(self.base_in_camera @ self.T_base_tool)

    def T_base_link(self, link: str | None) -> Array:
        """Pose of the frame of the DH row `link` in the base frame, shape (4, 4); of the tool for None."""
        return self.T_base_tool if link is None else np.asarray(self.frames[row_index(self.chain, link)])

    def T_camera_link(self, link: str | None) -> Array:
        """Pose of the frame of the DH row `link` in the camera frame, shape (4, 4); of the tool for None."""
        return np.asarray(self.base_in_camera @ self.T_base_link(link))

    @property
    def base_in_camera(self) -> Array:
        """`T_camera_base`, shape (4, 4); raises ValueError without it."""
        if self.T_camera_base is None:
            raise ValueError(NO_CAMERA.reason)
        return self.T_camera_base


def _limit_failure(chain: DHChain, q: Array, joint: int) -> Failure:
    unit = "rad" if chain.is_revolute[joint] else "m"
    lower, upper = chain.lower[joint], chain.upper[joint]
    limits = f"its limits {lower:.4g} to {upper:.4g} {unit} and the tolerance {chain.limit_tolerance[joint]:.4g} {unit}"
    return Failure(f"joint {chain.joint_names[joint]} is at {q[joint]:.6g} {unit}, outside {limits}")

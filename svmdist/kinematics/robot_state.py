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
    """Joints of a chain at a stamp, and the camera's pose: the nominal (uncorrected) kinematics of one frame."""

    chain: DHChain
    stamp_ns: int
    q: Array  # in the chain's order, in rad or m, shape (n_joints,)
    T_camera_base: Array | None = None  # (4, 4); without it, what needs the camera raises ValueError
    track: JointTrack | None = None  # the joints around the stamp, in the chain's order, where the log has them
    time_offset_s: float = 0.0  # `q` is the track's value so long after the stamp

    @staticmethod
    def of(
        chain: DHChain,
        joints: JointSample | None,
        T_camera_base: Array | None,
        stamp_ns: int,
        track: JointTrack | None = None,
    ) -> RobotState | Failure:
        """The state by a sample's joints, or why there is none; the camera's transform may be missing."""
        if joints is None:
            return NO_JOINTS
        try:
            q = select_joints(chain, joints.names, joints.positions)
        except KinematicsError as problem:
            return Failure(str(problem))
        within = chain.are_within_limits(q)
        if not within.all():
            joint = int(np.argmin(within))
            unit, tolerance = "rad" if chain.is_revolute[joint] else "m", chain.limit_tolerance[joint]
            limits = f"its limits {chain.lower[joint]:.4g} to {chain.upper[joint]:.4g} {unit}"
            found = f"joint {chain.joint_names[joint]} is at {q[joint]:.6g} {unit}"
            return Failure(f"{found}, outside {limits} and the tolerance {tolerance:.4g} {unit}")
        around = None
        if track is not None and track.names == joints.names:
            selected = select_joints(chain, track.names, track.positions)
            usable = chain.are_within_limits(selected).all(axis=1)  # one stray sample beside the image does no harm
            if usable.any():
                around = JointTrack(track.stamps_ns[usable], chain.joint_names, selected[usable])
        return RobotState(chain, stamp_ns, q, T_camera_base, around)

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

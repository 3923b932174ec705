"""What is wrong with believed kinematics, as a state: a rigid correction and joint offsets, and the links under it.

    p_link = a + δp + exp([δφ]) (p_link,believed(q + δq) - a),   R_link = exp([δφ]) R_link,believed(q + δq)

with an anchor a, the tool's first believed place. The nominal state is the correction; the error state is small
and flat, and moved into the correction (Solà 2017, "Quaternion kinematics for the error-state Kalman filter",
sec. 6). Joints that hold still err like a wrong base, so their errors are lumped into the camera-to-base
transform's (Richter et al. 2021). `docs/method.md` derives both and what can be observed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.errors import KinematicsError, did_you_mean
from svmdist.kinematics.dh import DHChain, frame_transforms
from svmdist.kinematics.jacobian import jacobian_of_frames, row_index
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile import KinematicError
from svmdist.transforms import Array, make_transform, rotation_of, rotation_vector, skew


@dataclass(frozen=True, slots=True)
class CorrectedLink:
    """The corrected pose of a link, shape (4, 4), and the derivative of its (δp, δθ) by the error state, (6, n)."""

    T_camera_link: Array
    derivative: Array


@dataclass(frozen=True, slots=True)
class Correction:
    """What is added to believed kinematics: a shift in m, a turn, shape (3, 3), and joint offsets."""

    shift_m: Array
    turn: Array
    q_offset: Array

    def retracted(self, step: Array) -> Correction:
        """The correction after an error state, shape (n,), was found in it."""
        turn = rotation_of(step[3:6]) @ self.turn
        return Correction(self.shift_m + step[:3], turn, self.q_offset + step[6:])

    def vector(self) -> Array:
        """Shift, rotation vector and offsets, shape (n,)."""
        return np.concatenate([self.shift_m, rotation_vector(self.turn), self.q_offset])


class ErrorModel:
    """The error state (δp, δφ, δq) of a chain: its prior and drift, and what it does to the links.

    δp in m and δφ in rad are displacement and rotation vector of everything behind the set-up joints, in the camera
    frame about the anchor; δq are the offsets of the joints that move.
    """

    def __init__(self, chain: DHChain, error: KinematicError) -> None:
        self._chain = chain
        self._error = error
        names = chain.joint_names
        if error.first_moving_joint is not None and error.first_moving_joint not in names:
            raise KinematicsError(
                f"no joint {error.first_moving_joint} to be the first moving one:"
                f" {did_you_mean(error.first_moving_joint, names)}"
            )
        self._still_count = names.index(error.first_moving_joint) if error.first_moving_joint else 0
        is_revolute = np.array([row.joint == "revolute" for row in chain.rows if row.joint != "fixed"])
        moving = is_revolute[self._still_count :]
        self._joint_std = np.where(moving, error.joint_std_rad, error.joint_std_m)
        drift = np.where(moving, error.drift_rad_per_sqrt_s, error.drift_m_per_sqrt_s)
        self.drift = np.concatenate(
            [np.full(3, error.drift_m_per_sqrt_s), np.full(3, error.drift_rad_per_sqrt_s), drift]
        )
        self.size = 6 + len(moving)

    def no_correction(self) -> Correction:
        """What is there before anything was seen."""
        return Correction(np.zeros(3), np.eye(3), np.zeros(self.size - 6))

    def anchor_m(self, robot: RobotState) -> Array:
        """The tool's believed place, shape (3,) in the camera frame."""
        return np.asarray(robot.T_camera_tool[:3, 3])

    def prior(self, robot: RobotState) -> Array:
        """Covariance of the error state that the profile states, shape (n, n).

        A wrong transform may turn about either of its ends, the base or the camera: the shift at the anchor
        has the bias_jacobian of the worse one, and no correlation with the turn, which would choose between them.
        """
        turn_var = self._error.camera_base_std_rad**2
        arm = skew(self.anchor_m(robot) - robot.base_in_camera[:3, 3])
        P = np.zeros((self.size, self.size))
        P[:3, :3] = self._error.camera_base_std_m**2 * np.eye(3) + turn_var * arm @ arm.T
        P[3:6, 3:6] = turn_var * np.eye(3)
        P[6:, 6:] = np.diag(self._joint_std**2)
        return P

    def joints(self, robot: RobotState, correction: Correction) -> Array:
        """Believed joints with the offsets, shape (n_joints,)."""
        q = robot.q.copy()
        q[self._still_count :] += correction.q_offset
        return q

    def links(
        self,
        names: Iterable[str | None],
        robot_states: Sequence[RobotState],
        correction: Correction,
        anchor_m: Array,
    ) -> dict[str | None, list[CorrectedLink]]:
        """Links under a correction, by name (None: the tool), one for each robot."""
        q = np.stack([self.joints(robot, correction) for robot in robot_states])
        T_camera_base = np.stack([robot.base_in_camera for robot in robot_states])
        frames = frame_transforms(self._chain, q)
        turned = correction.turn @ T_camera_base[:, :3, :3]
        links = {}
        for name in names:
            last = (
                frames[:, -1] @ self._chain.T_last_tool
                if name is None
                else frames[:, row_index(self._chain, name)]
            )
            T_believed = T_camera_base @ last
            lever_m = (T_believed[:, :3, 3] - anchor_m) @ correction.turn.T
            T = make_transform(
                correction.turn @ T_believed[:, :3, :3], anchor_m + correction.shift_m + lever_m
            )
            derivative = np.zeros((len(robot_states), 6, self.size))
            derivative[:, :, :6] = np.eye(6)
            derivative[:, :3, 3:6] = -skew(lever_m)
            J = jacobian_of_frames(self._chain, frames, name)[..., self._still_count :]
            derivative[:, :3, 6:], derivative[:, 3:, 6:] = turned @ J[:, :3], turned @ J[:, 3:]
            links[name] = [
                CorrectedLink(pose, by_state) for pose, by_state in zip(T, derivative, strict=True)
            ]
        return links

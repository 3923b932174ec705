"""The error of nominal kinematics as a state: a rigid correction and joint offsets.

    p_link = a + δp + exp([δφ]) (p_link,nominal(q + δq) - a),   R_link = exp([δφ]) R_link,nominal(q + δq)

with an anchor a, the tool's first nominal position. The nominal state is the correction; the error state is small
and flat, and retracted into the correction (Solà 2017, "Quaternion kinematics for the error-state Kalman filter",
sec. 6). Joints that hold still err like a wrong base, so their errors are lumped into the camera-to-base
transform's (Richter et al. 2021). `docs/method.md` derives both and what can be observed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.errors import KinematicsError, did_you_mean
from svmdist.estimation.filter.corrected_links import CorrectedLinks, MovingJoints, NominalFrames
from svmdist.kinematics.dh import DHChain
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile import KinematicError
from svmdist.transforms import Array, rotation_of, rotation_vector, skew


@dataclass(frozen=True, slots=True)
class Correction:
    """What is added to nominal kinematics: a shift in m, a turn, shape (3, 3), and joint offsets."""

    shift_m: Array
    turn: Array
    q_offset: Array

    def retract(self, step: Array) -> Correction:
        """The correction after an error state, shape (n,), was found in it (box-plus)."""
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
        self.chain = chain
        self._error = error
        names = chain.joint_names
        if error.first_moving_joint is not None and error.first_moving_joint not in names:
            raise KinematicsError(
                f"no joint {error.first_moving_joint} to be the first moving one:"
                f" {did_you_mean(error.first_moving_joint, names)}"
            )
        first = names.index(error.first_moving_joint) if error.first_moving_joint else 0
        self._joints = MovingJoints.of(chain, first)
        turns, slides = self._joints.turns, self._joints.slides
        self._joint_std = error.joint_std_rad * turns + error.joint_std_m * slides
        length, angle = error.drift_m_per_sqrt_s, error.drift_rad_per_sqrt_s
        self.drift = np.concatenate([[length] * 3, [angle] * 3, angle * turns + length * slides])
        self.size = 6 + len(turns)

    def no_correction(self) -> Correction:
        """What is there before anything was measured."""
        return Correction(np.zeros(3), np.eye(3), np.zeros(self.size - 6))

    def anchor_m(self, robot: RobotState) -> Array:
        """The tool's nominal position, shape (3,) in the camera frame."""
        return np.asarray(robot.T_camera_tool[:3, 3])

    def prior(self, robot: RobotState) -> Array:
        """Covariance of the error state that the profile states, shape (n, n).

        A wrong transform may turn about either of its ends, the base or the camera: the shift at the anchor
        has the variance of the worse one, and no correlation with the turn, which would choose between them.
        """
        turn_var = self._error.camera_base_std_rad**2
        arm = skew(self.anchor_m(robot) - robot.base_in_camera[:3, 3])
        P = np.zeros((self.size, self.size))
        P[:3, :3] = self._error.camera_base_std_m**2 * np.eye(3) + turn_var * arm @ arm.T
        P[3:6, 3:6] = turn_var * np.eye(3)
        P[6:, 6:] = np.diag(self._joint_std**2)
        return P

    def joints(self, robot: RobotState, correction: Correction) -> Array:
        """Reported joints with the offsets, shape (n_joints,)."""
        q = robot.q.copy()
        q[self._joints.first_joint :] += correction.q_offset
        return q

    def nominal(self, robot: RobotState) -> NominalFrames:
        """What of a robot's state no correction changes."""
        return NominalFrames.of(robot, self._joints.first_row)

    def nominal_of_many(self, robots: Sequence[RobotState]) -> NominalFrames:
        """The same of several states, stacked."""
        return NominalFrames.stack([self.nominal(robot) for robot in robots])

    def links(self, nominal: NominalFrames, correction: Correction, anchor_m: Array) -> CorrectedLinks:
        """All links under a correction."""
        return CorrectedLinks(
            self._joints, nominal, correction.shift_m, correction.turn, correction.q_offset, anchor_m
        )

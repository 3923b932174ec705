"""How wrong nominal kinematics may be: prior, drift and what the error state does to the links."""

from __future__ import annotations

import numpy as np

from svmdist.errors import KinematicsError, did_you_mean
from svmdist.estimation.instrument.corrected_links import (
    CorrectedLinks,
    Correction,
    MovingJoints,
)
from svmdist.kinematics import DHChain, shaft_of
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.hand_eye import HandEyeError
from svmdist.profile.robot import KinematicError
from svmdist.results import ToolPose
from svmdist.transforms import Array, skew


class ErrorModel:
    """The error state (δp, δφ, δq, play, τ, δl) of a chain: its prior, how it changes, and what it does to the links.

    δp in m and δφ in rad are displacement and rotation vector of everything behind the set-up joints, in the camera
    frame about the anchor; δq are the offsets of the joints that move, `play` what of their errors changes with the
    motion (backlash, cables, noise), τ how late the joints' stamps are, δl the errors of lengths.
    """

    def __init__(self, chain: DHChain, error: KinematicError) -> None:
        self.chain = chain
        self.error = error
        names = chain.joint_names
        if error.first_moving_joint is not None and error.first_moving_joint not in names:
            raise KinematicsError(
                f"no joint {error.first_moving_joint} to be the first moving one:"
                f" {did_you_mean(error.first_moving_joint, names)}"
            )
        self.joints = MovingJoints(chain, names.index(error.first_moving_joint or names[0]))
        turns, slides = self.joints.turns, self.joints.slides
        self._joint_std = error.joint_std_rad * turns + error.joint_std_m * slides
        self._play_std = error.play_std_rad * turns + error.play_std_m * slides
        self.size = self.joints.size
        self.constant_columns = self.joints.constant_columns
        self._drift = np.zeros(self.size)
        self._drift[:3], self._drift[3:6] = error.drift_m_per_sqrt_s, error.drift_rad_per_sqrt_s
        self._drift[self.joints.offsets] = self._drift[3] * turns + self._drift[0] * slides
        self._drift[self.joints.time_offset] = error.time_offset_drift_s_per_sqrt_s

    def time_offset_std_s(self, age_s: float) -> float:
        """Standard deviation of the joints' time offset after a time, by what the profile states."""
        drift_s = self._drift[self.joints.time_offset] * np.sqrt(age_s)
        return float(np.hypot(self.error.time_offset_std_s, drift_s))

    def no_correction(self) -> Correction:
        """What is there before anything was measured."""
        return Correction(np.zeros(self.size), np.eye(3))

    @property
    def play_covariance(self) -> Array:
        """Of joint errors that change with the motion, at any instant, shape (n, n)."""
        P = np.zeros((self.size, self.size))
        P[self.joints.play, self.joints.play] = np.diag(self._play_std**2)
        return P

    def propagation(self, elapsed_s: float) -> tuple[Array, Array]:
        """Factors and added variance (n,) over a time: play is a Gauss–Markov process, all else a random walk."""
        keep = np.ones(self.size)
        keep[self.joints.play] = np.exp(-elapsed_s / self.error.play_time_s)
        added = self._drift**2 * elapsed_s
        added[self.joints.play] = self._play_std**2 * (1.0 - keep[self.joints.play] ** 2)
        return keep, added

    def anchor_m(self, robot: RobotState) -> Array:
        """The tool's nominal position, shape (3,) in the camera frame."""
        return np.asarray(robot.T_camera_link(None)[:3, 3])

    def prior(self, robot: RobotState) -> Array:
        """Covariance of the error state that the profile states, shape (n, n).

        A wrong transform may turn about either of its ends, the base or the camera: the shift at the anchor
        has the variance of the worse one, and no correlation with the turn, which would choose between them. A
        transform by hand-eye has a covariance of its own.
        """
        P = np.zeros((self.size, self.size))
        P[:6, :6] = self._transform_covariance(robot)
        at = self.joints
        P[at.offsets, at.offsets] = np.diag(self._joint_std**2)
        P[at.time_offset, at.time_offset] = self.error.time_offset_std_s**2
        P[at.lengths, at.lengths] = self.error.length_std_m**2 * np.eye(len(at.row_lengths))
        # What a transform by hand-eye owes to the offset of a joint is not to be counted beside that offset.
        for name, effect in self._hand_eye_effects(robot).items():
            if (column := self.constant_columns.get(name)) is not None:
                P[:6, column] = P[column, :6] = effect[:, 0] * np.sqrt(P[column, column])
        return P + self.play_covariance

    def prior_with_constants(self, robot: RobotState) -> dict[str, Array]:
        """Covariance, shape (n, k), of the error state with constants of variance one that are no part of it."""
        effects, below = self._hand_eye_effects(robot), ((0, self.size - 6), (0, 0))
        own = self.constant_columns
        return {name: np.pad(effect, below) for name, effect in effects.items() if name not in own}

    def _hand_eye_effects(self, robot: RobotState) -> dict[str, Array]:
        if isinstance(self.error, HandEyeError):
            return self.error.hand_eye.effects_at(self.anchor_m(robot))
        return {}

    def _transform_covariance(self, robot: RobotState) -> Array:
        if isinstance(self.error, HandEyeError):
            return self.error.hand_eye.covariance_at(self.anchor_m(robot))
        turn_var = self.error.camera_base_std_rad**2
        arm = skew(self.anchor_m(robot) - robot.base_in_camera[:3, 3])
        P = np.zeros((6, 6))
        P[:3, :3] = self.error.camera_base_std_m**2 * np.eye(3) + turn_var * arm @ arm.T
        P[3:, 3:] = turn_var * np.eye(3)
        return P

    def links(self, robot: RobotState, correction: Correction, anchor_m: Array) -> CorrectedLinks:
        """All links under a correction."""
        return CorrectedLinks(self.joints, robot, correction, anchor_m)


def nominal_tool(chain: DHChain, error: KinematicError, state: RobotState) -> ToolPose:
    """The tool's nominal pose in the camera frame and its covariance, as the profile states the errors.

    It is what the filter starts from, so that a method that filters and one that does not state the same. The
    covariance is of first order in the errors, and leaves out that turns shorten a lever: 2 degrees about two axes
    pull the tool 1.7 mm towards a base 1.4 m away, beside 68 mm of error.
    """
    model = ErrorModel(chain, error)
    links = model.links(state, model.no_correction(), model.anchor_m(state))
    tool, shaft = links.link(None), shaft_of(chain)
    axis = tool.T_camera_link[:3, 0]
    if shaft is not None:
        axis = links.link(shaft.link).T_camera_link[:3, :3] @ shaft.axis
    covariance = tool.derivative @ model.prior(state) @ tool.derivative.T
    return ToolPose(tool.T_camera_link, covariance, np.asarray(axis))

"""How wrong nominal kinematics may be: the error state, its prior and drift, and the links under a correction by it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from svmdist.errors import KinematicsError, did_you_mean
from svmdist.kinematics import DHChain, link_transforms, row_index, running_product, shaft_of
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.hand_eye import LENGTH, OFFSET, TIME_OFFSET, HandEyeError
from svmdist.profile.robot import KinematicError
from svmdist.results import ToolPose
from svmdist.transforms import Array, cross, make_transform, rotation_of, skew


class ErrorModel:
    """The error state (δp, δφ, δq, backlash, τ, δl) of a chain: its layout, its prior, and how it changes.

    δp in m and δφ in rad are displacement and rotation vector of everything behind the set-up joints, in the camera
    frame about the anchor; δq are the offsets of the joints from `first_joint` on, `backlash` what of their errors
    changes with the motion (and cables, noise), τ how late the joints' stamps are, δl the errors of `row_lengths`.
    `offsets`, `backlash`, `time_offset` and `lengths` are their indices among its `size` numbers.
    """

    def __init__(self, chain: DHChain, error: KinematicError) -> None:
        self.chain, self.error, names = chain, error, chain.joint_names
        first = names[0] if error.first_moving_joint is None else error.first_moving_joint
        if first not in names:
            raise KinematicsError(f"no joint {first} to be the first moving one: {did_you_mean(first, names)}")
        self.first_joint = names.index(first)
        rows = chain.moving_rows[self.first_joint :]
        self.first_row, count = int(rows[0]), len(rows)
        # Which frames have the joints' axes, among those from the row before `first_row` on.
        self.axes = rows - rows[0] + (chain.convention == "modified")
        # 1 for joints of that type from the first one on, 0 for others.
        self.turns: Array = chain.is_revolute[self.first_joint :].astype(np.float64)
        self.slides: Array = 1.0 - self.turns
        self.row_lengths = tuple(_lengths(chain, self.first_row))
        self.offsets, self.backlash = slice(6, 6 + count), slice(6 + count, 6 + 2 * count)
        self.time_offset = 6 + 2 * count
        self.size = self.time_offset + 1 + len(self.row_lengths)
        self.lengths = slice(self.time_offset + 1, self.size)
        self._backlash_std = error.play_std_rad * self.turns + error.play_std_m * self.slides
        self._drift = np.zeros(self.size)
        self._drift[:3], self._drift[3:6] = error.drift_m_per_sqrt_s, error.drift_rad_per_sqrt_s
        self._drift[self.offsets] = self._drift[3] * self.turns + self._drift[0] * self.slides
        self._drift[self.time_offset] = error.time_offset_drift_s_per_sqrt_s

    @property
    def parameter_columns(self) -> dict[str, int]:
        """Where in the error state each calibration parameter stands, by its name."""
        names = self.chain.joint_names[self.first_joint :]
        found = {OFFSET.format(name): at for at, name in enumerate(names, self.offsets.start)}
        found |= {LENGTH.format(number): self.time_offset + number for number in range(1, len(self.row_lengths) + 1)}
        return found | {TIME_OFFSET: self.time_offset}

    def time_offset_std_s(self, age_s: float) -> float:
        """Standard deviation of the joints' time offset after a time, by the profile."""
        return float(np.hypot(self.error.time_offset_std_s, self._drift[self.time_offset] * np.sqrt(age_s)))

    @property
    def backlash_covariance(self) -> Array:
        """Of joint errors that change with the motion, at any instant, shape (n, n)."""
        P = np.zeros((self.size, self.size))
        P[self.backlash, self.backlash] = np.diag(self._backlash_std**2)
        return P

    def propagation(self, elapsed_s: float) -> tuple[Array, Array]:
        """Factors and added variance (n,) over a time: backlash is a Gauss–Markov process, all else a random walk."""
        keep = np.ones(self.size)
        keep[self.backlash] = np.exp(-elapsed_s / self.error.play_time_s)
        added = self._drift**2 * elapsed_s
        added[self.backlash] = self._backlash_std**2 * (1.0 - keep[self.backlash] ** 2)
        return keep, added

    def prior(self, robot: RobotState) -> Array:
        """Covariance of the error state by the profile, shape (n, n).

        A wrong transform may turn about either of its ends, the base or the camera: the shift at the anchor
        has the variance of the worse one, and no correlation with the turn, which would choose between them. A
        transform by hand-eye has a covariance of its own.
        """
        P, error = np.zeros((self.size, self.size)), self.error
        P[:6, :6], effects = self._transform(robot)
        joint_std = error.joint_std_rad * self.turns + error.joint_std_m * self.slides
        P[self.offsets, self.offsets] = np.diag(joint_std**2)
        P[self.time_offset, self.time_offset] = error.time_offset_std_s**2
        P[self.lengths, self.lengths] = error.length_std_m**2 * np.eye(len(self.row_lengths))
        # What a transform by hand-eye owes to the offset of a joint is not to be counted beside that offset.
        columns = self.parameter_columns
        for name in effects.keys() & columns:
            column = columns[name]
            P[:6, column] = P[column, :6] = effects[name][:, 0] * np.sqrt(P[column, column])
        return P + self.backlash_covariance

    def prior_cross_covariances(self, robot: RobotState) -> dict[str, Array]:
        """Prior cross-covariances, (n, k), of the error state with parameters, of variance one, that are not in it."""
        _, effects = self._transform(robot)
        own, below = self.parameter_columns, ((0, self.size - 6), (0, 0))
        return {name: np.pad(effect, below) for name, effect in effects.items() if name not in own}

    def _transform(self, robot: RobotState) -> tuple[Array, dict[str, Array]]:
        """Covariance (6, 6) of (δp, δφ), and parameters' effects on a transform by hand-eye, (6, k), by their names."""
        anchor_m = robot.T_camera_tool[:3, 3]
        if isinstance(self.error, HandEyeError):
            hand_eye = self.error.hand_eye
            return hand_eye.covariance_at(anchor_m), hand_eye.effects_at(anchor_m)
        turn_var = self.error.camera_base_std_rad**2
        arm = skew(anchor_m - robot.base_in_camera[:3, 3])
        P = np.zeros((6, 6))
        P[:3, :3] = self.error.camera_base_std_m**2 * np.eye(3) + turn_var * arm @ arm.T
        P[3:, 3:] = turn_var * np.eye(3)
        return P, {}

    def corrected_joints(self, robot: RobotState, correction: Correction) -> Array:
        """Reported joints at the corrected time, with offsets and backlash, shape (n_joints,)."""
        q, moving, x = robot.q.copy(), slice(self.first_joint, None), correction.x
        late_s = x[self.time_offset] - robot.time_offset_s
        q[moving] += robot.rates[moving] * late_s + x[self.offsets] + x[self.backlash]
        return q

    def no_correction(self, robot: RobotState) -> Correction:
        """What is there before anything was measured."""
        return Correction(np.zeros(self.size), np.eye(3), robot.T_camera_tool[:3, 3])

    def nominal_links(self, robot: RobotState) -> CorrectedLinks:
        """All links by nominal kinematics."""
        return CorrectedLinks(self, robot, self.no_correction(robot))


def _lengths(chain: DHChain, first_row: int) -> Iterator[tuple[int, int, int]]:
    """Lengths behind the first moving joint that no joint's offset could stand in for: (row, axis_row, column)."""
    # Such a length shifts all frames from a row on along an axis, a column of a row's frame.
    is_modified = chain.convention == "modified"
    for index, row in list(enumerate(chain.rows))[first_row + is_modified :]:
        # Standard: Rot_z(θ) Trans_z(d) Trans_x(a) Rot_x(α); modified: Rot_x(α) Trans_x(a) Rot_z(θ) Trans_z(d).
        if row.a_m != 0.0:
            yield index, index - 1 if is_modified else index, 0
        if row.d_m != 0.0 and row.type != "prismatic" and (is_modified or index > first_row):
            yield index, index if is_modified else index - 1, 2


@dataclass(frozen=True, slots=True)
class Correction:
    """What is added to nominal kinematics."""

    x: Array  # the error state, (n,), but for its turn: turns do not add up as the rest does, so x[3:6] is not used
    turn: Array  # (3, 3)
    anchor_m: Array  # that it turns about, (3,) in the camera frame

    def retract(self, step: Array) -> Correction:
        """The correction after an error state, shape (n,), was found in it (box-plus)."""
        return replace(self, x=self.x + step, turn=rotation_of(step[3:6]) @ self.turn)


@dataclass(frozen=True, slots=True)
class CorrectedLink:
    """A link's corrected pose, (4, 4), the derivative of its (δp, δθ) by the error state, (6, n), and by time, (6,)."""

    T_camera_link: Array
    derivative: Array
    velocity: Array


class CorrectedLinks:
    """All links of a robot under one correction; frames and the twists of the error state are computed once.

    A twist (v, w) moves a point p of a body by v + w x p: each component of the error state is one in the camera
    frame (Murray, Li, Sastry 1994, sec. 3.4), so that one matrix serves all links behind a joint.
    """

    def __init__(self, model: ErrorModel, robot: RobotState, correction: Correction) -> None:
        self._model, self._robot, self.correction = model, robot, correction
        pivot_m = correction.anchor_m + correction.x[:3]
        self._correct = make_transform(correction.turn, pivot_m - correction.turn @ correction.anchor_m)

        # Frames from the one before the first joint with an offset on.
        first_row = model.first_row
        before = robot.frames_in_camera[first_row - 1] if first_row else robot.base_in_camera
        links = link_transforms(model.chain, model.corrected_joints(robot, correction))[first_row:]
        self._frames = running_product(np.concatenate([(self._correct @ before)[None], links]))
        self._twists = np.zeros((6, model.size))
        for at, (row, axis_row, column) in enumerate(model.row_lengths, model.lengths.start):
            # A shift along an axis turns nothing, so that the frames behind it are shifted alike.
            axis = self._frames[axis_row - first_row + 1, :3, column].copy()
            self._frames[row - first_row + 1 :, :3, 3] += axis * correction.x[at]
            self._twists[:3, at] = axis

        self._twists[:, :6] = np.eye(6)
        self._twists[:3, 3:6] = skew(pivot_m)
        z, at_m = self._frames[model.axes, :3, 2], self._frames[model.axes, :3, 3]
        self._twists[:3, model.offsets] = model.turns * cross(at_m, z).T + model.slides * z.T
        self._twists[3:, model.offsets] = model.turns * z.T
        self._links: dict[str | None, CorrectedLink] = {}

    def link(self, name: str | None) -> CorrectedLink:
        """The frame of a DH row, or the tool for None; raises ValueError for a row that the chain lacks."""
        if (known := self._links.get(name)) is not None:
            return known
        model = self._model
        row = len(model.chain.rows) - 1 if name is None else row_index(model.chain, name)
        if row < model.first_row:
            T = self._correct @ self._robot.frames_in_camera[row]
        else:
            T = self._frames[row - model.first_row + 1]
        if name is None:
            T = T @ model.chain.T_last_tool
        derivative = self._twists.copy()
        derivative[:3] -= skew(T[:3, 3]) @ self._twists[3:]
        # Joints behind a link do not move it, nor do lengths.
        moved_by = int(np.searchsorted(model.chain.moving_rows, row, side="right"))
        derivative[:, 6 + max(0, moved_by - model.first_joint) : model.offsets.stop] = 0.0
        derivative[:, model.backlash] = derivative[:, model.offsets]
        # Later stamps: every joint goes on at its rate.
        derivative[:, model.time_offset] = derivative[:, model.offsets] @ self._robot.rates[model.first_joint :]
        derivative[:, model.lengths][:, [row < shifted for shifted, *_ in model.row_lengths]] = 0.0
        T.setflags(write=False)
        derivative.setflags(write=False)
        found = self._links[name] = CorrectedLink(T, derivative, derivative[:, model.time_offset])
        return found


def nominal_tool(chain: DHChain, error: KinematicError, state: RobotState) -> ToolPose:
    """The tool's nominal pose in the camera frame and its covariance, by the profile's prior of the errors.

    It is what the filter starts from, so that a method that filters and one that does not report the same. The
    covariance is of first order in the errors, and leaves out that turns shorten a lever: 2 degrees about two axes
    pull the tool 1.7 mm towards a base 1.4 m away, beside 68 mm of error.
    """
    model = ErrorModel(chain, error)
    links = model.nominal_links(state)
    tool, shaft = links.link(None), shaft_of(chain)
    axis = tool.T_camera_link[:3, 0]
    if shaft is not None:
        axis = links.link(shaft.link).T_camera_link[:3, :3] @ shaft.axis
    covariance = tool.derivative @ model.prior(state) @ tool.derivative.T
    return ToolPose(tool.T_camera_link, covariance, np.asarray(axis))

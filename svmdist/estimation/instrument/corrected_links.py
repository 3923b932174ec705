"""Links under a correction of nominal kinematics: their poses, and how they answer to the error state."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from svmdist.kinematics import DHChain, link_transforms, row_index, running_product
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.hand_eye import LENGTH, OFFSET, TIME_OFFSET
from svmdist.transforms import Array, cross, make_transform, rotation_of, rotation_vector, skew


@dataclass(frozen=True, slots=True)
class RowLength:
    """A constant length of the chain that may be wrong: it shifts all frames from `row` on along an axis of a frame.

    The axis is column `column` of the frame of row `axis_row`, which is one before `row` or `row` itself.
    """

    row: int
    axis_row: int
    column: int


class MovingJoints:
    """The joints of a chain from `first_joint` on, whose offsets are corrected; their rows begin at `first_row`.

    `axes` are the places of the frames with their axes among those from the row before `first_row` on; `turns` and
    `slides`, shape (n_joints - first_joint,), are 1 for joints of that type and 0 for others. `offsets`, `play`,
    `time_offset` and `lengths` are where these stand in the error state (δp, δφ, δq, play, τ, δl), of `size` numbers.
    """

    def __init__(self, chain: DHChain, first_joint: int) -> None:
        self.chain, self.first_joint = chain, first_joint
        rows, count = chain.moving_rows[first_joint:], len(chain.moving_rows) - first_joint
        self.first_row = int(rows[0])
        self.axes = rows - rows[0] + (chain.convention == "modified")
        self.turns: Array = chain.is_revolute[first_joint:].astype(np.float64)
        self.slides: Array = 1.0 - self.turns
        self.row_lengths = tuple(_lengths(chain, self.first_row))
        self.offsets, self.play = slice(6, 6 + count), slice(6 + count, 6 + 2 * count)
        self.time_offset = 6 + 2 * count
        self.size = self.time_offset + 1 + len(self.row_lengths)
        self.lengths = slice(self.time_offset + 1, self.size)

    @property
    def constant_columns(self) -> dict[str, int]:
        """Where in the error state each constant stands, by its name."""
        names = self.chain.joint_names[self.first_joint :]
        found = {OFFSET.format(name): at for at, name in enumerate(names, self.offsets.start)}
        lengths = enumerate(range(self.size)[self.lengths], 1)
        found |= {LENGTH.format(number): at for number, at in lengths}
        return found | {TIME_OFFSET: self.time_offset}

    def corrected(self, robot: RobotState, correction: Correction) -> Array:
        """Reported joints at the corrected time, with offsets and play, shape (n_joints,)."""
        q, moving, x = robot.q.copy(), slice(self.first_joint, None), correction.x
        late_s = x[self.time_offset] - robot.time_offset_s
        q[moving] += robot.rates[moving] * late_s + x[self.offsets] + x[self.play]
        return q


def _lengths(chain: DHChain, first_row: int) -> Iterator[RowLength]:
    """Lengths behind the first moving joint that no joint's offset could stand in for."""
    is_modified = chain.convention == "modified"
    for index, row in enumerate(chain.rows):
        if index < first_row or (is_modified and index == first_row):
            continue
        # Standard: Rot_z(θ) Trans_z(d) Trans_x(a) Rot_x(α); modified: Rot_x(α) Trans_x(a) Rot_z(θ) Trans_z(d).
        if row.a_m != 0.0:
            yield RowLength(index, index - 1 if is_modified else index, 0)
        if row.d_m != 0.0 and row.type != "prismatic" and (is_modified or index > first_row):
            yield RowLength(index, index if is_modified else index - 1, 2)


@dataclass(frozen=True, slots=True)
class Correction:
    """What is added to nominal kinematics: the error state `x`, shape (n,), but for its turn, shape (3, 3).

    Turns do not add up as the rest does, so that x[3:6] is not used.
    """

    x: Array
    turn: Array

    def retract(self, step: Array) -> Correction:
        """The correction after an error state, shape (n,), was found in it (box-plus)."""
        return Correction(self.x + step, rotation_of(step[3:6]) @ self.turn)

    def vector(self) -> Array:
        """All of it as an error state about no correction, shape (n,)."""
        return np.concatenate([self.x[:3], rotation_vector(self.turn), self.x[6:]])


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

    def __init__(
        self, joints: MovingJoints, robot: RobotState, correction: Correction, anchor_m: Array
    ) -> None:
        self._joints, self._robot = joints, robot
        pivot_m = anchor_m + correction.x[:3]
        self._correct = make_transform(correction.turn, pivot_m - correction.turn @ anchor_m)

        # Frames from the one before the first joint with an offset on.
        first_row = joints.first_row
        before = robot.frames_in_camera[first_row - 1] if first_row else robot.base_in_camera
        links = link_transforms(joints.chain, joints.corrected(robot, correction))[first_row:]
        self._frames = running_product(np.concatenate([(self._correct @ before)[None], links]))
        self._twists = np.zeros((6, joints.size))
        for at, length in enumerate(joints.row_lengths, joints.lengths.start):
            # A shift along an axis turns nothing, so that the frames behind it are shifted alike.
            axis = self._frames[length.axis_row - first_row + 1, :3, length.column].copy()
            self._frames[length.row - first_row + 1 :, :3, 3] += axis * correction.x[at]
            self._twists[:3, at] = axis

        self._twists[:, :6] = np.eye(6)
        self._twists[:3, 3:6] = skew(pivot_m)
        z, at_m = self._frames[joints.axes, :3, 2], self._frames[joints.axes, :3, 3]
        self._twists[:3, joints.offsets] = joints.turns * cross(at_m, z).T + joints.slides * z.T
        self._twists[3:, joints.offsets] = joints.turns * z.T
        self._links: dict[str | None, CorrectedLink] = {}

    def link(self, name: str | None) -> CorrectedLink:
        """The frame of a DH row, or the tool for None; raises ValueError for a row that the chain lacks."""
        if name not in self._links:
            self._links[name] = self._corrected(name)
        return self._links[name]

    def _corrected(self, name: str | None) -> CorrectedLink:
        joints = self._joints
        row = len(joints.chain.rows) - 1 if name is None else row_index(joints.chain, name)
        if row < joints.first_row:
            T = self._correct @ self._robot.frames_in_camera[row]
        else:
            T = self._frames[row - joints.first_row + 1]
        if name is None:
            T = T @ joints.chain.T_last_tool
        derivative = self._twists.copy()
        derivative[:3] -= skew(T[:3, 3]) @ self._twists[3:]
        # Joints behind a link do not move it, nor do lengths.
        moved_by = int(np.searchsorted(joints.chain.moving_rows, row, side="right"))
        derivative[:, 6 + max(0, moved_by - joints.first_joint) : joints.offsets.stop] = 0.0
        derivative[:, joints.play] = derivative[:, joints.offsets]
        # Later stamps: every joint goes on at its rate.
        rates = self._robot.rates[joints.first_joint :]
        derivative[:, joints.time_offset] = derivative[:, joints.offsets] @ rates
        is_behind = [row < length.row for length in joints.row_lengths]
        derivative[:, joints.lengths][:, is_behind] = 0.0
        T.setflags(write=False)
        derivative.setflags(write=False)
        return CorrectedLink(T, derivative, derivative[:, joints.time_offset])

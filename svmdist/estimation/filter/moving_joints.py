"""What of a chain may err: the joints that move, lengths of rows, and where each stands in the error state."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.kinematics.dh import DHChain
from svmdist.profile.hand_eye import TIME_OFFSET, length_of, offset_of
from svmdist.transforms import Array


@dataclass(frozen=True, slots=True)
class RowLength:
    """A constant length of the chain that may be wrong: it shifts all frames from `row` on along an axis of a frame.

    The axis is column `column` of the frame of row `axis_row`, which is one before `row` or `row` itself.
    """

    row: int
    axis_row: int
    column: int


@dataclass(frozen=True, slots=True)
class MovingJoints:
    """The joints of a chain from `first_joint` on, whose offsets are corrected; their rows begin at `first_row`.

    `axes` are the places of the frames with their axes among those from the row before `first_row` on; `turns` and
    `slides`, shape (n_joints - first_joint,), are 1 for joints of that type and 0 for others.
    """

    chain: DHChain
    first_joint: int
    first_row: int
    axes: NDArray[np.intp]
    turns: Array
    slides: Array
    lengths: tuple[RowLength, ...]

    @property
    def columns(self) -> ErrorColumns:
        """Where in the error state what stands."""
        return ErrorColumns(len(self.turns), len(self.lengths))

    @property
    def constant_columns(self) -> dict[str, int]:
        """Where in the error state each constant stands, by its name."""
        at, names = self.columns, self.chain.joint_names[self.first_joint :]
        found = {offset_of(name): at.offsets.start + place for place, name in enumerate(names)}
        found |= {length_of(place): at.lengths.start + place for place in range(at.length_count)}
        return found | {TIME_OFFSET: at.time_offset}

    @classmethod
    def of(cls, chain: DHChain, first_joint: int) -> MovingJoints:
        """Of a chain with at least one such joint."""
        rows = chain.moving_rows[first_joint:]
        turns = chain.is_revolute[first_joint:].astype(np.float64)
        axes = rows - rows[0] + (chain.convention == "modified")
        lengths = tuple(_lengths(chain, int(rows[0])))
        return cls(chain, first_joint, int(rows[0]), axes, turns, 1.0 - turns, lengths)


@dataclass(frozen=True, slots=True)
class ErrorColumns:
    """Where in the error state (δp, δφ, δq, play, τ, δl) what stands, of so many moving joints and lengths."""

    joint_count: int
    length_count: int

    @property
    def offsets(self) -> slice:
        """Constant joint offsets δq."""
        return slice(6, 6 + self.joint_count)

    @property
    def play(self) -> slice:
        """Joint errors that change with the motion."""
        return slice(6 + self.joint_count, 6 + 2 * self.joint_count)

    @property
    def time_offset(self) -> int:
        """By how much the joints' stamps are late."""
        return 6 + 2 * self.joint_count

    @property
    def lengths(self) -> slice:
        """Lengths of the chain."""
        return slice(7 + 2 * self.joint_count, self.size)

    @property
    def size(self) -> int:
        """Of the error state."""
        return 7 + 2 * self.joint_count + self.length_count


def _lengths(chain: DHChain, first_row: int) -> Iterator[RowLength]:
    """Lengths behind the first moving joint that no joint's offset could stand in for."""
    is_modified = chain.convention == "modified"
    for index, row in enumerate(chain.rows):
        if index < first_row or (is_modified and index == first_row):
            continue
        # Standard: Rot_z(θ) Trans_z(d) Trans_x(a) Rot_x(α); modified: Rot_x(α) Trans_x(a) Rot_z(θ) Trans_z(d).
        if row.a_m != 0.0:
            yield RowLength(index, index - 1 if is_modified else index, 0)
        if row.d_m != 0.0 and row.joint != "prismatic" and (is_modified or index > first_row):
            yield RowLength(index, index if is_modified else index - 1, 2)

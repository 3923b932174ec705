"""Links under a correction: their poses, and how they answer to the error state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.kinematics.dh import DHChain, link_transforms, running_product
from svmdist.kinematics.jacobian import row_index
from svmdist.kinematics.robot_state import RobotState
from svmdist.transforms import Array, skew


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

    @classmethod
    def of(cls, chain: DHChain, first_joint: int) -> MovingJoints:
        """Of a chain with at least one such joint."""
        rows = chain.moving_rows[first_joint:]
        turns = chain.is_revolute[first_joint:].astype(np.float64)
        axes = rows - rows[0] + (chain.convention == "modified")
        return cls(chain, first_joint, int(rows[0]), axes, turns, 1.0 - turns)


@dataclass(frozen=True, slots=True)
class NominalFrames:
    """What of one robot state, or of a stack of them, no correction changes.

    `q`, shape (..., n_joints), are the reported joints, `frames` (..., n_rows, 4, 4) all row frames in the camera
    frame; `T_camera_before`, shape (..., 4, 4), is the one before the first corrected joint.
    """

    q: Array
    frames: Array
    T_camera_before: Array

    @classmethod
    def of(cls, robot: RobotState, first_row: int) -> NominalFrames:
        """Of one state; the row is that of the first corrected joint."""
        before = robot.frames_in_camera[first_row - 1] if first_row else robot.base_in_camera
        return cls(robot.q, robot.frames_in_camera, before)

    @classmethod
    def stack(cls, members: Sequence[NominalFrames]) -> NominalFrames:
        """Of several, with a leading axis."""
        return cls(
            np.stack([member.q for member in members]),
            np.stack([member.frames for member in members]),
            np.stack([member.T_camera_before for member in members]),
        )


@dataclass(frozen=True, slots=True)
class CorrectedLink:
    """Corrected poses of a link, (..., 4, 4), and the derivatives of their (δp, δθ) by the error state, (..., 6, n)."""

    T_camera_link: Array
    derivative: Array


class CorrectedLinks:
    """All links of a chain under one correction; frames and the twists of the error state are computed once.

    A twist (v, w) moves a point p of a body by v + w x p: each component of the error state is one in the camera
    frame (Murray, Li, Sastry 1994, sec. 3.4), so that one matrix serves all links behind a joint.
    """

    def __init__(
        self,
        joints: MovingJoints,
        nominal: NominalFrames,
        shift_m: Array,
        turn: Array,
        q_offset: Array,
        anchor_m: Array,
    ) -> None:
        self._joints, self._nominal = joints, nominal
        pivot_m = anchor_m + shift_m
        self._correct = np.eye(4)
        self._correct[:3, :3] = turn
        self._correct[:3, 3] = pivot_m - turn @ anchor_m

        # Frames from the one before the first joint with an offset on.
        q = nominal.q.copy()
        q[..., joints.first_joint :] += q_offset
        links = link_transforms(joints.chain, q, joints.first_row)
        frames = np.empty((*links.shape[:-3], links.shape[-3] + 1, 4, 4))
        frames[..., 0, :, :] = self._correct @ nominal.T_camera_before
        frames[..., 1:, :, :] = links
        self._frames = running_product(frames)

        axes = self._frames[..., joints.axes, :3, :]
        (zx, zy, zz), (px, py, pz) = ([axes[..., i, column] for i in range(3)] for column in (2, 3))
        twists = np.zeros((*q.shape[:-1], 6, 6 + len(joints.turns)))
        twists[..., :6, :6] = np.eye(6)
        twists[..., :3, 3:6] = skew(pivot_m)
        twists[..., 0, 6:] = joints.turns * (py * zz - pz * zy) + joints.slides * zx
        twists[..., 1, 6:] = joints.turns * (pz * zx - px * zz) + joints.slides * zy
        twists[..., 2, 6:] = joints.turns * (px * zy - py * zx) + joints.slides * zz
        twists[..., 3, 6:], twists[..., 4, 6:], twists[..., 5, 6:] = (
            joints.turns * zx,
            joints.turns * zy,
            joints.turns * zz,
        )
        self._twists = twists
        self._links: dict[str | None, CorrectedLink] = {}

    def link(self, name: str | None) -> CorrectedLink:
        """The frame of a DH row, or the tool for None; raises ValueError for a row that the chain lacks."""
        found = self._links.get(name)
        if found is None:
            found = self._links[name] = self._corrected(name)
        return found

    def _corrected(self, name: str | None) -> CorrectedLink:
        row = len(self._joints.chain.rows) - 1 if name is None else row_index(self._joints.chain, name)
        if row < self._joints.first_row:
            T = self._correct @ self._nominal.frames[..., row, :, :]
        else:
            T = self._frames[..., row - self._joints.first_row + 1, :, :]
        if name is None:
            T = T @ self._joints.chain.T_last_tool
        derivative = self._twists.copy()
        derivative[..., :3, :] -= skew(T[..., :3, 3]) @ self._twists[..., 3:, :]
        # Joints behind a link do not move it.
        moved_by = int(np.searchsorted(self._joints.chain.moving_rows, row, side="right"))
        derivative[..., 6 + max(0, moved_by - self._joints.first_joint) :] = 0.0
        T.setflags(write=False)
        derivative.setflags(write=False)
        return CorrectedLink(T, derivative)

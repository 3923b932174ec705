"""Links under a correction: their poses, and how they answer to the error state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.kinematics.dh import DHChain, link_transforms, running_product
from svmdist.kinematics.jacobian import row_index
from svmdist.kinematics.robot_state import RobotState
from svmdist.transforms import Array, cross, skew


@dataclass(frozen=True, slots=True)
class NominalFrames:
    """What of one robot state, or of a stack of them, no correction changes.

    `q`, shape (..., n_joints), are the reported joints, `frames` (..., n_rows, 4, 4) all row frames in the camera
    frame. Corrections change the joints from `first_joint` on; `T_camera_before`, shape (..., 4, 4), is the frame
    before the first of them.
    """

    q: Array
    frames: Array
    T_camera_before: Array
    first_joint: int

    @classmethod
    def of(cls, robot: RobotState, first_joint: int) -> NominalFrames:
        """Of one state."""
        row = int(robot.chain.moving_rows[first_joint])
        before = robot.frames_in_camera[row - 1] if row else robot.base_in_camera
        return cls(robot.q, robot.frames_in_camera, before, first_joint)

    @classmethod
    def stack(cls, members: Sequence[NominalFrames]) -> NominalFrames:
        """Of several, with a leading axis."""
        return cls(
            np.stack([member.q for member in members]),
            np.stack([member.frames for member in members]),
            np.stack([member.T_camera_before for member in members]),
            members[0].first_joint,
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
        chain: DHChain,
        nominal: NominalFrames,
        shift_m: Array,
        turn: Array,
        q_offset: Array,
        anchor_m: Array,
    ) -> None:
        self._chain, self._nominal = chain, nominal
        pivot_m = anchor_m + shift_m
        self._correct = np.eye(4)
        self._correct[:3, :3] = turn
        self._correct[:3, 3] = pivot_m - turn @ anchor_m
        self._first_row = int(chain.moving_rows[nominal.first_joint])

        # Frames from the one before the first joint with an offset on.
        q = nominal.q.copy()
        q[..., nominal.first_joint :] += q_offset
        links = link_transforms(chain, q, self._first_row)
        frames = np.empty((*links.shape[:-3], links.shape[-3] + 1, 4, 4))
        frames[..., 0, :, :] = self._correct @ nominal.T_camera_before
        frames[..., 1:, :, :] = links
        self._frames = running_product(frames)

        moving = chain.moving_rows[nominal.first_joint :] - self._first_row
        axes = self._frames[..., moving + (chain.convention == "modified"), :3, :]
        direction, point_m = axes[..., 2], axes[..., 3]
        turns = chain.is_revolute[nominal.first_joint :, None]
        self._twists = np.zeros((*q.shape[:-1], 6, 6 + len(moving)))
        self._twists[..., range(6), range(6)] = 1.0
        self._twists[..., :3, 3:6] = skew(pivot_m)
        self._twists[..., :3, 6:] = np.swapaxes(np.where(turns, cross(point_m, direction), direction), -1, -2)
        self._twists[..., 3:, 6:] = np.swapaxes(np.where(turns, direction, 0.0), -1, -2)
        self._links: dict[str | None, CorrectedLink] = {}

    def link(self, name: str | None) -> CorrectedLink:
        """The frame of a DH row, or the tool for None; raises ValueError for a row that the chain lacks."""
        found = self._links.get(name)
        if found is None:
            found = self._links[name] = self._corrected(name)
        return found

    def _corrected(self, name: str | None) -> CorrectedLink:
        row = len(self._chain.rows) - 1 if name is None else row_index(self._chain, name)
        if row < self._first_row:
            T = self._correct @ self._nominal.frames[..., row, :, :]
        else:
            T = self._frames[..., row - self._first_row + 1, :, :]
        if name is None:
            T = T @ self._chain.T_last_tool
        derivative = self._twists.copy()
        derivative[..., :3, :] -= skew(T[..., :3, 3]) @ self._twists[..., 3:, :]
        # Joints behind a link do not move it.
        moved_by = int(np.searchsorted(self._chain.moving_rows, row, side="right"))
        derivative[..., 6 + max(0, moved_by - self._nominal.first_joint) :] = 0.0
        return CorrectedLink(T, derivative)

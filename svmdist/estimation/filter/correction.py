"""The error of nominal kinematics as a state: a rigid correction, joint errors, a time offset and lengths.

    p_link = a + δp + exp([δφ]) (p_link,nominal(q', l + δl) - a),   R_link = exp([δφ]) R_link,nominal(q')
    q' = q(t + τ) + δq + play

with an anchor a, the tool's first nominal position. The nominal state is the correction; the error state is small
and flat, and retracted into the correction (Solà 2017, "Quaternion kinematics for the error-state Kalman filter",
sec. 6). Joints that hold still err like a wrong base, so their errors are lumped into the camera-to-base
transform's (Richter et al. 2021). `docs/method/fused.md` derives them and what can be observed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.estimation.filter.moving_joints import ErrorColumns
from svmdist.transforms import Array, rotation_of, rotation_vector


@dataclass(frozen=True, slots=True)
class Correction:
    """What is added to nominal kinematics.

    A shift in m, a turn, shape (3, 3), joint offsets and `play`, joint errors that change with the motion, how late
    the joints' stamps are in s, and errors of the chain's lengths in m.
    """

    shift_m: Array
    turn: Array
    q_offset: Array
    play: Array
    time_offset_s: float
    length_m: Array

    @classmethod
    def none(cls, columns: ErrorColumns) -> Correction:
        """What is there before anything was measured."""
        joints, lengths = np.zeros(columns.joint_count), np.zeros(columns.length_count)
        return cls(np.zeros(3), np.eye(3), joints, joints, 0.0, lengths)

    def retract(self, step: Array) -> Correction:
        """The correction after an error state, shape (n,), was found in it (box-plus)."""
        at = ErrorColumns(len(self.q_offset), len(self.length_m))
        return Correction(
            self.shift_m + step[:3],
            rotation_of(step[3:6]) @ self.turn,
            self.q_offset + step[at.offsets],
            self.play + step[at.play],
            self.time_offset_s + float(step[at.time_offset]),
            self.length_m + step[at.lengths],
        )

    def vector(self) -> Array:
        """All of it as an error state about no correction, shape (n,)."""
        return np.concatenate(
            [
                self.shift_m,
                rotation_vector(self.turn),
                self.q_offset,
                self.play,
                [self.time_offset_s],
                self.length_m,
            ]
        )

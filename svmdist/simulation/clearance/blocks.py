"""Values along a motion, computed a block of moments at a time: forward kinematics and bounds cost a call each."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from svmdist.transforms import Array

BLOCK = 64
"""Moments in a block: more save nothing, and hold up the first one."""


class Blocks:
    """The values, shape (n,), of a function of joints, shape (n, n_joints) each, at one moment after the other.

    The function takes some rows of all its arguments, and gives a value for each. Only the block of the last moment
    asked for is kept.
    """

    def __init__(self, values: Callable[..., Array], *joints: Array) -> None:
        self._values, self._joints = values, joints
        self._begin, self._block = -1, np.zeros(0)

    def __getitem__(self, index: int) -> float:
        """The value at one moment."""
        begin = index - index % BLOCK
        if begin != self._begin:
            self._block = self._values(*(q[begin : begin + BLOCK] for q in self._joints))
            self._begin = begin
        return float(self._block[index - begin])

"""Whether disparities agree with the instrument's known sizes, over the frames of a log.

One frame cannot tell a right camera that is turned from a shaft that is thicker: each is within its deviation, or a
little beyond. What is the same in frame after frame is no noise.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from svmdist.least_squares import median
from svmdist.profile.settings import StereoSettings


@dataclass(frozen=True, slots=True)
class DisparityCheck:
    """A disparity less the one at the depth by the sizes, over itself, and its standard deviation."""

    off: float
    std: float


class DisparityWatch:
    """The last checks of one instrument's disparities."""

    def __init__(self, settings: StereoSettings) -> None:
        self._bound = settings.watch_bound_stds
        self._checks: deque[DisparityCheck] = deque(maxlen=settings.watch_frames)

    def add(self, check: DisparityCheck) -> None:
        """Take up a frame's check."""
        self._checks.append(check)

    @property
    def doubt(self) -> float:
        """By how much disparities contradict the sizes, where that is more than their deviations allow; else 0.

        Deviations are those of constants for the most part, which are the same in all frames: the median is as
        uncertain as one check.
        """
        if not self._checks:
            return 0.0
        stds = median(np.array([check.off / check.std for check in self._checks]))
        if abs(stds) <= self._bound:
            return 0.0
        return abs(median(np.array([check.off for check in self._checks])))

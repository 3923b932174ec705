"""Alarms: which rows are closer to the tissue than a threshold, how fast the gap closes, and when it is gone."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from svmdist.results import FrameResult

MIN_SLOPE_ROWS = 3
MIN_CLOSING_M_S = 1e-3  # below a millimetre a second the time to contact is noise divided by noise


@dataclass(frozen=True, slots=True)
class AlarmRules:
    """Alarm where P(clearance < below_m) >= confidence; the default alarms unless 95 % sure that the row is safe."""

    below_m: float
    confidence: float = 0.05
    window_s: float = 0.5


@dataclass(frozen=True, slots=True)
class AlarmState:
    """Of one row: alarm, closing speed in m/s (positive: closer), time to contact in s; None where unknown."""

    alarm: bool | None = None
    closing_speed_m_s: float | None = None
    time_to_contact_s: float | None = None


class AlarmWatch:
    """Watches the rows of one instrument in the order of their stamps."""

    def __init__(self, rules: AlarmRules) -> None:
        self._rules = rules
        self._recent: deque[tuple[int, float]] = deque()

    def watch(self, row: FrameResult) -> AlarmState:
        """Judge one row."""
        clearance = row.distances.clearance
        if row.doubt:
            self._recent.clear()  # what comes closer may be another instrument
            return AlarmState()
        if not row.measured or clearance is None:
            return AlarmState()
        # That the model's surfaces overlap makes contact no less likely.
        std_m = clearance.without_overlap_std_m
        std_m = clearance.std_m if std_m is None else std_m
        probability = probability_below(self._rules.below_m, clearance.value_m, std_m or 0.0)
        speed_m_s = self._closing_speed_m_s(row.stamp_ns, clearance.value_m)
        contact_s = None
        if clearance.value_m <= 0.0:
            contact_s = 0.0
        elif speed_m_s is not None and speed_m_s > MIN_CLOSING_M_S:
            contact_s = clearance.value_m / speed_m_s
        return AlarmState(probability >= self._rules.confidence, speed_m_s, contact_s)

    def _closing_speed_m_s(self, stamp_ns: int, clearance_m: float) -> float | None:
        if self._recent and stamp_ns <= self._recent[-1][0]:
            self._recent.clear()  # another log, or a clock that was set back
        self._recent.append((stamp_ns, clearance_m))
        while stamp_ns - self._recent[0][0] > round(self._rules.window_s * 1e9):
            self._recent.popleft()
        if len(self._recent) < MIN_SLOPE_ROWS:
            return None
        # The median of all pairs' slopes: one wild row in three changes little (Theil 1950; Sen 1968).
        stamps_s = np.array([(stamp - stamp_ns) / 1e9 for stamp, _ in self._recent])
        values_m = np.array([value for _, value in self._recent])
        first, second = np.triu_indices(len(values_m), 1)
        slopes = (values_m[second] - values_m[first]) / (stamps_s[second] - stamps_s[first])
        return -float(np.median(slopes))


def probability_below(below_m: float, clearance_m: float, std_m: float) -> float:
    """P(true clearance < below_m) for a normal error; without a deviation the estimate is taken as it is."""
    if std_m <= 0.0:
        return float(clearance_m < below_m)
    return 0.5 * (1.0 + math.erf((below_m - clearance_m) / (std_m * math.sqrt(2.0))))

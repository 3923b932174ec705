"""Alarms: which rows are closer to the tissue than a threshold, how fast the gap closes, and when it is gone."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from svmdist.errors import UsageError
from svmdist.results import AlarmEvent, AlarmState, Distance, FrameResult

MIN_CLOSING_M_S = 1e-3  # below a millimetre a second the time to contact is noise divided by noise
MAX_GAP_ROWS = 2  # rows without a clearance that do not end an event: what hides an instrument for a moment
WHEN = {"possible": 0.05, "likely": 0.5, "certain": 0.95}
"""Names of the probability from which on an alarm is raised."""


@dataclass(frozen=True, slots=True)
class AlarmRules:
    """Alarm where P(clearance < below_m) is at least that of `when`; raises UsageError where that names none."""

    below_m: float
    when: str | float = "possible"  # a word of `WHEN`, or a probability: a smaller one alarms earlier and more often
    window_s: float = 0.5  # of the log, that a closing speed is fitted to

    def __post_init__(self) -> None:
        _ = self.probability

    @property
    def probability(self) -> float:
        """The probability from which on an alarm is raised."""
        try:
            probability = WHEN.get(str(self.when)) or float(self.when)
        except ValueError:
            probability = math.nan
        if not 0.0 <= probability <= 1.0:
            expected = f"expected {', '.join(WHEN)}, or a probability from 0 to 1, as in 0.2"
            raise UsageError(f"--alarm-when {self.when}: {expected}")
        return probability

    @property
    def in_words(self) -> str:
        """As in: clearance below 5 mm possible, P ≥ 0.05."""
        names = [f" {name}" for name, probability in WHEN.items() if probability == self.probability]
        return f"clearance below {self.below_m * 1e3:g} mm{''.join(names)}, P ≥ {self.probability:g}"


class AlarmWatch:
    """Watches the rows of one instrument in the order of the log."""

    def __init__(self, rules: AlarmRules) -> None:
        self._rules = rules
        self._last_ns = -math.inf
        self._restart()

    def _restart(self) -> None:
        self._recent: deque[tuple[int, float]] = deque()
        self._event: AlarmEvent | None = None
        self._gap, self._overlap_std_m = 0, math.inf

    def watch(self, row: FrameResult) -> AlarmState:
        """Take up one row."""
        if row.stamp_ns <= self._last_ns:
            self._restart()  # another log, or a clock that was set back
        self._last_ns = row.stamp_ns
        if row.doubt:
            self._recent.clear()  # what comes closer may be another instrument
        clearance = row.distances.clearance
        if row.doubt or not row.measured or clearance is None:
            self._gap += 1
            if self._gap > MAX_GAP_ROWS:
                self._event, self._overlap_std_m = None, math.inf
            return AlarmState()
        self._gap = 0
        probability = probability_below(self._rules.below_m, clearance.value_m, self._deviation_m(clearance))
        is_raised = probability >= self._rules.probability
        if is_raised:
            event = self._event or AlarmEvent(row.instrument, row.number, row.seconds, 0.0, clearance, row.number)
            if clearance.value_m < event.least.value_m:
                event = replace(event, least=clearance, least_number=row.number)
            self._event = replace(event, end_s=row.seconds)
        else:
            self._event = None
        speed_m_s = self._closing_speed_m_s(row.stamp_ns, clearance.value_m)
        contact_s = None
        if clearance.value_m <= 0.0:
            contact_s = 0.0
        elif speed_m_s is not None and speed_m_s > MIN_CLOSING_M_S:
            contact_s = clearance.value_m / speed_m_s
        return AlarmState(is_raised, speed_m_s, contact_s, self._event)

    def _deviation_m(self, clearance: Distance) -> float:
        """The deviation that the probability is of: deeper inside the tissue, the probability is never smaller."""
        # It lacks the overlap that the interval has, and does not grow while the surfaces overlap: the nearest way out
        # of the tissue may be one along which less is known, and that makes contact no less likely.
        std_m = clearance.without_overlap_std_m
        std_m = (clearance.std_m if std_m is None else std_m) or 0.0
        self._overlap_std_m = min(std_m, self._overlap_std_m) if clearance.value_m < 0.0 else std_m
        return self._overlap_std_m

    def _closing_speed_m_s(self, stamp_ns: int, clearance_m: float) -> float | None:
        self._recent.append((stamp_ns, clearance_m))
        while stamp_ns - self._recent[0][0] > round(self._rules.window_s * 1e9):
            self._recent.popleft()
        if len(self._recent) < 3:
            return None
        # The median of all pairs' slopes: one outlier in three changes little (Theil 1950; Sen 1968).
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

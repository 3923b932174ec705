"""Alarms scored against truth."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.metrics import alarm_statistics

TRUTH_M = np.array([9, 8, 6, 4, 3, 4, 6, 8, 9, 9]) / 1e3


def test_counts_and_lead() -> None:
    """Alarmed one frame early and once for nothing: precision 3/5, recall 1, lead 0.1 s, two false alarms begun."""
    alarms = [0, 0, 1, 1, 1, 1, 0, 0, 1, 0]
    got = alarm_statistics(np.arange(10) / 10, alarms, TRUTH_M, 0.005)
    assert got.precision == pytest.approx(3 / 5)
    assert got.recall == 1.0
    assert got.false_alarm_fraction == pytest.approx(2 / 7)
    assert got.false_alarms_per_minute == pytest.approx(2 / (0.9 / 60))
    assert got.event_count == 1
    assert got.lead_times_s == (pytest.approx(0.1),)


def test_late_and_missed() -> None:
    """A late alarm has a negative lead; a missed event has none."""
    late = alarm_statistics(np.arange(10) / 10, [0, 0, 0, 0, 1, 1, 0, 0, 0, 0], TRUTH_M, 0.005)
    assert late.lead_times_s == (pytest.approx(-0.1),)
    missed = alarm_statistics(np.arange(10) / 10, np.zeros(10), TRUTH_M, 0.005)
    assert missed.lead_times_s == ()
    assert missed.recall == 0.0
    assert missed.precision is None


def test_nothing_unsafe_or_nothing_at_all() -> None:
    """Without unsafe frames there is no recall; without frames there is nothing."""
    safe = alarm_statistics([0.0, 1.0], [False, False], [0.1, 0.1], 0.005)
    assert safe.recall is None
    assert safe.false_alarm_fraction == 0.0
    empty = alarm_statistics([], [], [], 0.005)
    assert empty.frame_count == 0
    assert empty.false_alarms_per_minute is None
    with pytest.raises(ValueError, match="same shape"):
        alarm_statistics([0.0], [True, False], [0.1], 0.005)

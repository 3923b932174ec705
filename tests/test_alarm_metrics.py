"""Alarms scored against truth."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.metrics import alarm_statistics, pooled_alarms

TRUTH_M = np.array([9, 8, 6, 4, 3, 4, 6, 8, 9, 9]) / 1e3


def test_counts_and_lead() -> None:
    """Alarmed one frame early and once for nothing: precision 3/5, recall 1, lead 0.1 s, one false alarm."""
    alarms = [0, 0, 1, 1, 1, 1, 0, 0, 1, 0]
    got = alarm_statistics(np.arange(10) / 10, alarms, TRUTH_M, 0.005)
    assert got.precision == pytest.approx(3 / 5)
    assert got.recall == 1.0
    assert got.false_alarm_fraction == pytest.approx(2 / 7)
    assert got.false_alarms_per_minute == pytest.approx(1 / (0.9 / 60))
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


def test_an_alarm_that_never_ends_leads_each_event_only_from_the_last() -> None:
    """The lead of a second event is counted over the safe frames before it, not through the first event."""
    truth_m = np.array([9, 4, 4, 9, 9, 4, 9]) / 1e3
    got = alarm_statistics(np.arange(7.0), np.ones(7), truth_m, 0.005)
    assert got.event_count == 2
    assert got.lead_times_s == (1.0, 2.0)
    assert (got.median_lead_s, got.min_lead_s, got.missed_event_count) == (1.5, 1.0, 0)
    assert got.false_alarms_per_minute == 0.0


def test_unjudged_frames_are_missed_alarms() -> None:
    """A frame that could not be judged has no alarm: where it is unsafe, recall says so."""
    judged = np.array([1, 1, 1, 1, 0, 1, 1, 1, 1, 1], bool)
    got = alarm_statistics(np.arange(10) / 10, (TRUTH_M < 0.005) & judged, TRUTH_M, 0.005, judged)
    assert got.unjudged_count == 1
    assert got.recall == pytest.approx(2 / 3)
    assert got.precision == 1.0


def test_pooling_adds_counts_and_durations() -> None:
    """Two recordings together: shares by frames, rates by time, no event across the seam."""
    a = alarm_statistics(np.arange(10) / 10, np.zeros(10), TRUTH_M, 0.005)
    b = alarm_statistics([50.0, 50.1], [True, True], [0.004, 0.004], 0.005)
    both = pooled_alarms([a, b])
    assert both.recall == pytest.approx(2 / 5)
    assert both.duration_s == pytest.approx(1.0)
    assert both.event_count == 1
    assert pooled_alarms([]).recall is None


def test_threshold_itself_is_safe() -> None:
    """Unsafe is strictly below the threshold."""
    assert alarm_statistics([0.0, 1.0], [True, True], [0.005, 0.004], 0.005).unsafe_count == 1

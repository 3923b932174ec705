"""Alarms by probability, closing speed by a robust slope."""

import numpy as np
import pytest

from svmdist.estimation.alarms import AlarmRules, AlarmState, AlarmWatch, probability_below
from svmdist.results import Distance, Distances, FrameResult
from svmdist.samples import Status


def row(seconds: float, clearance_m: float | None) -> FrameResult:
    clearance = None if clearance_m is None else Distance(clearance_m, 0.5e-3)
    distances = Distances(planar=Distance(0.01), clearance=clearance)
    return FrameResult(round(seconds * 1e9), Status.OK, distances=distances)


def test_probability_and_confidence_decide():
    """Half at the threshold, 97.7 % two deviations below, a step without a deviation.

    Half a deviation below the threshold is an alarm at even odds, not at 90 %.
    """
    assert probability_below(0.005, 0.005, 1e-3) == pytest.approx(0.5)
    assert probability_below(0.005, 0.003, 1e-3) == pytest.approx(0.97725, abs=1e-5)
    assert (probability_below(0.005, 0.004, 0.0), probability_below(0.005, 0.006, 0.0)) == (1.0, 0.0)
    near = row(0.0, 0.00475)
    assert AlarmWatch(AlarmRules(0.005, 0.5)).watch(near).alarm is True
    assert AlarmWatch(AlarmRules(0.005, 0.9)).watch(near).alarm is False


def test_contact_alarms_at_every_confidence():
    """2 mm inside the tissue by a method that is sure to 0.5 mm, whose interval is as wide as the overlap."""
    gap = Distance(-2e-3, 2.06e-3, without_overlap_std_m=0.5e-3)
    contact = FrameResult(0, Status.OK, distances=Distances(clearance=gap))
    for confidence in (0.05, 0.9, 0.99):
        assert AlarmWatch(AlarmRules(0.0, confidence)).watch(contact).alarm is True


def test_closing_speed_and_contact():
    """A gap of 10 mm that closes by 10 mm/s is gone in 0.5 s after 0.5 s, one wild row notwithstanding."""
    watch = AlarmWatch(AlarmRules(0.005))
    for seconds in np.arange(0.0, 0.55, 0.1):
        wild = 0.02 if seconds == pytest.approx(0.3) else 0.0
        state = watch.watch(row(seconds, 0.010 - 0.010 * seconds + wild))
    assert state.closing_speed_m_s == pytest.approx(0.010, rel=1e-6)
    assert state.time_to_contact_s == pytest.approx(0.5, rel=1e-6)

    # Of an opening gap speed is negative, without a time to contact; in contact that is zero.
    watch = AlarmWatch(AlarmRules(0.005))
    for seconds in (0.0, 0.1, 0.2):
        state = watch.watch(row(seconds, 0.004 + 0.01 * seconds))
    assert state.closing_speed_m_s == pytest.approx(-0.01)
    assert state.time_to_contact_s is None
    assert AlarmWatch(AlarmRules(0.005)).watch(row(0.0, -1e-4)).time_to_contact_s == 0.0


def test_without_a_clearance_there_is_neither_alarm_nor_safety():
    for unmeasured in (row(0.0, None), FrameResult(1, Status.NO_TISSUE)):
        assert AlarmWatch(AlarmRules(0.005)).watch(unmeasured) == AlarmState()

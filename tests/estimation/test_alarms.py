"""Alarms by probability, the events that they make, closing speed by a robust slope."""

from dataclasses import replace

import numpy as np
import pytest

from svmdist.errors import UsageError
from svmdist.estimation.alarms import AlarmRules, AlarmWatch, probability_below
from svmdist.results import AlarmState, Distance, Distances, FrameResult
from svmdist.samples import Status
from svmdist.workflows.estimate import Ending


def row(seconds: float, clearance_m: float | None, std_m: float = 0.5e-3) -> FrameResult:
    clearance = None if clearance_m is None else Distance(clearance_m, std_m)
    distances, number = Distances(planar=Distance(0.01), clearance=clearance), round(10 * seconds)
    stamp_ns = round(seconds * 1e9)
    return FrameResult(stamp_ns, Status.OK, distances=distances, number=number, seconds=seconds)


def test_probability_and_confidence_decide():
    """Half at the threshold, 97.7 % two deviations below, a step without a deviation.

    Half a deviation below the threshold is an alarm at even odds, not at 90 %.
    """
    assert probability_below(0.005, 0.005, 1e-3) == pytest.approx(0.5)
    assert probability_below(0.005, 0.003, 1e-3) == pytest.approx(0.97725, abs=1e-5)
    assert (probability_below(0.005, 0.004, 0.0), probability_below(0.005, 0.006, 0.0)) == (1.0, 0.0)
    near = row(0.0, 0.00475)
    assert AlarmWatch(AlarmRules(0.005, 0.5)).watch(near).is_raised is True
    assert AlarmWatch(AlarmRules(0.005, 0.9)).watch(near).is_raised is False


def test_contact_alarms_at_every_confidence():
    """2 mm inside the tissue by a method that is sure to 0.5 mm, whose interval is as wide as the overlap."""
    gap = Distance(-2e-3, 2.06e-3, without_overlap_std_m=0.5e-3)
    contact = FrameResult(0, Status.OK, distances=Distances(clearance=gap))
    for confidence in (0.05, 0.9, 0.99):
        assert AlarmWatch(AlarmRules(0.0, confidence)).watch(contact).is_raised is True


def test_words_stand_for_probabilities():
    """And say which is which; what is neither a word nor a probability is an error."""
    for when, probability, said in (
        ("possible", 0.05, "below 5 mm possible, P ≥ 0.05"),
        ("certain", 0.95, "below 5 mm certain, P ≥ 0.95"),
        ("0.2", 0.2, "below 5 mm, P ≥ 0.2"),
    ):
        rules = AlarmRules(0.005, when)
        assert (rules.probability, rules.in_words) == (probability, f"clearance {said}")
    for wrong in ("often", "1.5", -0.1, float("nan")):
        with pytest.raises(UsageError, match="possible, likely, certain, or a probability"):
            AlarmRules(0.005, wrong)


def test_deeper_is_never_less_probable():
    """Also where the deviation grows faster than the depth, or a row has no clearance; outside it may shrink."""
    depths = [-0.0005, *(0.001 * depth for depth in (0.1, 0.5, 1.0, 2.0, 4.0))]
    rows = [row(0.1 * at, -depth, 5e-4 + 3.0 * max(depth, 0.0)) for at, depth in enumerate(depths)]
    rows.insert(4, replace(row(0.35, None), status=Status.NO_TISSUE))
    watch = AlarmWatch(AlarmRules(0.001, "certain"))
    assert [watch.watch(one).is_raised for one in rows] == [False, True, True, True, None, True, True]
    assert watch.watch(row(0.7, 0.0005, 2e-3)).is_raised is False
    assert watch.watch(row(0.8, -0.0005, 2e-3)).is_raised is False


def test_events_begin_and_end_with_alarmed_rows():
    """Two rows without a clearance do not end one, three do, and so does one that is judged safe."""
    near, far, none = 0.002, 0.02, None
    clearances_m = (far, near, 0.001, none, none, near, far, near, none, none, none, near, near)
    watch, rows = (
        AlarmWatch(AlarmRules(0.005)),
        [row(0.1 * at, gap_m) for at, gap_m in enumerate(clearances_m)],
    )
    found = Ending.of(replace(one, alarm=watch.watch(one)) for one in rows).alarms
    assert [(one.start_number, one.least_number, one.least.value_m) for one in found] == [
        *((1, 2, 0.001), (7, 7, near), (11, 11, near)),
    ]
    np.testing.assert_allclose([one.duration_s for one in found], [0.4, 0.0, 0.1])
    assert Ending.of(rows).alarms == []


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

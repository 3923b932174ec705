"""Alarms of rows against the true clearance: known rows give known counts, whatever their order."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.errors import RecordingError, UsageError
from svmdist.estimation.alarms import AlarmRules
from svmdist.estimation.methods import PLANAR_METHODS, SPATIAL_METHODS
from svmdist.samples import Status
from svmdist.tracks import SampledDistances
from svmdist.workflows.scores import require_clearance, score_alarms
from tests.rows import result_of

STAMPS_NS = np.array([0, 1, 2, 3, 4], np.int64) * 1_000_000_000
CLEARANCES_M = (0.010, 0.004, None, 0.004, 0.010)
ROWS = [
    result_of(int(stamp_ns), Status.OK, planar_m=0.0, clearance_m=clearance_m)
    for stamp_ns, clearance_m in zip(STAMPS_NS, CLEARANCES_M, strict=True)
]


def truth(*clearance_m: float) -> SampledDistances:
    """True clearances at the stamps."""
    values = np.array(clearance_m)
    return SampledDistances(values, values, values, np.ones(len(values), np.bool_))


@pytest.mark.parametrize("order", [[0, 1, 2, 3, 4], [4, 2, 0, 3, 1]], ids=["sorted", "shuffled"])
def test_counts(order: list[int]) -> None:
    """Below 5 mm two frames are alarmed, one of them rightly; the unsafe frame without a clearance is missed."""
    true = truth(0.010, 0.006, 0.003, 0.003, 0.010)
    fields = (true.planar_m, true.spatial_m, true.clearance_m, true.valid)
    shuffled = SampledDistances(*(values[order] for values in fields))
    found = score_alarms([ROWS[index] for index in order], shuffled, STAMPS_NS[order], AlarmRules(0.005))
    assert (found.frame_count, found.unsafe_count, found.unjudged_count) == (5, 2, 1)
    assert (found.true_alarm_count, found.false_alarm_count) == (1, 1)
    assert (found.event_count, found.lead_times_s, found.duration_s) == (1, (-1.0,), 4.0)


def test_frames_without_a_true_clearance_are_left_out() -> None:
    """They count nowhere; where they are all frames, that is an error."""
    found = score_alarms(ROWS, truth(np.nan, 0.003, np.nan, np.nan, 0.010), STAMPS_NS, AlarmRules(0.005))
    assert (found.frame_count, found.unsafe_count, found.true_alarm_count) == (2, 1, 1)
    with pytest.raises(RecordingError, match="no frame with a true clearance"):
        score_alarms(ROWS, truth(*[np.nan] * 5), STAMPS_NS, AlarmRules(0.005))


def test_planar_methods_are_refused() -> None:
    """The message names the methods that estimate a clearance."""
    for method in PLANAR_METHODS:
        with pytest.raises(UsageError, match=", ".join(SPATIAL_METHODS)):
            require_clearance(method)
    for method in SPATIAL_METHODS:
        require_clearance(method)

"""Rows to pairs, scores, alarms and series: what has no value is left out, and known rows give known figures."""

from dataclasses import replace

import numpy as np
import pytest

from svmdist.errors import RecordingError
from svmdist.estimation.alarms import AlarmRules, AlarmWatch
from svmdist.results import Distance, Distances, FrameResult, ImageFindings
from svmdist.samples import Status
from svmdist.workflows.estimate import Series, worst_frames
from svmdist.workflows.scoring import scores
from svmdist.workflows.scoring.references import Truth


def result_of(
    stamp_ns: int, status: Status, tool_px: tuple[float, float] | None = None, **distances_m: Distance
) -> FrameResult:
    """A result with distances by their names."""
    return FrameResult(stamp_ns, status, ImageFindings(tool_px=tool_px), distances=Distances(**distances_m))


ROWS = [
    result_of(10, Status.OK, (3.0, 4.0), planar=Distance(1.0), spatial=Distance(1.5, 0.1)),
    result_of(20, Status.NO_TISSUE, (5.0, 6.0), planar=Distance(9.0)),
    result_of(30, Status.OK, planar=Distance(2.0)),
    result_of(40, Status.OK, planar=Distance(3.0), clearance=Distance(0.5)),
]
TRUTH = Truth(np.array([[1.1, 1.4, np.nan], [2.0, 2.0, 0.3], [2.1, 2.0, 0.3], [np.nan] * 3]))


def test_only_measured_rows_with_a_truth_make_pairs():
    """A rejected row, one without the distance and one without a truth are left out; numbers are as they were."""
    readings = scores.Readings(ROWS)
    planar, spatial, clearance = (readings.pairs(distance, TRUTH) for distance in scores.DISTANCES)
    assert planar.stamps_ns.tolist() == [10, 30]
    assert planar.estimate_m.tolist() == [1.0, 2.0]
    assert planar.truth_m.tolist() == [1.1, 2.1]
    assert np.isnan(planar.std_m).all()
    assert (spatial.estimate_m.tolist(), spatial.std_m.tolist()) == ([1.5], [0.1])
    assert len(clearance) == 0
    assert dict(readings.rejected) == {"no_tissue": 1}
    np.testing.assert_array_equal(readings.tool_px, [[3.0, 4.0], *[[np.nan, np.nan]] * 3])
    assert (len(readings), readings.stamps_ns.tolist()) == (4, [10, 20, 30, 40])


def test_no_rows_make_no_pairs():
    """Without rows there are arrays of length 0, and no score."""
    pairs = scores.Readings().pairs("spatial", Truth(np.empty((0, 3))))
    assert len(pairs) == 0
    assert pairs.statistics is None
    assert scores.pooled_pairs([None, pairs]) is None


def test_pooling_counts_every_pair_the_same():
    """The bias of parts together is the mean over all pairs, not the mean of means."""

    def off_by(error_m: float, count: int) -> scores.Pairs:
        truth_m = np.linspace(0.0, 1.0, count)
        return scores.Pairs(np.arange(count), truth_m + error_m, truth_m, np.full(count, 0.1))

    parts = [off_by(0.3, 1), off_by(0.0, 3)]
    together = scores.pooled_pairs(parts)
    assert together.statistics.bias == pytest.approx(0.3 / 4)
    assert together.interval_coverage == 0.75  # 0.3 lies outside ±1.96 x 0.1
    assert len(together) == 4


STAMPS_NS = np.array([0, 1, 2, 3, 4], np.int64) * 1_000_000_000
BEFORE = [
    result_of(int(stamp_ns), Status.OK, clearance=None if clearance_m is None else Distance(clearance_m))
    for stamp_ns, clearance_m in zip(STAMPS_NS, (0.010, 0.004, None, 0.004, 0.010), strict=True)
]
WATCH = AlarmWatch(AlarmRules(0.005))
WITH_ALARMS = [replace(row, alarm=WATCH.watch(row)) for row in BEFORE]


def true_clearance(*clearance_m: float) -> Truth:
    """True clearances at the stamps."""
    return Truth(np.stack([np.array(clearance_m)] * 3, -1))


def test_frames_without_a_true_clearance_are_left_out():
    """They count nowhere; where they are all frames, that is an error."""
    true = true_clearance(np.nan, 0.003, np.nan, np.nan, 0.010)
    found = scores.score_alarms(WITH_ALARMS, true, STAMPS_NS, 0.005)
    assert (found.frame_count, found.unsafe_count, found.true_alarm_count) == (2, 1, 1)
    with pytest.raises(RecordingError, match="no frame with a true clearance"):
        scores.score_alarms(WITH_ALARMS, true_clearance(*[np.nan] * 5), STAMPS_NS, 0.005)


SERIES = Series(
    "log",
    "PSM1",
    "fused",
    "clearance",
    np.arange(4),
    np.arange(4) * 0.1,
    ("ok", "ok", "no_tissue", "ok"),
    ("", "", "hidden", ""),
    np.array([0.010, 0.020, np.nan, 0.030]),
    np.array([0.001, 0.002, np.nan, 0.0005]),
    np.array([0.011, 0.0195, 0.02, 0.027]),
    np.zeros((4, 2)),
    np.ones(4),
)


def test_with_truth_the_worst_frame_has_the_largest_error():
    worst = worst_frames([SERIES], 4)
    assert [frame.number for frame in worst] == [3, 0, 1, 2]
    assert worst[0].in_words == "frame 3 at 0.30 s, PSM1: clearance error +3.00 mm, interval ±0.98 mm"
    assert worst[-1].in_words == "frame 2 at 0.20 s, PSM1: not measured: no_tissue (hidden)"


def test_without_truth_the_worst_frame_has_the_widest_interval():
    blind = replace(SERIES, truth_m=np.full(4, np.nan))
    worst = worst_frames([blind], 2)
    assert [frame.number for frame in worst] == [1, 0]
    assert worst[0].in_words.endswith("clearance interval ±3.92 mm")


def test_of_two_instruments_an_image_counts_once_by_its_worse_one():
    other = replace(SERIES, instrument="PSM2", estimate_m=SERIES.truth_m + np.array([0.0, 0.01, 0.0, 0.0]))
    worst = worst_frames([SERIES, other], 3)
    assert [(frame.number, frame.series.instrument) for frame in worst] == [
        (1, "PSM2"),
        (3, "PSM1"),
        (0, "PSM1"),
    ]
    assert worst[0].severity_m == pytest.approx(0.01)

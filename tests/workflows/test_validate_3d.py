"""Scoring in 3D and of alarms: rows made from a log's own truth with known errors give the known figures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svmdist.errors import RecordingError, UsageError
from svmdist.estimation.alarms import AlarmRules, AlarmWatch
from svmdist.metrics import row_of
from svmdist.recording.log import Recording, open_recording
from svmdist.report.scores import score_columns
from svmdist.results import Distance, Distances, FrameResult
from svmdist.samples import Status
from svmdist.workflows.request import Request, prepare
from svmdist.workflows.scoring.references import Reference, TruthRules
from svmdist.workflows.scoring.scores import Score, pool_scores, score_rows
from svmdist.workflows.validate import (
    Validation,
    find_regressions,
    make_baseline,
    require_same_alarms,
    validate,
)
from tests.measuring import flat
from tests.reading import read_images
from tests.synthetic import without, write_log

SETUP = prepare(method="kinematic")
ERROR_M = 2e-3
BELOW_M = 0.012


@pytest.fixture(scope="module")
def recording(synthetic_log: Path) -> Recording:
    """The synthetic log, whose clearance is its spatial distance less 10 mm."""
    return open_recording(synthetic_log, SETUP.profile)


def rows_of(recording: Recording, error_m: float = ERROR_M) -> list[FrameResult]:
    """Rows that are `error_m` too long in 3D and exact in the plane, at the stamps of the images."""
    stamps_ns = np.array([image.stamp_ns for image in read_images(recording)], np.int64)
    truth = recording.distance_track().at(stamps_ns)
    return [
        FrameResult(
            int(stamp_ns),
            Status.OK,
            distances=Distances(
                planar=Distance(float(planar_m)),
                spatial=Distance(float(spatial_m) + error_m, ERROR_M),
                clearance=Distance(float(clearance_m) + error_m, ERROR_M / 4),
            ),
        )
        for stamp_ns, (planar_m, spatial_m, clearance_m) in zip(stamps_ns, truth.values, strict=True)
    ]


def scored(recording: Recording, rows: list[FrameResult], alarms: AlarmRules | None = None) -> Score:
    """The score of rows, with their alarms, against the simulator's truth."""
    if alarms is not None:
        watch = AlarmWatch(alarms)
        rows = [replace(row, alarm=watch.watch(row)) for row in rows]
    return score_rows(rows, recording, Request(SETUP, alarms=alarms), Reference.GROUND_TRUTH)


def test_spatial_and_clearance_figures_are_the_injected_errors(recording):
    """RMSE, p95 and bias are the shift; an interval of 2 std holds all truths, one of half a shift none."""
    score = scored(recording, rows_of(recording))
    for part in (score.spatial, score.clearance):
        assert part.statistics.rmse == pytest.approx(ERROR_M)
        assert part.statistics.p95_abs_error == pytest.approx(ERROR_M)
        assert part.statistics.bias == pytest.approx(ERROR_M)
    assert (score.spatial.interval_coverage, score.clearance.interval_coverage) == (1.0, 0.0)
    assert score.statistics.rmse == pytest.approx(0.0, abs=1e-12)
    row = row_of(score_columns(), score)
    assert row["interval_coverage"] is None
    assert row["spatial_rmse_m"] == pytest.approx(ERROR_M)


def test_other_references_tell_spatial_but_no_clearance(recording):
    """DH kinematics give the tool in 3D, to the accuracy of this log's truth, and no surface."""
    score = score_rows(rows_of(recording), recording, Request(SETUP), Reference.KINEMATICS)
    assert score.spatial.statistics.rmse == pytest.approx(ERROR_M, rel=1e-3)
    assert score.clearance is None


def test_alarms_count_every_frame_with_a_truth(recording):
    """Exact clearances alarm exactly below the threshold; a frame that is not measured is a missed alarm."""
    rules = AlarmRules(BELOW_M)
    rows = [
        replace(row, distances=replace(row.distances, clearance=Distance(flat(row).clearance_m)))
        for row in rows_of(recording, 0.0)
    ]
    truth_m = np.array([flat(row).clearance_m for row in rows])
    unsafe = np.flatnonzero(truth_m < BELOW_M)
    assert 3 < len(unsafe) < len(rows) - 3
    exact = scored(recording, rows, rules).alarms
    assert (exact.recall, exact.precision, exact.false_alarm_fraction) == (1.0, 1.0, 0.0)
    rows[unsafe[0]] = FrameResult(rows[unsafe[0]].stamp_ns, Status.NO_TISSUE)
    lost = scored(recording, rows, rules).alarms
    assert lost.frame_count == len(rows)
    assert (lost.unjudged_count, lost.unsafe_unjudged_count) == (1, 1)
    assert lost.recall == pytest.approx(1.0 - 1.0 / len(unsafe))


def test_overall_figures_do_not_depend_on_the_order_of_the_files(recording):
    """Scores pooled in any order give the same figures and intervals, although the bootstrap draws neighbours."""
    rng = np.random.default_rng(5)
    score = scored(recording, rows_of(recording))
    several = []
    for name, std_m in (("b", 1e-3), ("c", 3e-3), ("a", 1e-4)):
        estimate_m = score.pairs.truth_m + rng.normal(0.0, std_m, len(score.pairs))
        planar = replace(score.pairs, estimate_m=estimate_m)
        several.append(replace(score, recording=name, planar=planar))
    first, *others = (pool_scores([several[n] for n in order]) for order in ((0, 1, 2), (2, 1, 0), (1, 0, 2)))
    assert first.intervals.rmse.low < first.intervals.rmse.high
    for other in others:
        assert other.statistics == first.statistics
        assert other.intervals == first.intervals


def test_a_baseline_catches_worse_alarms_and_worse_clearance(recording):
    """Fewer alarms and longer clearances than stored are regressions; other rules are not compared at all."""
    rules = AlarmRules(BELOW_M)

    def validation(error_m: float) -> Validation:
        return Validation((scored(recording, rows_of(recording, error_m), rules),), (), (), rules)

    baseline = make_baseline(validation(0.0))
    assert find_regressions(validation(0.0), baseline, complete=True) == []
    worse = find_regressions(validation(8e-3), baseline, complete=True)
    assert {line.split()[-5] for line in worse} == {"spatial_rmse_m", "clearance_rmse_m", "alarm_recall"}
    nervous = find_regressions(validation(-8e-3), baseline, complete=True)
    assert any(": false_alarm_fraction was " in line for line in nervous)
    require_same_alarms(baseline, rules)
    for other in (None, AlarmRules(0.005), AlarmRules(BELOW_M, 0.5)):
        with pytest.raises(UsageError, match=r"--alarm-below 12mm --alarm-when 0\.05"):
            require_same_alarms(baseline, other)


def test_a_log_without_any_truth_is_refused_before_it_is_measured(tmp_path, monkeypatch):
    bare = write_log(tmp_path / "bare.mcap", frame_count=3, change=lambda topic, one: one if "ECM" in topic else None)
    monkeypatch.setattr("svmdist.workflows.validate.replay", None)
    with pytest.raises(RecordingError) as refused:
        validate([open_recording(bare, SETUP.profile)], Request(SETUP))
    assert str(refused.value) == (
        "bare: there is no truth to compare with: no true distances (ground_truth), no joint states (kinematics), no"
        " poses (pose); the topics are /ECM/left/camera_info, /ECM/left/image; `svmdist compare` sets methods against"
        " each other, without a truth"
    )


def test_alarms_need_a_true_clearance(recording, tmp_path):
    """Without ground truth among the references, or in the log, alarms cannot be scored."""
    rules = AlarmRules(BELOW_M)
    with pytest.raises(UsageError, match="ground_truth"):
        validate([recording], Request(SETUP, alarms=rules, rules=TruthRules((Reference.KINEMATICS,))))
    with pytest.raises(UsageError, match="overlay measures in the plane"):
        validate([recording], Request(prepare(method="overlay"), alarms=rules))

    blind = write_log(tmp_path / "blind.mcap", frame_count=3, change=without("/ground_truth/distance"))
    with pytest.raises(RecordingError, match=r"no true distances \(ground_truth\); the topics are /ECM"):
        validate([open_recording(blind, SETUP.profile)], Request(SETUP, alarms=rules))

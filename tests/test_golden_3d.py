"""The golden logs in 3D: a part of their frames, held against the targets of the methods in 3D."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from svmdist.estimation.arm import Arm
from svmdist.estimation.association.associate import Association
from svmdist.estimation.detection.scene import Scene
from svmdist.recording.reader import Recording, open_recording
from svmdist.samples import Rejection
from svmdist.workflows.replay import MultiInstrumentEstimator
from svmdist.workflows.scoring.baseline import load_baseline
from svmdist.workflows.setup import Setup, prepare
from tests.measuring import flat
from tests.shipped import EXACT_PROFILE

STRIDE = 8
"""Every eighth frame is measured, at 1.25 Hz: enough for a target; the baseline has all of them."""
SETTLED_S = 2.0


def rows_of(recording: Recording, setup: Setup) -> Iterator[Any]:
    """The rows of every eighth frame, one an instrument."""
    arms = [Arm(setup.profile.for_instrument(name)) for name in recording.instruments]
    association, estimator = Association(arms), MultiInstrumentEstimator(setup, arms)
    for index, found in enumerate(recording.observations_of(recording.instruments)):
        if index % STRIDE == 0:
            assert not isinstance(found, Rejection)
            scene = Scene(found[0], setup.profile, setup.segmenter)
            yield from map(flat, estimator.estimate(association.frames(scene, found)).results)


def errors_m(recording: Recording, rows: list[Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One instrument's errors of spatial distance and clearance, and its true clearance, shape (n,) each."""
    truth = recording.for_instrument(rows[0].instrument).distance_track()
    at = truth.at(np.array([row.stamp_ns for row in rows], np.int64))
    assert at.valid.all()
    spatial_m = np.array([row.spatial_m for row in rows], np.float64)
    clearance_m = np.array([row.clearance_m for row in rows], np.float64)
    return spatial_m - at.spatial_m, clearance_m - at.clearance_m, at.clearance_m


def rmse(values: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def test_stereo_knows_the_clearance(golden: Path) -> None:
    """Every frame is measured, and the clearance errs by at most 1 mm RMSE within 30 mm of the tissue."""
    setup = prepare(method="stereo")
    recording = open_recording(golden / "3d" / "contact.mcap", setup.profile)
    rows = list(rows_of(recording, setup))
    assert all(row.measured for row in rows)
    _, clearance_error_m, clearance_m = errors_m(recording, rows)
    near = clearance_m <= 0.03
    assert near.sum() >= 5
    assert rmse(clearance_error_m[near]) <= 1e-3


def test_fused_settles_with_two_instruments(golden: Path) -> None:
    """From 2 s on both spatial distances err by at most 0.5 mm RMSE, though the robot errs by centimetres.

    Both arms move alike, so a swapped name would be off by tens of millimetres. The clearance between them is told from
    both sides alike, along opposite directions.
    """
    setup = prepare(method="fused")
    recording = open_recording(golden / "3d" / "duo.mcap", setup.profile)
    rows = list(rows_of(recording, setup))
    assert all(row.measured for row in rows)
    names = recording.instruments
    assert names == ("PSM1", "PSM2")
    settled_ns = rows[0].stamp_ns + round(SETTLED_S * 1e9)
    for name in names:
        late = [row for row in rows if row.instrument == name and row.stamp_ns >= settled_ns]
        spatial_error_m, _, _ = errors_m(recording, late)
        assert rmse(spatial_error_m) <= 0.5e-3
    for first, second in zip(rows[::2], rows[1::2], strict=True):
        assert first.instrument_clearance_m == pytest.approx(second.instrument_clearance_m, abs=1e-9)
        assert np.dot(
            np.array(first.instrument_clearance_direction), np.array(second.instrument_clearance_direction)
        ) == pytest.approx(-1.0)


def test_a_world_that_is_known_exactly_is_measured_to_a_tenth_of_a_millimetre(golden: Path) -> None:
    """With a profile that states no deviation of constants, which is true of this log: 0.1 mm from 2 s on."""
    setup = replace(prepare(method="fused"), profile=EXACT_PROFILE)
    recording = open_recording(golden / "3d" / "contact.mcap", setup.profile)
    rows = list(rows_of(recording, setup))
    assert all(row.measured for row in rows)
    late = [row for row in rows if row.stamp_ns >= rows[0].stamp_ns + round(SETTLED_S * 1e9)]
    spatial_error_m, _, _ = errors_m(recording, late)
    std_m = np.array([row.spatial_std_m for row in late], np.float64)
    assert rmse(spatial_error_m) <= 1e-4
    assert np.median(std_m) <= 2e-4
    assert np.mean(np.abs(spatial_error_m) <= 1.96 * std_m) >= 0.9


def test_the_baseline_meets_the_targets(golden: Path) -> None:
    """What CI holds `fused` to is what is promised: coverage and spatial RMSE of each log, alarms over all."""
    baseline = load_baseline(golden / "3d" / "baseline.json")
    assert {(score.method, score.reference) for score in baseline.scores} == {("fused", "ground_truth")}
    assert {score.recording for score in baseline.scores} >= {"contact", "duo", "duo PSM2"}
    for score in baseline.scores:
        assert score.coverage >= 0.98
        assert score.spatial_rmse_m is not None
        assert score.spatial_rmse_m <= 0.5e-3
    overall = next(score for score in baseline.scores if score.recording == "overall")
    assert overall.alarm_recall is not None
    assert overall.alarm_recall >= 0.99
    assert overall.false_alarm_fraction is not None
    # A clearance that no calibration knows exactly is alarmed earlier: one safe frame in twenty at most.
    assert overall.false_alarm_fraction <= 0.05

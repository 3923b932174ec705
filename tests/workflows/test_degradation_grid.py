"""The grid: what a cell measures is what the method gives alone on degraded images, and nothing leaks between cells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svmdist.errors import RecordingError, UsageError
from svmdist.recording.log import Recording, open_recording
from svmdist.samples import DistanceSample, Observation, RightView, Sample
from svmdist.vision.degradations import Degradation, degrade
from svmdist.workflows.conditions import CLEAN, Condition
from svmdist.workflows.degradation_grid import degradation_grid, grid_conditions
from svmdist.workflows.request import prepare
from tests.measuring import Measuring
from tests.synthetic import write_log

SETUP = prepare(method="centroid")
FRAMES = 6


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short log drawn with OpenCV."""
    return write_log(tmp_path_factory.mktemp("grid") / "short.mcap", frame_count=FRAMES)


@pytest.fixture(scope="module")
def recording(log: Path) -> Recording:
    """The short log."""
    return open_recording(log, SETUP.profile)


def observations(recording: Recording) -> list[Observation]:
    return [seen for seen in recording.observations() if isinstance(seen, Observation)]


def test_a_cell_is_the_method_alone_on_degraded_images(recording: Recording) -> None:
    """RMSE and coverage of each cell equal those of a fresh estimator fed with the condition's images."""
    conditions = [CLEAN, Condition(Degradation.NOISE, 2), Condition(Degradation.LOW_LIGHT, 5)]
    cells = degradation_grid([recording], SETUP, conditions)
    assert [cell.condition for cell in cells] == conditions
    for cell in cells:
        estimator = Measuring(SETUP.method, SETUP.profile, SETUP.mapping)
        rows = [
            estimator.estimate(cell.condition.apply(seen, frame))
            for frame, seen in enumerate(observations(recording))
        ]
        measured = [row for row in rows if row.measured]
        assert cell.figures.frame_count == FRAMES
        assert cell.figures.measured_count == len(measured)
        truth = recording.distance_track().at(np.array([row.stamp_ns for row in measured], np.int64))
        errors_m = np.array([row.distance_m for row in measured], np.float64) - truth.planar_m
        if measured:
            assert cell.figures.planar is not None
            assert cell.figures.planar.statistics.rmse == pytest.approx(np.sqrt(np.mean(errors_m**2)))
        else:
            assert cell.figures.planar is None


def test_order_and_company_change_nothing(recording: Recording) -> None:
    """A cell's figures do not depend on which other cells are measured, or in which order."""
    noise, smoke = Condition(Degradation.NOISE, 3), Condition(Degradation.SMOKE, 1)
    alone = degradation_grid([recording], SETUP, [noise])[0].figures
    among = degradation_grid([recording], SETUP, [smoke, CLEAN, noise])[2].figures
    assert alone.planar is not None
    assert among.planar is not None
    np.testing.assert_array_equal(alone.planar.pairs.estimate_m, among.planar.pairs.estimate_m)


def test_the_right_image_has_the_same_scene_and_its_own_sensor(recording: Recording) -> None:
    """Of two alike images both get the same smoke and the same glints, but noise of their own; by seed."""
    left = observations(recording)[0]
    pair = replace(left, right=RightView(left.image_bgr, left.camera, np.eye(4)))
    for kind, alike in ((Degradation.SMOKE, True), (Degradation.SPECULAR, True), (Degradation.NOISE, False)):
        condition = Condition(kind, 3)
        once, again, later = condition.apply(pair, 0), condition.apply(pair, 0), condition.apply(pair, 1)
        assert once.right is not None
        assert again.right is not None
        assert np.array_equal(once.image_bgr, once.right.image_bgr) is alike
        assert not np.array_equal(once.right.image_bgr, left.image_bgr)
        np.testing.assert_array_equal(once.image_bgr, again.image_bgr)
        np.testing.assert_array_equal(once.right.image_bgr, again.right.image_bgr)
        assert not np.array_equal(once.image_bgr, later.image_bgr)
    assert CLEAN.apply(pair, 0) is pair


def test_noise_has_its_stated_strength(recording: Recording) -> None:
    """The condition's noise is that of `degrade`: 14 levels at severity 3, away from black and white."""
    seen = observations(recording)[0]
    noisy = Condition(Degradation.NOISE, 3).apply(seen, 0).image_bgr
    middle = (seen.image_bgr > 80) & (seen.image_bgr < 176)
    difference = noisy.astype(np.float64)[middle] - seen.image_bgr[middle]
    assert difference.std() == pytest.approx(14.0, rel=0.02)
    assert degrade(seen.image_bgr, "noise", 3, 1).shape == noisy.shape


def test_conditions_are_clean_and_the_product() -> None:
    """All are 1 + 7 x 5; chosen ones keep their order and are not doubled; wrong ones are named."""
    assert len(grid_conditions()) == 36
    assert list(map(str, grid_conditions(["smoke", "noise", "smoke"], [3, 1]))) == [
        "",
        "smoke=3",
        "smoke=1",
        "noise=3",
        "noise=1",
    ]
    with pytest.raises(UsageError, match="did you mean smoke"):
        grid_conditions(["smok"], [3])
    with pytest.raises(UsageError, match="from 1 to 5, found 6"):
        grid_conditions(["smoke"], [6])


def test_progress_counts_every_measurement(recording: Recording) -> None:
    """It ends at frames x conditions, which is known from the start."""
    heard: list[tuple[int, int | None]] = []
    degradation_grid(
        [recording],
        SETUP,
        grid_conditions(["jpeg"], [1]),
        on_progress=lambda done, total: heard.append((done, total)),
    )
    assert heard == [(done, 2 * FRAMES) for done in range(1, 2 * FRAMES + 1)]


def test_without_truth_there_is_no_grid(tmp_path: Path) -> None:
    """A log without true distances is an error before any image is read."""

    def without_distance(topic: str, sample: Sample) -> Sample | None:
        return None if isinstance(sample, DistanceSample) else sample

    path = write_log(tmp_path / "blind.mcap", frame_count=2, change=without_distance)
    with pytest.raises(RecordingError, match="ground_truth_distance"):
        degradation_grid([open_recording(path, SETUP.profile)], SETUP, [CLEAN])

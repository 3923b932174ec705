"""The golden logs of worlds that are not the profile: what `fused` makes of them, against its targets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.docs_3d import REAL_LOGS
from svmdist.recording.reader import open_recording
from svmdist.results import FrameResult
from svmdist.workflows.estimate import estimate
from svmdist.workflows.setup import prepare

FRAMES = 32
"""4 s of each log: the start, and what comes after it."""


@pytest.fixture(scope="module", params=REAL_LOGS)
def measured(request: pytest.FixtureRequest, golden: Path) -> tuple[list[FrameResult], dict[str, np.ndarray]]:
    """The first rows of a log and their errors and stated deviations of spatial distance and clearance, in m."""
    setup = prepare(method="fused")
    recording = open_recording(golden / f"{request.param}.mcap", setup.profile)
    rows = []
    for row in estimate(recording, setup):
        rows.append(row)
        if len(rows) == FRAMES:
            break
    told = [row for row in rows if row.measured]
    truth = recording.distance_track().at(np.array([row.stamp_ns for row in told]))
    found = {}
    for name, true_m in (("spatial", truth.spatial_m), ("clearance", truth.clearance_m)):
        distances = [getattr(row.distances, name) for row in told]
        found[name] = np.array([one.value_m for one in distances]) - true_m
        found[f"{name}_std"] = np.array([one.std_m for one in distances])
    return rows, found


def test_nearly_every_frame_is_told(measured: tuple[list[FrameResult], dict[str, np.ndarray]]) -> None:
    rows, _ = measured
    assert sum(row.measured for row in rows) >= 0.9 * len(rows)


@pytest.mark.parametrize("distance", ["spatial", "clearance"])
def test_no_row_is_far_off_what_it_states(
    measured: tuple[list[FrameResult], dict[str, np.ndarray]], distance: str
) -> None:
    """None by more than five stated deviations, 85 % within 1.96 of them: one draw of constants is in every frame."""
    _, found = measured
    off = np.abs(found[distance]) / found[f"{distance}_std"]
    assert off.max() < 5.0
    assert np.mean(off < 1.96) >= 0.85


@pytest.mark.parametrize("distance", ["spatial", "clearance"])
def test_errors_are_what_is_stated(
    measured: tuple[list[FrameResult], dict[str, np.ndarray]], distance: str
) -> None:
    """In the mean over the squares; in `contact`, where blood covers most of the marker, both are millimetres."""
    _, found = measured
    assert np.mean(found[distance] ** 2) <= 1.5 * np.mean(found[f"{distance}_std"] ** 2)


def test_where_the_marker_is_seen_errors_are_below_a_millimetre(golden: Path) -> None:
    """Spatial distance and clearance of `random`, from a robot that is 6 cm off, over all frames."""
    setup = prepare(method="fused")
    recording = open_recording(golden / "real" / "random.mcap", setup.profile)
    rows = [row for row in estimate(recording, setup) if row.measured]
    truth = recording.distance_track().at(np.array([row.stamp_ns for row in rows]))
    for name, true_m in (("spatial", truth.spatial_m), ("clearance", truth.clearance_m)):
        error_m = np.array([getattr(row.distances, name).value_m for row in rows]) - true_m
        assert np.sqrt(np.mean(error_m**2)) < 1e-3

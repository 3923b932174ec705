"""The golden logs: what they promise, held against what is measured on them now."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import numpy as np
import pytest

from svmdist.estimation.lag import estimate_lag
from svmdist.estimation.planar.calibration import load_calibration
from svmdist.profile import load_profile, profile_path
from svmdist.recording.reader import Recording, open_recording
from svmdist.results import FrameResult
from svmdist.workflows.calibrate import calibrate
from svmdist.workflows.estimate import estimate
from svmdist.workflows.lag import predictor
from svmdist.workflows.scoring.baseline import find_regressions, load_baseline
from svmdist.workflows.scoring.score import Score
from svmdist.workflows.scoring.truth import Reference, tool_track
from svmdist.workflows.setup import Setup, prepare
from svmdist.workflows.validate import Validation
from tests.conftest import REPOSITORY
from tools.docs_3d import LOGS as LOGS_3D
from tools.docs_3d import REAL_LOGS
from tools.make_docs import BEGIN, END, LOGS, results_table, score_logs


@pytest.fixture(scope="module")
def setup() -> Setup:
    """The paper's method with the shipped calibration."""
    return prepare()


@pytest.fixture(scope="module")
def validation(setup: Setup) -> Validation:
    """All golden logs, scored once."""
    return score_logs(setup)


def _score(validation: Validation, name: str, reference: Reference = Reference.GROUND_TRUTH) -> Score:
    return next(s for s in validation.scores if s.recording == name and s.reference is reference)


def test_hashes_in_the_readme_are_those_of_the_files(golden: Path) -> None:
    """Every log is listed with its SHA-256, and no other file claims to be one."""
    text = (golden / "README.md").read_text()
    listed = dict(re.findall(r"^\| `([\w/]+)\.mcap` .*`([0-9a-f]{64})`", text, re.MULTILINE))
    found = {
        path.relative_to(golden).with_suffix("").as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in golden.rglob("*.mcap")
    }
    assert listed == found
    assert {*LOGS, *LOGS_3D, *REAL_LOGS} == set(found)


def test_sizes(golden: Path) -> None:
    """A planar log has at most 6 MB, one with both cameras 12 MB; all recordings together stay under 60 MB."""
    sizes = {path: path.stat().st_size for path in golden.rglob("*.mcap")}
    assert all(size <= (12e6 if path.parent.name in ("3d", "real") else 6e6) for path, size in sizes.items())
    assert sum(path.stat().st_size for path in golden.rglob("*")) <= 60_000_000


@pytest.mark.parametrize(
    ("name", "r_squared", "rmse_m"),
    [("sweep", 0.99, 1.0e-3), ("approach", 0.90, None), ("random", 0.90, None)],
)
@pytest.mark.parametrize("reference", [Reference.GROUND_TRUTH, Reference.KINEMATICS])
def test_targets(
    validation: Validation, name: str, r_squared: float, rmse_m: float | None, reference: Reference
) -> None:
    """The figures the project stands for, against truth and against kinematics, at 99 % coverage or more."""
    score = _score(validation, name, reference)
    assert score.statistics is not None
    assert score.statistics.r_squared is not None
    assert score.statistics.r_squared >= r_squared
    assert score.coverage >= 0.99
    assert score.frame_count >= 40
    if rmse_m is not None:
        assert score.statistics.rmse <= rmse_m


def test_contact_is_covered_and_occlusion_says_what_it_lost(validation: Validation) -> None:
    """Contact is measured throughout; in occlusion every lost frame has a reason, and those measured are right."""
    assert _score(validation, "contact").coverage >= 0.99
    occlusion = _score(validation, "occlusion")
    assert occlusion.statistics is not None
    assert occlusion.rejected_count > 0
    assert sum(occlusion.rejected.values()) + occlusion.sample_count == occlusion.frame_count
    assert occlusion.statistics.max_abs_error < 3e-3


def test_kinematics_and_truth_agree(validation: Validation) -> None:
    """Both references tell nearly the same RMSE: the encoders' error is small against the estimator's."""
    for name in LOGS:
        truth, kinematics = _score(validation, name), _score(validation, name, Reference.KINEMATICS)
        assert truth.statistics is not None
        assert kinematics.statistics is not None
        assert truth.statistics.rmse == pytest.approx(kinematics.statistics.rmse, rel=0.15)


def test_nothing_is_worse_than_the_baseline(golden: Path, validation: Validation) -> None:
    """The stored figures hold."""
    baseline = load_baseline(golden / "baseline.json")
    assert find_regressions(validation, baseline, complete=True) == []


def test_readme_table_is_what_is_measured(validation: Validation) -> None:
    """The README's results table agrees with the golden logs measured now, to one unit of the last digit."""
    text = (REPOSITORY / "README.md").read_text("utf-8")
    shown = text.partition(BEGIN)[2].partition(END)[0].strip().splitlines()
    measured = results_table(validation).strip().splitlines()
    assert len(shown) == len(measured)
    for a, b in zip(shown, measured, strict=True):
        assert re.sub(r"-?[\d.]+", "#", a) == re.sub(r"-?[\d.]+", "#", b)
        for x, y in zip(re.findall(r"-?\d+\.?\d*", a), re.findall(r"-?\d+\.?\d*", b), strict=True):
            unit = 10.0 ** -len(x.partition(".")[2])
            assert abs(float(x) - float(y)) <= 1.01 * unit, (a, b)


def test_shipped_calibration_is_reproduced(golden: Path) -> None:
    """The calibration that ships is what the calibration log gives, and was fitted on that log only."""
    profile = load_profile()
    assert profile.calibration is not None
    shipped = load_calibration(profile_path("psm13").parent / profile.calibration)
    fitted = calibrate([open_recording(golden / "calibration.mcap", profile)], profile)
    assert shipped.sources == fitted.sources
    assert shipped.camera == fitted.camera
    for axis in ("x", "y"):
        for key in ("quadratic_per_cm", "linear", "constant_cm"):
            stored, found = getattr(getattr(shipped, axis), key), getattr(getattr(fitted, axis), key)
            assert found == pytest.approx(stored, rel=1e-6, abs=1e-7)


def test_only_the_calibration_log_is_marked_as_fitted_on(validation: Validation) -> None:
    """The log the calibration came from is marked and counted in no overall figure."""
    assert {score.recording for score in validation.scores if score.fitted_on} == {"calibration"}
    overall = validation.primary
    assert overall is not None
    counted = [s for s in validation.scores if s.reference is overall.reference and not s.fitted_on]
    assert overall.sample_count == sum(score.sample_count for score in counted)


@pytest.fixture(scope="module", params=["sweep", "random"])
def measured(
    request: pytest.FixtureRequest, golden: Path, setup: Setup
) -> tuple[Recording, list[FrameResult]]:
    """A golden log of much motion, and its measured rows."""
    recording = open_recording(golden / f"{request.param}.mcap", setup.profile)
    return recording, [row for row in estimate(recording, setup) if row.measured]


@pytest.mark.parametrize("lag_s", [-2.5, -0.3137, 0.012, 2.5])
def test_an_injected_lag_is_recovered(
    measured: tuple[Recording, list[FrameResult]], setup: Setup, lag_s: float
) -> None:
    """Image stamps moved against the kinematic clock are found to 1 ms on the golden sweep and random logs."""
    recording, rows = measured
    stamps_ns = np.array([row.stamp_ns for row in rows], np.int64) + round(lag_s * 1e9)
    seen_px = np.array([row.image.tool_px for row in rows], np.float64)
    track = tool_track(recording, setup.profile, Reference.KINEMATICS)
    found = estimate_lag(stamps_ns, seen_px, predictor(track, recording.camera))
    assert found.told
    assert found.lag_s == pytest.approx(lag_s, abs=1e-3)

"""Whoever recorded a log, the same scene gives the same distances and the same figures."""

from pathlib import Path

import pytest

from svmdist.recording.log import open_recording
from svmdist.results import FrameResult
from svmdist.workflows.estimate import estimate
from svmdist.workflows.request import Request, Setup, prepare
from svmdist.workflows.scoring.references import Reference, truth_rules
from svmdist.workflows.validate import Validation, validate
from tests.measuring import flat
from tests.recording.builders import Entry
from tests.recording.other_recorders import WRITERS, Message, ros_messages
from tests.synthetic import make_scene, samples, tracked, write_log

FRAME_COUNT = 12
TOLERANCE_M = 1e-9
RULES = ("camera:tool", "camera:tissue")


@pytest.fixture(scope="module")
def messages() -> list[Message]:
    """The synthetic scene, with tool and tissue among its transforms, as messages of ROS."""
    return ros_messages(
        [Entry(name, tracked(name, sample)) for name, sample in samples(make_scene(), FRAME_COUNT)]
    )


@pytest.fixture(scope="module")
def setup(synthetic_calibration: Path) -> Setup:
    """The paper's method, calibrated on a log of the same camera."""
    return prepare(calibration=synthetic_calibration)


def measured(path: Path, setup: Setup) -> tuple[list[FrameResult], Validation]:
    """What estimate and validate say of a log; they are not told who wrote it."""
    rules = truth_rules(RULES, setup.profile, (Reference.TF, Reference.KINEMATICS))
    recording = open_recording(path, setup.profile)
    rows = list(estimate(recording, setup))
    validation = validate([recording], Request(setup, rules=rules))
    assert recording.health.is_clean
    return rows, validation


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory, setup: Setup) -> tuple[list[FrameResult], Validation]:
    """The same of the scene as svmdist writes it."""
    path = tmp_path_factory.mktemp("native") / "native.mcap"
    return measured(write_log(path, frame_count=FRAME_COUNT, change=tracked), setup)


@pytest.mark.parametrize("recorder", WRITERS)
def test_every_recorder_gives_the_same_distances(tmp_path, messages, setup, expected, recorder):
    rows, validation = measured(WRITERS[recorder](tmp_path, messages), setup)
    native_rows, native_validation = expected
    assert sum(row.measured for row in native_rows) > FRAME_COUNT // 2
    assert [(row.stamp_ns, row.status) for row in rows] == [(row.stamp_ns, row.status) for row in native_rows]
    for row, native_row in zip(rows, native_rows, strict=True):
        assert flat(row).distance_m == pytest.approx(flat(native_row).distance_m, rel=0, abs=TOLERANCE_M)
    assert len(validation.scores) == len(native_validation.scores) == 2
    for score, native_score in zip(validation.scores, native_validation.scores, strict=True):
        assert score.reference is native_score.reference
        counts = [(one.sample_count, one.unpaired_count) for one in (score, native_score)]
        assert counts[0] == counts[1]
        assert score.pairs.truth_m == pytest.approx(native_score.pairs.truth_m, rel=0, abs=TOLERANCE_M)
        assert score.statistics.rmse == pytest.approx(native_score.statistics.rmse, rel=0, abs=TOLERANCE_M)
        assert score.statistics.rmse < 1e-3
        assert score.statistics.r_squared == pytest.approx(native_score.statistics.r_squared, abs=1e-9)

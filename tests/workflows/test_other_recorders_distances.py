"""Whoever recorded a log, the same scene gives the same distances and the same figures."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import StoragePlugin

from svmdist.recording.log import open_recording
from svmdist.results import FrameResult
from svmdist.samples import Sample, TransformSample, TransformsSample
from svmdist.transforms import make_transform, rotation_z
from svmdist.workflows.estimate import estimate
from svmdist.workflows.request import Request, Setup, prepare
from svmdist.workflows.scoring.references import Reference, truth_rules
from svmdist.workflows.validate import Validation, validate
from tests.measuring import flat
from tests.recording.builders import Entry
from tests.recording.other_recorders import ros_messages, write_ros2_mcap, write_rosbag1, write_rosbag2
from tests.synthetic import START_NS, TISSUE_M, make_scene, samples, write_log

SCENE = make_scene()
FRAME_COUNT = 12
TOLERANCE_M = 1e-9
SQLITE, MCAP = StoragePlugin.SQLITE3, StoragePlugin.MCAP
LZ4 = Bag1Writer.CompressionFormat.LZ4

RECORDERS: dict[str, Callable[[Path, list[Entry]], Path]] = {
    "ros2 mcap": lambda folder, entries: write_ros2_mcap(folder / "a.mcap", ros_messages(entries)),
    "rosbag2 sqlite": lambda folder, entries: write_rosbag2(folder / "a", ros_messages(entries), SQLITE),
    "rosbag2 sqlite zstd": lambda folder, entries: write_rosbag2(
        folder / "a", ros_messages(entries), SQLITE, compressed=True
    ),
    "rosbag2 mcap": lambda folder, entries: write_rosbag2(folder / "a", ros_messages(entries), MCAP),
    "rosbag2 mcap zstd": lambda folder, entries: write_rosbag2(
        folder / "a", ros_messages(entries), MCAP, compressed=True
    ),
    "ros1 bag": lambda folder, entries: write_rosbag1(folder / "a.bag", ros_messages(entries)),
    "ros1 bag lz4": lambda folder, entries: write_rosbag1(folder / "a.bag", ros_messages(entries), LZ4),
}
RULES = ("camera:tool", "camera:tissue")


def with_tracked_tool(topic: str, sample: Sample) -> Sample:
    """Add tool and tissue to the transforms of the log, as a tracking system would publish them."""
    if topic != "/tf" or not isinstance(sample, TransformsSample):
        return sample
    seconds = (sample.stamp_ns - START_NS) / 1e9
    tool = TransformSample(sample.stamp_ns, "camera", "tool", SCENE.T_camera_tool_at(seconds))
    tissue = TransformSample(sample.stamp_ns, "camera", "tissue", make_transform(rotation_z(0.3), TISSUE_M))
    return replace(sample, transforms=(*sample.transforms, tool, tissue))


@pytest.fixture(scope="module")
def entries() -> list[Entry]:
    """The synthetic scene, with tool and tissue among its transforms."""
    found = samples(SCENE, FRAME_COUNT)
    return [Entry(topic, with_tracked_tool(topic, sample)) for topic, sample in found]


@pytest.fixture(scope="module")
def native(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scene as svmdist writes it."""
    path = tmp_path_factory.mktemp("native") / "native.mcap"
    return write_log(path, frame_count=FRAME_COUNT, change=with_tracked_tool)


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
def expected(native: Path, setup: Setup) -> tuple[list[FrameResult], Validation]:
    """The same of the native log."""
    return measured(native, setup)


@pytest.mark.parametrize("recorder", RECORDERS)
def test_every_recorder_gives_the_same_distances(tmp_path, entries, setup, expected, recorder):
    rows, validation = measured(RECORDERS[recorder](tmp_path, entries), setup)
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

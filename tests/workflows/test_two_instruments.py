"""A rendered log of two instruments: rows for each, names that hold, what is between; and one instrument as ever."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from svmdist.errors import RecordingError
from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.samples import Observation
from svmdist.workflows.compare import compare
from svmdist.workflows.estimate import estimate
from svmdist.workflows.request import Request, prepare
from svmdist.workflows.scoring.references import Reference, TruthRules
from svmdist.workflows.validate import validate
from tests.measuring import Measuring, flat
from tests.reading import read_observations

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.motion import Scenario
from svmdist.simulation.scene import Options
from svmdist.workflows.record import Recipe, record

NAMES = ("PSM1", "PSM2")
BETWEEN = "/ground_truth/PSM1/PSM2/distance"


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four frames of two arms that hardly err."""
    path = tmp_path_factory.mktemp("two") / "two.mcap"
    record(Recipe(Scenario("sweep", 5, 0.4, 10.0), load_profile(), Options(arms=2)), path)
    return path


@pytest.fixture(scope="module")
def rows(two: Path) -> list[Any]:
    setup = prepare(method="kinematic")
    return [flat(row) for row in estimate(open_recording(two, setup.profile), setup)]


def test_a_row_for_every_instrument_and_its_own_truth(two, rows):
    """Rows alternate; each instrument's distance, and place in the image, is its own to a millimetre."""
    profile = load_profile()
    recording = open_recording(two, profile)
    assert recording.instruments == NAMES
    assert [row.instrument for row in rows] == [*NAMES] * 4
    for name in NAMES:
        mine = [row for row in rows if row.instrument == name]
        stamps_ns = np.array([row.stamp_ns for row in mine])
        truth = recording.for_instrument(name).distance_track().at(stamps_ns)
        assert [row.spatial_m for row in mine] == pytest.approx(list(truth.values[:, 1]), abs=1e-3)
        tool = profile.for_instrument(name).frames.tool
        place = recording.transform_track("camera", tool, ground_truth=True).at(stamps_ns).values[:, :3, 3]
        seen = np.array([(row.tool_x_px, row.tool_y_px) for row in mine])
        np.testing.assert_allclose(seen, recording.camera.project(place), atol=6.0)


def test_what_cannot_be_named_says_so(two):
    """Colours alone do not tell which instrument is which: without kinematics each row says what is missing."""
    setup = prepare(method="shaft")
    recording = open_recording(two, setup.profile)
    unplaced = replace(recording, bases=dict.fromkeys(recording.instruments))
    for row in estimate(unplaced, setup):
        assert not row.measured
        assert f"cannot tell which instrument is {row.instrument}: no joints with transforms" in row.detail
    # Where one of both has kinematics, the other one is what is left.
    truth = recording.transform_track("camera", "PSM2_tool", ground_truth=True)
    one = replace(recording, bases=recording.bases | {"PSM2": None})
    rows = [row for row in estimate(one, setup) if row.measured and row.instrument == "PSM2"]
    assert rows
    for row in rows:
        place = truth.at(np.array([row.stamp_ns])).values[0, :3, 3]
        np.testing.assert_allclose(row.tool.pose.position_m, place, atol=5e-3)


def test_clearance_between_is_the_true_one(two, rows):
    """Within the capsules' and the poses' error of the meshes' distance; both rows say the same, opposite ways."""
    truth = open_recording(two, load_profile(), topics={"ground_truth_distance": BETWEEN}).distance_track()
    for first, second in zip(rows[::2], rows[1::2], strict=True):
        true_m = truth.at(np.array([first.stamp_ns])).values[0, 2]
        assert first.instrument_clearance_m == pytest.approx(true_m, abs=1e-3)
        assert second.instrument_clearance_m == pytest.approx(first.instrument_clearance_m, abs=1e-12)
        assert np.array(first.instrument_clearance_direction) == pytest.approx(
            -np.array(second.instrument_clearance_direction)
        )
        assert 0.01 < first.instrument_clearance_std_m < 0.2  # two arms of degrees and millimetres


def test_scores_are_per_instrument(two):
    """Validate and compare score each instrument alone, against its own truth, and never pool the two."""
    setup = prepare(method="kinematic")
    recording = open_recording(two, setup.profile)
    rules = TruthRules(references=(Reference.GROUND_TRUTH,))
    validation = validate([recording], Request(setup, rules=rules))
    assert [(s.recording, s.instrument) for s in validation.scores] == [("two", "PSM1"), ("two PSM2", "PSM2")]
    assert [(s.recording, s.instrument) for s in validation.overall] == [
        ("overall", "PSM1"),
        ("overall PSM2", "PSM2"),
    ]
    assert validation.primary.instrument == "PSM1"
    only = validate([replace(recording, wanted=("PSM2",))], Request(setup, rules=rules))
    assert [s.instrument for s in only.scores] == ["PSM2"]
    compared = compare([recording], [setup])
    assert [(str(s.group), s.instrument) for s in compared] == [("sweep", "PSM1"), ("sweep PSM2", "PSM2")]
    for score, other in zip(validation.scores, compared, strict=True):
        assert score.sample_count == other.figures.measured_count == 4
        assert score.spatial.statistics.rmse == pytest.approx(other.figures.spatial.statistics.rmse)


def test_the_command_line_names_instruments(cli, two):
    """Columns are added at the end; `--instrument` picks one; a wrong name is told with the choices."""
    command = ("estimate", two, "--method", "kinematic")
    table = cli(*command, "-f", "csv").rows
    assert [row["instrument"] for row in table] == [*NAMES] * 4
    assert all(float(row["instrument_clearance_m"]) > 0.0 for row in table)
    one = cli(*command, "-f", "json", "--instrument", "PSM2").json
    assert [row["instrument"] for row in one] == ["PSM2"] * 4
    wrong = cli("estimate", two, "--instrument", "PSM3", code=2).line
    assert "profile psm13 has no such instrument: did you mean PSM" in wrong


@pytest.mark.parametrize(
    ("name", "of"), [("PSM1", ()), *((name, ("--joints", f"/{name}/measured_js")) for name in NAMES)]
)
def test_kinematics_are_of_the_instrument_whose_joints_are_named(cli, two, name, of):
    """By its own base, transform and pose topic; without a name the first one's, which is said; what is lost, too."""
    recording = open_recording(two, load_profile()).for_instrument(name)
    base, seen = cli("fk", two, *of), cli("fk", two, "--in-camera", *of)
    stamps_ns = np.array([int(row["stamp_ns"]) for row in seen.rows])
    places = np.array([[float(row[f"{axis}_m"]) for axis in "xyz"] for row in seen.rows])
    truth = recording.transform_track("camera", recording.profile.frames.tool, ground_truth=True)
    known = np.isin(stamps_ns, truth.stamps_ns)
    true = truth.at(stamps_ns[known]).values[:, :3, 3]
    np.testing.assert_allclose(places[known], true, atol=1e-3)
    assert len(true) >= 3
    assert f"poses in frame {recording.profile.frames.base}: position RMSE 0 mm" in seen.err
    lost = len(base.rows) - len(seen.rows)
    assert lost > 0
    assert f"{lost} of {len(base.rows)} joint states are left out: no transform from camera to base" in seen.err
    assert "left out" not in base.err
    said = "note: these are the joints of PSM1; --joints TOPIC takes another's: /PSM2/measured_js"
    assert all((said in one.err) == (not of) for one in (base, seen))


def test_one_instrument_is_as_ever(synthetic_log):
    """Without the other's topics nothing changes but the new column; asking for the other is told."""
    setup = prepare(method="kinematic")
    recording = open_recording(synthetic_log, setup.profile)
    assert recording.instruments == ("PSM1",)
    # The synthetic log has one camera: what it says of the tissue is not verified.
    alone = Measuring(
        setup.method,
        setup.with_stds("tissue", plane_distance_std_m=setup.profile.tissue.unverified_std_m).profile,
    )
    plain = [alone.estimate(seen) for seen in read_observations(recording) if isinstance(seen, Observation)]
    named = [flat(row) for row in estimate(recording, setup)]
    assert all(row.instrument == "PSM1" and row.instrument_clearance_m is None for row in named)
    assert [vars(row) | {"instrument": ""} for row in named] == [vars(row) for row in plain]
    with pytest.raises(RecordingError, match="no topic of an instrument PSM2: did you mean PSM1"):
        estimate(replace(recording, wanted=("PSM2",)), setup)

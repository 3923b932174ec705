"""Estimates of others: scored as ours are, by whichever file or topic they come, and refused in one clear line."""

import csv
from collections.abc import Callable
from heapq import merge
from pathlib import Path

import numpy as np
import pytest

import svmdist
from svmdist.profile import load_profile
from svmdist.samples import PoseSample, TransformsSample
from svmdist.transforms import Array, inverse, quaternion_xyzw_from_rotation
from tests.synthetic import START_NS, make_scene, samples, write_log, write_samples

SCENE = make_scene()
FRAMES, STEP_NS = 12, 100_000_000
STAMPS_NS = [START_NS + at * STEP_NS for at in range(FRAMES)]
OFF_M = 0.002
METHOD = ("--method", "kinematic", "--truth", "ground_truth", "-f", "csv")
TRUE = ("--truth", "ground_truth", "-f", "csv")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("given") / "log.mcap", frame_count=FRAMES)


def true_poses() -> Array:
    return np.array([SCENE.T_camera_tool_at(at * STEP_NS / 1e9) for at in range(FRAMES)])


def table(path: Path, rows: list[dict[str, object]]) -> Path:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    return path


def distances(log: Path, off_m: float = OFF_M) -> list[dict[str, object]]:
    """Rows of spatial distances that are off by as much."""
    track = svmdist.open_recording(log).distance_track().at(np.array(STAMPS_NS))
    return [{"stamp_ns": ns, "spatial_m": row[1] + off_m} for ns, row in zip(STAMPS_NS, track.values, strict=True)]


def poses(T: Array, **more: object) -> list[dict[str, object]]:
    rows = []
    for ns, pose in zip(STAMPS_NS, T, strict=True):
        numbers = [ns / 1e9, *pose[:3, 3], *quaternion_xyzw_from_rotation(pose[:3, :3])]
        names = ["time", "x", "y", "z", "qx", "qy", "qz", "qw"]
        rows.append(dict(zip(names, numbers, strict=True)) | more)
    return rows


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_our_own_rows_have_our_own_score(cli, log, tmp_path, ending):
    """What `estimate` writes is scored as the method is, to the last figure; a stored baseline holds for both."""
    rows, baseline = tmp_path / f"kinematic.{ending}", tmp_path / "baseline.json"
    cli("estimate", log, "--method", "kinematic", "-o", rows)
    (ours,) = cli("validate", log, *METHOD, "--write-baseline", baseline).rows[:1]
    (theirs,) = cli("validate", log, *TRUE, "--estimates", rows, "--baseline", baseline).rows[:1]
    assert float(ours["tool_rmse_m"]) > 0.0 or float(ours["spatial_rmse_m"]) > 0.0
    for key, value in ours.items():
        try:
            assert float(theirs[key]) == pytest.approx(float(value), abs=1e-9), key
        except ValueError:
            assert theirs[key] == value, key


def test_a_trajectory_gives_errors_of_the_tool(cli, log, tmp_path):
    """TUM and CSV of poses, in the camera's or the base's frame: exact where they are true, off by what was added."""
    T = true_poses()
    T[:, 0, 3] += OFF_M
    in_base = inverse(SCENE.T_camera_base) @ T
    tum = tmp_path / "mine.tum"
    lines = (" ".join(map(str, row.values())) for row in poses(T))
    tum.write_text("# timestamp tx ty tz qx qy qz qw\n" + "\n".join(lines))
    frame_id = load_profile().frames.base
    for path in (tum, table(tmp_path / "a.csv", poses(in_base, frame_id=frame_id))):
        score = cli("validate", log, *TRUE, "--estimates", path).rows[0]
        assert score["method"] == path.stem
        assert float(score["tool_rmse_m"]) == pytest.approx(OFF_M, rel=1e-3)
        assert float(score["rotation_p95_rad"]) < 1e-6
        assert score["tool_interval_coverage"] == score["spatial_interval_coverage"] == ""
        assert int(score["sample_count"]) == FRAMES  # the tissue is where the images show it


def test_rows_find_their_frames(cli, log, tmp_path):
    """In any order and a little off in time; a frame without a row does not have its neighbour's, nor one of NaN."""
    rows = [{**row, "stamp_ns": row["stamp_ns"] + 20_000_000} for row in distances(log)]
    rows[3] |= {"spatial_m": "nan"}
    rows = [rows[5], *rows[:5], *rows[6:8], *rows[9:], rows[9]]
    outcome = cli("validate", log, *TRUE, "--estimates", table(tmp_path / "a.csv", rows))
    score = outcome.rows[0]
    assert (score["frame_count"], score["rejected"]) == (str(FRAMES), "no_estimate=1 not_finite=1")
    assert float(score["spatial_rmse_m"]) == pytest.approx(OFF_M, rel=1e-6)
    assert "1 rows have the stamp of an earlier row" in outcome.err


def millimetres(rows: list[dict[str, object]], key: str) -> list[dict[str, object]]:
    return [{"stamp_ns": row["stamp_ns"], key: 1e3 * row["spatial_m"]} for row in rows]


def test_units_are_in_names_and_wrong_ones_are_doubted(cli, log, tmp_path):
    named = table(tmp_path / "a.csv", millimetres(distances(log), "spatial_mm"))
    score = cli("validate", log, *TRUE, "--estimates", named).rows[0]
    assert float(score["spatial_rmse_m"]) == pytest.approx(OFF_M, rel=1e-6)
    wrong = table(tmp_path / "b.csv", millimetres(distances(log), "spatial_m"))
    assert "where it is in mm, name it spatial_mm" in cli("validate", log, *TRUE, "--estimates", wrong).err


@pytest.mark.parametrize("others", [(), ("clearance_m",)])
def test_what_distance_is_meant_is_said(cli, log, tmp_path, others):
    """One without a kind is scored as the planar one, as beside others, and only where it is alone it is said."""
    rows = [
        {"stamp_ns": row["stamp_ns"], **dict.fromkeys(("distance_m", *others), row["spatial_m"])}
        for row in distances(log)
    ]
    outcome = cli("validate", log, *TRUE, "--estimates", table(tmp_path / "a.csv", rows))
    said = "distance_m is taken for the planar distance; a clearance is named clearance_m"
    assert (said in outcome.err) == (not others)
    assert int(outcome.rows[0]["sample_count"]) == FRAMES


def test_a_truth_is_not_said_to_be_missing_where_one_distance_is_scored(cli, log, tmp_path):
    spatial = table(tmp_path / "a.csv", distances(log))
    assert "where there is no" not in cli("validate", log, "--truth", "ground_truth", "--estimates", spatial).out


WRONG: dict[str, tuple[Callable[[dict[str, object]], dict[str, object]], str]] = {
    "time": (lambda row: row | {"stamp_ns": row["stamp_ns"] + 10**12}, "no row is within 0.1 s"),
    "column": (lambda row: {"stamp_ns": row["stamp_ns"], "spatil": 1}, "did you mean spatial"),
    "stamp": (lambda row: {"spatial_m": 1}, "expected stamp_ns"),
    "text": (lambda row: row | {"spatial_m": "near"}, "line 2: expected a number, found 'near'"),
    "deviation": (lambda row: row | {"spatial_std_m": -1}, "negative deviation"),
    "log": (lambda row: row | {"recording": "other"}, "no row of recording log; it has other"),
    "frame": (
        lambda row: row | {"x": 0, "y": 0, "z": 0, "frame_id": "moon"},
        "a: column frame_id: no frame moon in the transforms",
    ),
}


@pytest.mark.parametrize("kind", WRONG)
def test_what_cannot_be_scored_is_one_clear_line(cli, log, tmp_path, kind):
    change, words = WRONG[kind]
    path = table(tmp_path / "a.csv", [change(row) for row in distances(log)])
    outcome = cli("validate", log, *TRUE, "--estimates", path, code=1)
    assert words in outcome.err
    assert "Traceback" not in outcome.err
    assert cli("compare", log, "--method", "kinematic", "--estimates", "topic:/nobody", code=1).line


def test_without_truth_poses_and_methods_stand_against_each_other(cli, tmp_path):
    """Poses of the log are the truth of the tool, and to the plane of distances; a pair has joint deviations."""
    topic, pairs = "/tracker/pose", list(samples(SCENE, FRAMES))
    tracked = [
        (topic, PoseSample(sample.stamp_ns, "camera", sample.transforms[0].T_parent_child))
        for name, sample in pairs
        if isinstance(sample, TransformsSample) and "ground_truth" in name
    ]
    untrue = [(name, sample) for name, sample in pairs if "ground_truth" not in name]
    log = write_samples(tmp_path / "log.mcap", merge(untrue, tracked, key=lambda pair: pair[1].stamp_ns))
    options = ("--topic", f"pose={topic}", "-f", "csv")
    scores = cli("validate", log, "--method", "kinematic", *options).rows[:2]
    assert {row["reference"] for row in scores} == {"pose", "kinematics"}
    for row in scores:
        assert float(row["tool_rmse_m"]) < 1e-6
        assert row["spatial_rmse_m"] == ""
    drawn = ("--report", tmp_path / "page.html", "--save-plot", tmp_path / "plane.png")
    by_plane = cli("validate", log, "--method", "kinematic", "--truth", "plane", *drawn, *options).rows[0]
    assert "Errors of the clearance" in (tmp_path / "page.html").read_text("utf-8")
    assert float(by_plane["spatial_rmse_m"]) < 1e-6
    assert float(by_plane["clearance_rmse_m"]) < 1e-6
    off = true_poses()
    off[:, 0, 3] += OFF_M
    mine = ("--estimates", f"mine={table(tmp_path / 'a.csv', poses(off))}", "--estimates", f"topic:{topic}")
    rows = cli("compare", log, *options, "--method", "kinematic", "--method", "fused", *mine).rows
    pairs = {(row["method"], row["against"]): row for row in rows if row["against"]}
    assert len(pairs) == 6
    assert float(pairs["mine", "kinematic"]["tool_rmse_m"]) == pytest.approx(OFF_M, rel=1e-3)
    assert float(pairs[topic, "mine"]["tool_rmse_m"]) == pytest.approx(OFF_M, rel=1e-3)
    assert pairs["mine", "kinematic"]["spatial_normalized_rmse"] == ""  # one of them states no deviation
    assert 0.0 < float(pairs["fused", "kinematic"]["spatial_normalized_rmse"]) < 1.0
    assert all(row["rmse_m"] == "" for row in rows if not row["against"])


def test_from_python_a_pose_needs_no_tissue(log, tmp_path):
    """`estimates=` in place of a method; in a profile without tissue the tool is scored alone."""
    profile = load_profile().model_copy(update={"tissue": None})
    path = table(tmp_path / "mine.csv", poses(true_poses()))
    score = svmdist.validate(svmdist.open_recording(log, profile), estimates=str(path)).primary
    assert (score.method, score.coverage, score.spatial) == ("mine", 1.0, None)
    assert score.tool.statistics.rmse < 1e-6

"""The commands and options for logs that people have: lag, truth, topics, forward kinematics, info."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svmdist.kinematics import forward_kinematics
from svmdist.profile import Limits, load_profile
from svmdist.recording.log import open_recording
from svmdist.recording.messages import Decoder, to_sample
from svmdist.recording.writer import RecordingWriter
from svmdist.samples import ImageSample, JointSample, PoseSample, Sample, TransformSample, TransformsSample
from svmdist.transforms import make_transform, quaternion_xyzw_from_rotation
from tests.cli.conftest import Cli
from tests.recording.builders import Entry
from tests.recording.other_recorders import ros_messages, write_ros2_mcap
from tests.synthetic import START_NS, TISSUE_M, make_scene, samples, write_log

SCENE = make_scene()
Logs = dict[str, list[tuple[str, Sample]]]


@pytest.fixture(scope="module")
def golden_samples(golden: Path) -> Logs:
    """All samples of two golden logs, decoded."""
    logs: Logs = {}
    for name in ("sweep", "random"):
        decoder = Decoder(Limits())
        logs[name] = []
        for raw in open_recording(golden / f"{name}.mcap", load_profile()).file.source.messages():
            logs[name].append((raw.topic, to_sample(decoder.decode(raw))))
    return logs


def write_late(path: Path, log: list[tuple[str, Sample]], lag_s: float) -> Path:
    """Copy a log with its image stamps moved; in the order of the stamps, as a recorder writes."""
    late = [
        (topic, replace(sample, stamp_ns=sample.stamp_ns + round(lag_s * 1e9)))
        if isinstance(sample, ImageSample)
        else (topic, sample)
        for topic, sample in log
    ]
    with RecordingWriter(path, {"scenario": "late"}) as writer:
        for topic, sample in sorted(late, key=lambda pair: pair[1].stamp_ns):
            writer.write(topic, sample)
    return path


def check_lag(cli: Cli, path: Path, lag_s: float) -> float:
    """The injected lag is found within 5 ms and undoes the harm; gives the error in s."""
    outcome = cli("validate", path, "--lag", "auto", "-f", "json")
    assert outcome.code == 0, outcome.err
    for score in json.loads(outcome.out)["recordings"]:
        assert score["lag_s"] == pytest.approx(lag_s, abs=5e-3)
        assert 0.5 <= score["lag_confidence"] <= 1.0
        assert score["rmse_uncorrected_m"] > 2 * score["rmse_m"]
        assert score["r_squared_uncorrected"] < 0.9 < score["r_squared"]
    return abs(float(score["lag_s"]) - lag_s)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "lag_s"), [("sweep", -2.5), ("random", 0.4)])
def test_an_injected_lag_is_recovered(
    cli: Cli, tmp_path: Path, golden_samples: Logs, name: str, lag_s: float
) -> None:
    """`--lag auto` finds by how much the image stamps are late, on the golden logs."""
    check_lag(cli, write_late(tmp_path / "late.mcap", golden_samples[name], lag_s), lag_s)


@pytest.mark.fault
@pytest.mark.parametrize("name", ["sweep", "random"])
def test_every_injected_lag_is_recovered(cli: Cli, tmp_path: Path, golden_samples: Logs, name: str) -> None:
    """The same for lags all over the range that is promised, whole frame periods and between them."""
    errors_s = []
    for number, lag_s in enumerate((-2.5, -1.7321, -0.6, -0.1234, 0.15, 0.777, 1.4142, 2.5)):
        path = write_late(tmp_path / f"{number}.mcap", golden_samples[name], lag_s)
        errors_s.append(check_lag(cli, path, lag_s))
    print(f"{name}: lag errors in ms: {np.round(np.array(errors_s) * 1e3, 2).tolist()}")


def test_a_still_tool_cannot_tell_a_lag(cli: Cli, tmp_path: Path, synthetic_calibration: Path) -> None:
    """Where nothing moves, the note says so and 0 is used."""
    still = samples(SCENE, 20)
    stamps_and_first: dict[str, Sample] = {}

    def hold(topic: str, sample: Sample) -> Sample:
        first = stamps_and_first.setdefault(topic, sample)
        moved = replace(first, stamp_ns=sample.stamp_ns)
        if isinstance(moved, TransformsSample):
            transforms = tuple(replace(one, stamp_ns=sample.stamp_ns) for one in moved.transforms)
            moved = replace(moved, transforms=transforms)
        return moved

    path = tmp_path / "still.mcap"
    with RecordingWriter(path, {}) as writer:
        for topic, sample in still:
            writer.write(topic, hold(topic, sample))
    common = ("--calibration", synthetic_calibration, "-f", "json")
    outcome = cli("validate", path, "--lag", "auto", *common)
    assert outcome.code == 0
    assert "the lag cannot be told and 0 is used" in outcome.err
    for score in json.loads(outcome.out)["recordings"]:
        assert (score["lag_s"], score["lag_confidence"]) == (0.0, 0.0)


def tracked(topic: str, sample: Sample) -> Sample:
    """Put tool and tissue among the transforms of the log."""
    if topic != "/tf" or not isinstance(sample, TransformsSample):
        return sample
    seconds = (sample.stamp_ns - START_NS) / 1e9
    poses = (("tool", SCENE.T_camera_tool_at(seconds)), ("tissue", make_transform(np.eye(3), TISSUE_M)))
    added = tuple(TransformSample(sample.stamp_ns, "camera", child, T) for child, T in poses)
    return replace(sample, transforms=(*sample.transforms, *added))


def write_with_poses(path: Path, change: Callable[[str, Sample], Sample | None] = tracked) -> Path:
    """A synthetic log with tracked tool and tissue, and a pose topic in the base frame at 100 Hz."""
    with RecordingWriter(path, {}) as writer:
        for topic, sample in samples(SCENE, 12):
            changed = change(topic, sample)
            if changed is not None:
                writer.write(topic, changed)
            if isinstance(sample, JointSample):
                T = forward_kinematics(SCENE.chain, sample.positions)
                writer.write("/PSM1/measured_cp", PoseSample(sample.stamp_ns, "base", T))
    return path


def scores(outcome_text: str) -> dict[str, dict[str, object]]:
    """The scores of a document by reference."""
    return {score["reference"]: score for score in json.loads(outcome_text)["recordings"]}


def test_the_choices_of_truth_agree(cli: Cli, tmp_path: Path, synthetic_calibration: Path) -> None:
    """Ground truth, a tf pair, a pose topic and kinematics of one exact scene give one figure."""
    path = write_with_poses(tmp_path / "a.mcap")
    common = ("validate", path, "--calibration", synthetic_calibration, "-f", "json")
    pairs = ("--truth-tf", "camera:tool", "--truth-tf", "camera:tissue")
    by_default = scores(cli(*common).out)
    assert set(by_default) == {"ground_truth", "kinematics"}
    by_pair = scores(cli(*common, *pairs).out)
    assert set(by_pair) == {"tf", "kinematics"}
    by_pose = scores(cli(*common, *pairs, "--truth", "pose").out)
    assert set(by_pose) == {"pose"}
    expected = by_default["ground_truth"]
    for score in (by_default["kinematics"], *by_pair.values(), *by_pose.values()):
        assert score["rmse_m"] == pytest.approx(expected["rmse_m"], abs=1e-9)
        assert score["sample_count"] == expected["sample_count"]


def test_a_missing_link_names_both_sides(cli: Cli, synthetic_log: Path) -> None:
    """A frame that no transform leads to is named with the frame that was asked from."""
    outcome = cli("validate", synthetic_log, "--truth", "tf", "--truth-tf", "camera:needle")
    assert outcome.code == 1
    assert "camera" in outcome.err
    assert "needle" in outcome.err
    for pair in ("camera", "camera:", "a:b:c"):
        assert cli("validate", synthetic_log, "--truth-tf", pair).code == 2


def test_truth_is_not_carried_across_long_gaps(cli: Cli, tmp_path: Path, synthetic_calibration: Path) -> None:
    """Frames in a gap of 0.35 s are unpaired by default, and paired when --max-gap allows it."""

    def with_gap(topic: str, sample: Sample) -> Sample | None:
        inside = 4.2e8 < sample.stamp_ns - START_NS < 7.5e8
        return None if topic == "/ground_truth/distance" and inside else sample

    path = write_log(tmp_path / "gap.mcap", frame_count=12, change=with_gap)
    common = (
        "validate",
        path,
        "--calibration",
        synthetic_calibration,
        "-f",
        "json",
        "--truth",
        "ground_truth",
    )
    strict = scores(cli(*common).out)["ground_truth"]
    wide = scores(cli(*common, "--max-gap", "0.4").out)["ground_truth"]
    assert (strict["unpaired_count"], wide["unpaired_count"]) == (3, 0)


def test_topics_are_chosen_and_candidates_listed(
    cli: Cli, tmp_path: Path, synthetic_calibration: Path
) -> None:
    """With two image topics the error lists both; --topic chooses; another role or topic is named."""
    entries = []
    for topic, sample in samples(SCENE, 4):
        names = ("/left/image_raw", "/right/image_raw") if isinstance(sample, ImageSample) else (topic,)
        entries += [Entry(name, sample) for name in names]
    path = write_ros2_mcap(tmp_path / "two.mcap", ros_messages(entries))
    common = ("estimate", path, "--calibration", synthetic_calibration, "-f", "csv")
    undecided = cli(*common)
    assert undecided.code == 1
    assert "/left/image_raw" in undecided.err
    assert "/right/image_raw" in undecided.err
    chosen = cli(*common, "--topic", "image=/left/image_raw")
    assert chosen.code == 0
    assert len(chosen.out.splitlines()) == 5
    for option, code in (("image=/none", 1), ("imago=/left/image_raw", 2), ("image", 2), ("image=/tf", 1)):
        outcome = cli(*common, "--topic", option)
        assert (outcome.code, outcome.out) == (code, "")
        assert "Traceback" not in outcome.err


def test_fk_prints_a_pose_for_each_joint_state(cli: Cli, tmp_path: Path) -> None:
    """CSV, JSON and TUM hold the same poses, which are the chain's; the pose topic agrees with them."""
    path = write_with_poses(tmp_path / "a.mcap")
    as_csv = cli("fk", path)
    assert as_csv.code == 0
    assert as_csv.out.startswith("stamp_ns,x_m,y_m,z_m,qx,qy,qz,qw\n")
    rows = list(csv.DictReader(io.StringIO(as_csv.out)))
    assert len(rows) == 121
    for row in rows[::40]:
        T = forward_kinematics(SCENE.chain, SCENE.joints_at((int(row["stamp_ns"]) - START_NS) / 1e9))
        position = [float(row[key]) for key in ("x_m", "y_m", "z_m")]
        quaternion = [float(row[key]) for key in ("qx", "qy", "qz", "qw")]
        np.testing.assert_allclose(position, T[:3, 3], atol=1e-12)
        np.testing.assert_allclose(quaternion, quaternion_xyzw_from_rotation(T[:3, :3]), atol=1e-12)
    as_json = json.loads(cli("fk", path, "-f", "json", "--joints", "/PSM1/measured_js").out)
    assert [{key: str(value) for key, value in row.items()} for row in as_json] == rows
    as_tum = [line.split() for line in cli("fk", path, "-f", "tum").out.splitlines()]
    assert [int(line[0].replace(".", "")) for line in as_tum] == [int(row["stamp_ns"]) for row in rows]
    assert [float(line[7]) for line in as_tum] == [float(row["qw"]) for row in rows]
    assert "against 121 poses in frame base: position RMSE" in as_csv.err
    errors_mm = float(as_csv.err.split("position RMSE ")[1].split(" mm")[0])
    assert errors_mm < 1e-9


def test_info_tells_what_a_log_can_serve(cli: Cli, tmp_path: Path, synthetic_log: Path) -> None:
    """Table, CSV and JSON name the topics with counts and rates, the frames, and the commands."""
    table = cli("info", synthetic_log)
    assert table.code == 0
    for expected in ("/ECM/left/image", "10.0", "100.0", "tissue", "blur-bench", "640x480"):
        assert expected in table.out
    document = json.loads(cli("info", synthetic_log, "-f", "json").out)
    counts = {topic["topic"]: topic["message_count"] for topic in document["topics"]}
    assert document["schema"] == "svmdist.info/1"
    assert counts["/ECM/left/image"] == 40
    assert counts["/PSM1/measured_js"] == 401
    assert document["is_clean"]
    assert all(command["served"] for command in document["commands"].values())
    assert document["instruments"] == ["PSM1"]
    assert "methods     overlay, centroid, shaft, kinematic, fused\n" in table.out
    assert "fiducial  no: it lacks the tag 36h11 0: it is in none of 8 images looked at" in table.out
    assert document["methods"]["stereo"] == {
        "served": False,
        "missing": ["a topic for right_image", "a topic for right_camera_info"],
    }
    rows = list(csv.DictReader(io.StringIO(cli("info", synthetic_log, "-f", "csv").out)))
    assert {row["topic"]: int(row["message_count"]) for row in rows} == counts

    def blind(topic: str, sample: Sample) -> Sample | None:
        return None if "image" in topic else sample

    lacking = json.loads(cli("info", write_log(tmp_path / "blind.mcap", change=blind), "-f", "json").out)
    assert lacking["commands"]["estimate"] == {"served": False, "missing": ["a topic for image"]}
    assert lacking["commands"]["fk"]["served"]


def test_info_counts_gaps_disorder_and_losses(cli: Cli, tmp_path: Path) -> None:
    """A hole and a stamp out of order are counted in their topic; a cut file is said and exits with 3."""

    def disturbed(topic: str, sample: Sample) -> Sample | None:
        at_s = (sample.stamp_ns - START_NS) / 1e9
        if topic != "/PSM1/measured_js":
            return sample
        if 0.5 < at_s < 0.7:
            return None
        return replace(sample, stamp_ns=sample.stamp_ns - 30_000_000) if at_s == 1.0 else sample

    path = write_log(tmp_path / "a.mcap", change=disturbed)
    document = json.loads(cli("info", path, "-f", "json").out)
    (joints,) = [topic for topic in document["topics"] if topic["topic"] == "/PSM1/measured_js"]
    assert (joints["gap_count"], joints["out_of_order_count"]) == (1, 1)
    assert joints["largest_gap_s"] == pytest.approx(0.2)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:-20_000])
    outcome = cli("info", cut, "-f", "json")
    assert outcome.code == 3
    assert "truncated at byte" in outcome.err
    assert not json.loads(outcome.out)["is_clean"]


def test_a_profile_limits_what_a_log_may_ask(cli: Cli, tmp_path: Path, synthetic_log: Path) -> None:
    """`[limits]` of the profile holds on the command line: what is above it is a loss."""
    from svmdist.profile import profile_path

    profile = tmp_path / "strict.toml"
    profile.write_text(profile_path("psm13").read_text("utf-8") + "\n[limits]\nimage_pixels = 1000\n")
    outcome = cli("estimate", synthetic_log, "--profile", profile, "--equations", "printed", "-f", "csv")
    assert outcome.code == 3
    assert "the limit is 1000" in outcome.err
    assert outcome.out.count("corrupt_image") == 40

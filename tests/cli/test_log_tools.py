"""Commands and options for logs that people have: lag, truth, topics, forward kinematics, info, import, profiles."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest

from svmdist.kinematics import forward_kinematics
from svmdist.profile import Limits, load_profile
from svmdist.recording.log import open_recording
from svmdist.recording.messages import Decoder, to_sample
from svmdist.samples import ImageSample, JointSample, PoseSample, Sample, TransformsSample
from svmdist.transforms import quaternion_xyzw_from_rotation
from tests.conftest import Outcome
from tests.synthetic import START_NS, make_scene, samples, tracked, without, write_log, write_samples

SCENE = make_scene()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "lag_s"), [("sweep", -2.5), ("random", 0.4)])
def test_an_injected_lag_is_recovered(cli, tmp_path, golden, name, lag_s):
    """`--lag auto` finds within 5 ms by how much the image stamps are late, and undoes the harm."""
    decoder, log = Decoder(Limits()), []
    for raw in open_recording(golden / f"{name}.mcap", load_profile()).file.source.messages():
        sample = to_sample(decoder.decode(raw))
        late_ns = round(lag_s * 1e9) if isinstance(sample, ImageSample) else 0
        log.append((raw.topic, replace(sample, stamp_ns=sample.stamp_ns + late_ns)))
    path = write_samples(tmp_path / "late.mcap", sorted(log, key=lambda pair: pair[1].stamp_ns))
    for score in cli("validate", path, "--lag", "auto", "-f", "json").json["recordings"]:
        assert score["lag_s"] == pytest.approx(lag_s, abs=5e-3)
        assert 0.5 <= score["lag_confidence"] <= 1.0
        assert score["rmse_uncorrected_m"] > 2 * score["rmse_m"]
        assert score["r_squared_uncorrected"] < 0.9 < score["r_squared"]


def test_a_still_tool_cannot_tell_a_lag(cli, tmp_path, synthetic_calibration):
    """Where nothing moves, the note says so and 0 is used."""
    first: dict[str, Sample] = {}

    def hold(topic: str, sample: Sample) -> Sample:
        held = replace(first.setdefault(topic, sample), stamp_ns=sample.stamp_ns)
        if isinstance(held, TransformsSample):
            transforms = tuple(replace(one, stamp_ns=sample.stamp_ns) for one in held.transforms)
            held = replace(held, transforms=transforms)
        return held

    path = write_log(tmp_path / "still.mcap", SCENE, change=hold)
    outcome = cli("validate", path, "--lag", "auto", "--calibration", synthetic_calibration, "-f", "json")
    assert "the lag cannot be estimated and 0 is used" in outcome.err
    for score in outcome.json["recordings"]:
        assert (score["lag_s"], score["lag_confidence"]) == (0.0, 0.0)


def with_poses() -> Iterator[tuple[str, Sample]]:
    """A synthetic log with tracked tool and tissue, and a pose topic in the base frame at 100 Hz."""
    for topic, sample in samples(SCENE, 12):
        yield topic, tracked(topic, sample)
        if isinstance(sample, JointSample):
            T = forward_kinematics(SCENE.chain, sample.positions)
            yield "/PSM1/measured_cp", PoseSample(sample.stamp_ns, "base", T)


def scores(outcome: Outcome) -> dict[str, dict[str, object]]:
    return {score["reference"]: score for score in outcome.json["recordings"]}


def test_the_choices_of_truth_agree(cli, tmp_path, synthetic_calibration):
    """Ground truth, a tf pair, a pose topic and kinematics of one exact scene give one figure; a lack is a loss."""
    path = write_samples(tmp_path / "a.mcap", with_poses())
    common = ("validate", path, "--calibration", synthetic_calibration, "-f", "json")
    pairs = ("--truth-tf", "camera:tool", "--truth-tf", "camera:tissue")
    by_default = scores(cli(*common))
    assert set(by_default) == {"ground_truth", "kinematics"}
    by_pair = scores(cli(*common, *pairs))
    assert set(by_pair) == {"tf", "kinematics"}
    by_pose = scores(cli(*common, *pairs, "--truth", "pose"))
    assert set(by_pose) == {"pose"}
    without_tf = cli(*common, "--truth-tf", "camera:none", code=3)
    assert set(scores(without_tf)) == {"kinematics"}
    assert "svmdist: loss: a: no tf to compare with: no frame none in the transforms" in without_tf.err
    expected = by_default["ground_truth"]
    for score in (by_default["kinematics"], *by_pair.values(), *by_pose.values()):
        assert score["rmse_m"] == pytest.approx(expected["rmse_m"], abs=1e-9)
        assert score["sample_count"] == expected["sample_count"]
    by_itself = cli("validate", path, "--method", "kinematic", "--truth", "pose", "--truth", "ground_truth").out
    assert by_itself.count("the tool is that of pose: of the same kinematics, whose errors do not show") == 1
    assert "the tool is that of ground_truth" not in by_itself


def test_truth_is_not_carried_across_long_gaps(cli, tmp_path, synthetic_calibration):
    """Frames in a gap of 0.35 s are unpaired by default, and paired when --max-gap allows it."""

    def with_gap(topic: str, sample: Sample) -> Sample | None:
        inside = 4.2e8 < sample.stamp_ns - START_NS < 7.5e8
        return None if topic == "/ground_truth/distance" and inside else sample

    path = write_log(tmp_path / "gap.mcap", frame_count=12, change=with_gap)
    options = ("--calibration", synthetic_calibration, "-f", "json", "--truth", "ground_truth")
    for gap, unpaired_count in (((), 3), (("--max-gap", "0.4"), 0)):
        found = scores(cli("validate", path, *options, *gap))
        assert found["ground_truth"]["unpaired_count"] == unpaired_count


def test_fk_prints_a_pose_for_each_joint_state(cli, tmp_path):
    """CSV, JSON and TUM hold the same poses, which are the chain's; the pose topic agrees with them."""
    path = write_samples(tmp_path / "a.mcap", with_poses())
    as_csv = cli("fk", path)
    rows = as_csv.rows
    assert list(rows[0]) == ["stamp_ns", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"]
    assert len(rows) == 121
    for row in rows[::40]:
        T = forward_kinematics(SCENE.chain, SCENE.joints_at((int(row["stamp_ns"]) - START_NS) / 1e9))
        position = [float(row[key]) for key in ("x_m", "y_m", "z_m")]
        quaternion = [float(row[key]) for key in ("qx", "qy", "qz", "qw")]
        np.testing.assert_allclose(position, T[:3, 3], atol=1e-12)
        np.testing.assert_allclose(quaternion, quaternion_xyzw_from_rotation(T[:3, :3]), atol=1e-12)
    as_json = cli("fk", path, "-f", "json", "--joints", "/PSM1/measured_js").json
    assert [{key: str(value) for key, value in row.items()} for row in as_json] == rows
    as_tum = [line.split() for line in cli("fk", path, "-f", "tum").out.splitlines()]
    assert [int(line[0].replace(".", "")) for line in as_tum] == [int(row["stamp_ns"]) for row in rows]
    assert [float(line[7]) for line in as_tum] == [float(row["qw"]) for row in rows]
    assert "against 121 poses in frame base: position RMSE" in as_csv.err
    assert float(as_csv.err.split("position RMSE ")[1].split(" mm")[0]) < 1e-9


def test_info_tells_what_a_log_can_serve(cli, tmp_path, synthetic_log):
    """Table, CSV and JSON name the topics with counts and rates, the frames, and the commands."""
    table = cli("info", synthetic_log)
    for expected in ("/ECM/left/image", "10.0", "100.0", "tissue", "blur-bench", "640x480"):
        assert expected in table.out
    document = cli("info", synthetic_log, "-f", "json").json
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
    rows = cli("info", synthetic_log, "-f", "csv").rows
    assert {row["topic"]: int(row["message_count"]) for row in rows} == counts
    blind = write_log(tmp_path / "blind.mcap", change=without("image"))
    lacking = cli("info", blind, "-f", "json").json
    assert lacking["commands"]["estimate"] == {"served": False, "missing": ["a topic for image"]}
    assert lacking["commands"]["fk"]["served"]
    right = ((topic.replace("left/camera_info", "right/camera_info"), one) for topic, one in samples(SCENE, 3))
    twice = (
        (topic.replace("ECM/left/image", place), one)
        for topic, one in samples(SCENE, 3)
        for place in ("one/image", "two/image")[: 1 + topic.endswith("left/image")]
    )
    unclear = write_samples(tmp_path / "unclear.mcap", twice)
    several = cli("info", unclear, blind).out
    assert "unclear: choose one with --topic image=TOPIC of /one/image (3 images), /two/image (3 images)" in several
    assert re.search(r"unclear .* –  .*\n blind .* 0  ", several)
    other = write_samples(tmp_path / "other.mcap", right)
    assert cli("info", other, "-f", "json").json["commands"]["estimate"]["missing"] == ["a topic for camera_info"]
    said = cli("estimate", other, code=1).line
    assert "profile expects /ECM/left/camera_info); /ECM/right/camera_info is the right view's" in said


def test_info_counts_gaps_and_disorder(cli, tmp_path):
    """A hole and a stamp out of order are counted in their topic."""

    def disturbed(topic: str, sample: Sample) -> Sample | None:
        at_s = (sample.stamp_ns - START_NS) / 1e9
        if topic != "/PSM1/measured_js":
            return sample
        if 0.5 < at_s < 0.7:
            return None
        return replace(sample, stamp_ns=sample.stamp_ns - 30_000_000) if at_s == 1.0 else sample

    document = cli("info", write_log(tmp_path / "a.mcap", change=disturbed), "-f", "json").json
    (joints,) = [topic for topic in document["topics"] if topic["topic"] == "/PSM1/measured_js"]
    assert (joints["gap_count"], joints["out_of_order_count"]) == (1, 1)
    assert joints["largest_gap_s"] == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("options", "baseline", "camera"),
    [
        (("--camera", "60,61,31,23"), False, "64x48, fx 60.00, fy 61.00"),
        (("--camera", "60,60,15,23", "--side-by-side"), True, "32x48, fx 60.00, fy 60.00"),
        (
            ("--camera", "120,120,63,47", "--calibrated-at", "128x96", "--crop", "4,8,50,40"),
            False,
            "50x40, fx 60.00, fy 60.00, cx 27.25, cy 15.25",
        ),
    ],
    ids=["one view", "two", "scaled and cropped"],
)
def test_images_are_imported(cli, tmp_path, options, baseline, camera):
    """The log has images and a camera, and says where it is from; what two views without a baseline lack is said."""
    images, log = tmp_path / "endoscope", tmp_path / "out.mcap"
    images.mkdir()
    for number in range(2):
        cv2.imwrite(str(images / f"img{number}.png"), np.full((48, 64, 3), 90, np.uint8))
    outcome = cli("import", images, *options, "--rate", "25", "-o", log)
    assert outcome.out == ""
    assert "2 /ECM/left/image" in outcome.err
    assert ("no baseline is known" in outcome.err) == baseline
    shown = cli("info", log).out
    assert all(part in shown for part in (camera, "imported_from endoscope", "health      clean"))
    (images / "img2.png").touch()
    said = cli("import", images, *options, "--rate", "25", "-o", log, "--force", code=3).err
    assert f"svmdist: loss: {images / 'img2.png'}: not an image that can be decoded (an empty file)\n" in said


@pytest.mark.slow
def test_a_log_that_is_much_larger_than_its_images_names_jpeg(cli, tmp_path):
    """Where they were decoded and written as PNG."""
    images, log, rng = tmp_path / "endoscope", tmp_path / "out.mcap", np.random.default_rng(1)
    images.mkdir()
    for number in range(12):
        noise = rng.integers(0, 256, (480, 640, 3), np.uint8)
        cv2.imwrite(str(images / f"{number}.jpg"), noise, (cv2.IMWRITE_JPEG_QUALITY, 30))
    common = ("import", images, "--camera", "600,600,319,239", "--rate", "25", "-o", log, "--force")
    decoded = ("--crop", "0,0,640,478")
    for options, is_said in (((), False), (decoded, True), ((*decoded, "--jpeg", "50"), False)):
        assert ("times as large as its source: --jpeg 92" in cli(*common, *options).err) == is_said


def test_exchanged_calibrations_are_said(cli, tmp_path):
    """By the names of the cameras, as ROS writes them."""
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        cv2.imwrite(str(tmp_path / side / "0.png"), np.full((48, 64, 3), 90, np.uint8))
        stated = {"camera_name": f"stereo/{side}", "camera_matrix": {"data": [60, 0, 31, 0, 60, 23, 0, 0, 1]}}
        (tmp_path / f"{side}.yaml").write_text(json.dumps(stated))
    left, right = tmp_path / "left.yaml", tmp_path / "right.yaml"
    said = "the camera of the left view is named stereo/right and the camera of the right view is named stereo/left"
    for files, is_said in (((left, right), False), ((right, left), True)):
        given = ("--calibration", files[0], "--right-calibration", files[1])
        command = ("import", tmp_path / "left", tmp_path / "right", *given, "--rate", "25", "--force")
        assert (f"{said}: exchange" in cli(*command, "-o", tmp_path / "out.mcap").err) == is_said


def test_shaft_with_a_new_profile_raises_every_alarm(cli, tmp_path, golden):
    """Also beside a tag that the profile does not name: its plate is not taken for the shaft's end."""
    log, mine = golden / "3d" / "contact.mcap", tmp_path / "mine.toml"
    cli("profile", "new", log, "-o", mine)
    truth = ("--truth", "ground_truth", "--topic", "ground_truth_distance=/ground_truth/distance")
    options = ("--profile", mine, "--method", "shaft", *truth, "--alarm-below", "5mm", "-f", "csv")
    overall = cli("validate", log, *options, "--every", 2).rows[-1]
    assert float(overall["clearance_interval_coverage"]) >= 0.9
    assert float(overall["spatial_interval_coverage"]) >= 0.9
    assert float(overall["alarm_recall"]) == 1.0


@pytest.mark.slow
def test_a_new_profile_measures(cli, tmp_path, golden):
    """`info` finds every method served, and `fused` measures with the profile as it was written."""
    log, mine = golden / "3d" / "contact.mcap", tmp_path / "mine.toml"
    outcome = cli("profile", "new", log, "-o", mine)
    assert outcome.out == ""
    assert "a distal marker by its colour; the plane from both views" in outcome.err
    assert "comparisons of the log with it: nothing contradicts" in outcome.err
    assert "shaft, stereo, kinematic, fused" in cli("info", log, "--profile", mine).out
    rows = cli("estimate", log, "--profile", mine, "--method", "fused", "-f", "csv").rows
    assert sum(row["status"] == "ok" for row in rows) > 40
    assert "exists already" in cli("profile", "new", log, "-o", mine, code=2).err
    cli("profile", "new", log, "--name", "theatre 1", "-o", mine, "--force")
    assert 'name = "theatre 1"' in mine.read_text("utf-8")

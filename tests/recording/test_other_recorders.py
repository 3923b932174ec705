"""Logs of other recorders hold the same scene; broken ones end in a result, a counted loss or a clear error."""

import re
import sqlite3
from collections.abc import Iterable
from contextlib import closing
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.errors import RecordingError
from svmdist.profile import Frames, Profile
from svmdist.recording.log import open_recording
from svmdist.recording.summary import inspect_recording
from svmdist.recording.writer import encode
from svmdist.samples import CameraSample, JointSample, Sample, TransformsSample
from tests.reading import read_observations

from .builders import CAMERA, Entry, pose, scene, write_messages, write_scene
from .other_recorders import (
    MCAP,
    SQLITE,
    WRITERS,
    header,
    rigid,
    ros_message,
    ros_messages,
    write_ros2_mcap,
    write_rosbag1,
    write_rosbag2,
)


@pytest.fixture
def folder(tmp_path: Path, entries: list[Entry]) -> Path:
    """A rosbag2 folder with SQLite storage."""
    return write_rosbag2(tmp_path / "a", ros_messages(entries), SQLITE)


@pytest.mark.parametrize("recorder", WRITERS)
def test_the_same_scene_comes_out(tmp_path, native, entries, profile, recorder):
    """Also of files whose names say nothing of their format."""
    ours = open_recording(native, profile)
    theirs = open_recording(WRITERS[recorder](tmp_path, ros_messages(entries)), profile)
    for mine, other in zip(read_observations(ours), read_observations(theirs), strict=True):
        assert mine.stamp_ns == other.stamp_ns
        np.testing.assert_array_equal(mine.image_bgr, other.image_bgr)
        np.testing.assert_array_equal(mine.joints.positions, other.joints.positions)
    for name in ("K", "D", "P"):
        np.testing.assert_array_equal(getattr(ours.camera, name), getattr(theirs.camera, name))
    assert ours.camera.frame_id == theirs.camera.frame_id
    for ground_truth in (False, True):
        mine_track = ours.transform_track("camera", "tool", ground_truth=ground_truth)
        other_track = theirs.transform_track("camera", "tool", ground_truth=ground_truth)
        np.testing.assert_array_equal(mine_track.stamps_ns, other_track.stamps_ns)
        np.testing.assert_allclose(mine_track.T_parent_child, other_track.T_parent_child, atol=1e-15)
    np.testing.assert_allclose(ours.pose_track().T_parent_child, theirs.pose_track().T_parent_child, atol=1e-15)
    np.testing.assert_array_equal(ours.joint_track().positions, theirs.joint_track().positions)
    assert theirs.health.losses == ()
    assert len(theirs.sha256()) == 64


def test_a_stamped_transform_is_a_pose(tmp_path, profile):
    fields = {
        "header": header(7, "base"),
        "child_frame_id": "tool",
        "transform": rigid(pose(3), "translation", "rotation"),
    }
    messages = [("/PSM1/measured_cp", "geometry_msgs/msg/TransformStamped", fields, 7)]
    track = open_recording(write_ros2_mcap(tmp_path / "a.mcap", messages), profile).pose_track()
    assert (track.parent, track.stamps_ns.tolist()) == ("base", [7])
    np.testing.assert_allclose(track.T_parent_child[0], pose(3), atol=1e-15)


def stamped(sample: Sample, stamp_ns: int) -> Sample:
    """A sample, and the transforms in it, at another stamp."""
    if isinstance(sample, TransformsSample):
        parts = tuple(replace(one, stamp_ns=stamp_ns) for one in sample.transforms)
        return replace(sample, stamp_ns=stamp_ns, transforms=parts)
    return replace(sample, stamp_ns=stamp_ns)


def write_logged(path: Path, entries: Iterable[tuple[Entry, int]]) -> Path:
    """Entries in protobuf, each with the time that it is logged at."""
    encoded = [(topic, encode(sample), logged_ns) for (topic, sample), logged_ns in entries]
    return write_messages(path, [(topic, one.schema, "protobuf", one.data, at_ns) for topic, one, at_ns in encoded])


def test_stamps_of_zero_in_protobuf_were_never_set_either(tmp_path, native, entries, profile):
    unset = [(Entry(topic, stamped(sample, 0)), sample.stamp_ns) for topic, sample in entries]
    log = open_recording(write_logged(tmp_path / "a.mcap", unset), profile)
    other = open_recording(native, profile)
    for track in ("joint_track", "pose_track", "distance_track"):
        np.testing.assert_array_equal(getattr(log, track)().stamps_ns, getattr(other, track)().stamps_ns)
    tracks = [one.transform_track("camera", "tool").stamps_ns for one in (log, other)]
    np.testing.assert_array_equal(*tracks)
    assert [seen.stamp_ns for seen in read_observations(log)] == tracks[0].tolist()


def camera_of(path: Path, profile: Profile, **changes: Any) -> Camera:
    """What is read of a CameraInfo with some fields changed."""
    message = ros_message(CameraSample(7, CAMERA))
    assert message is not None
    info = [("/ECM/left/camera_info", message[0], message[1] | changes, 7)]
    return open_recording(write_ros2_mcap(path, info), profile).camera


@pytest.mark.parametrize(
    ("name", "count", "model"),
    [
        *((name, 4, "fisheye") for name in ("equidistant", "fisheye", "Kannala_Brandt")),
        ("equidistant", 0, "plumb_bob"),
        ("someone's", 5, "plumb_bob"),
        ("rational_polynomial", 8, "rational_polynomial"),
    ],
)
def test_zeros_are_a_pinhole_but_for_a_fisheye(tmp_path, profile, name, count, model):
    camera = camera_of(tmp_path / "a.mcap", profile, distortion_model=name, d=np.zeros(count))
    assert (camera.distortion_model, camera.has_distortion) == (model, model == "fisheye")
    if model == "fisheye":  # r = f·θ, at 45°
        at_px = camera.project([[1.0, 0.0, 1.0]])[0] - camera.K[:2, 2]
        np.testing.assert_allclose(at_px, [camera.K[0, 0] * np.pi / 4.0, 0.0], atol=1e-9)


def test_a_part_of_a_sensor_has_its_own_pixels(tmp_path, profile):
    roi = {"x_offset": 8, "y_offset": 4, "width": 16, "height": 12, "do_rectify": False}
    P = np.column_stack([CAMERA.P[:, :3], [-0.5, 0.0, 0.0]])
    camera = camera_of(
        tmp_path / "a.mcap", profile, roi=roi, binning_x=2, binning_y=3, p=P.ravel(), distortion_model=""
    )
    assert (camera.width_px, camera.height_px) == (8, 4)
    corners_px = CAMERA.project([[0.1, 0.2, 1.0]]) + 0.5 - [8, 4]  # from the corner of the part
    np.testing.assert_allclose(camera.project([[0.1, 0.2, 1.0]]), corners_px / [2, 3] - 0.5)
    np.testing.assert_allclose(camera.P[:, :3], camera.K)
    assert camera.P[0, 3] / camera.P[0, 0] == pytest.approx(P[0, 3] / P[0, 0])


@pytest.mark.parametrize("R", [2.0 * np.eye(3), np.diag([1.0, 1.0, -1.0]), np.ones((3, 3))])
def test_a_matrix_that_is_no_rotation_is_named(tmp_path, profile, R):
    with pytest.raises(RecordingError, match=r"no usable camera calibration.*R is no rotation"):
        camera_of(tmp_path / "a.mcap", profile, r=R.ravel())
    rounded = np.array([[0.9801, -0.1987, 0.0], [0.1987, 0.9801, 0.0], [0.0, 0.0, 1.0]])
    camera_of(tmp_path / "b.mcap", profile, r=rounded.ravel())


def test_frames_are_named_without_the_slash_of_old(tmp_path, profile, entries):
    def old(value: Any) -> Any:
        if isinstance(value, dict):
            is_name = {"frame_id", "child_frame_id"}
            return {key: f"/{one}" if key in is_name else old(one) for key, one in value.items()}
        return [old(one) for one in value] if isinstance(value, list) else value

    messages = [(topic, kind, old(fields), at_ns) for topic, kind, fields, at_ns in ros_messages(entries)]
    log = open_recording(write_rosbag1(tmp_path / "a.bag", messages), profile)
    assert log.camera.frame_id == "camera"
    assert log.pose_track().parent == "base"
    assert inspect_recording(log).frames == ("camera", "tool")
    assert log.transform_track("camera", "tool").stamps_ns.size
    assert Frames(camera="/camera", base="/a/base").model_dump().items() >= {
        ("camera", "camera"),
        ("base", "a/base"),
    }


NAN = float("nan")


@pytest.mark.parametrize(
    ("reported", "rows", "loss"),
    [
        ([{"grip": 9}, {"yaw": 1, "pitch": 2}, {"grip": 9}], [[1, 2]], "2 .* yaw, pitch"),
        ([{"yaw": 1, "pitch": 2}, {"pitch": 4, "yaw": 3}], [[1, 2], [3, 4]], ""),
        ([{"grip": NAN, "yaw": 1, "pitch": 2}, {"grip": 1, "yaw": 3, "pitch": 4}], [[1, 2], [3, 4]], ""),
        ([{"grip": 1e300, "yaw": 1, "pitch": 2}] * 2, [[1, 2], [1, 2]], ""),
        ([{"yaw": 1, "pitch": NAN}, {"yaw": 3, "pitch": 4}], [[3, 4]], "1 .* no usable position of pitch"),
        ([{"yaw": NAN, "pitch": NAN}, {"yaw": 3, "pitch": 4}], [[3, 4]], "joint positions: nan"),
    ],
)  # fmt: skip
def test_the_joints_of_the_chain_are_those_that_count(tmp_path, profile, reported, rows, loss):
    """Whoever else publishes on the topic, in whatever order, and whatever other joints are."""
    samples = [JointSample(at, tuple(one), np.array([*one.values()], float)) for at, one in enumerate(reported, 1)]
    messages = ros_messages([Entry("/PSM1/measured_js", sample) for sample in samples])
    log = open_recording(write_ros2_mcap(tmp_path / "a.mcap", messages), profile)
    track = log.joint_track()
    by_stamp = np.argsort(track.stamps_ns)
    places = [track.names.index(name) for name in ("yaw", "pitch")]
    np.testing.assert_array_equal(track.positions[by_stamp][:, places], rows)
    said = "; ".join(log.health.describe())
    assert re.search(loss, said) if loss else not said
    assert set(inspect_recording(log).joint_names["/PSM1/measured_js"]) >= {"yaw", "pitch"}


def test_of_repeated_stamps_the_first_counts_whatever_it_is_of(tmp_path, profile, entries):
    """A clock that steps back: images of the first pass must not get joints and transforms of the second."""
    again = [
        one._replace(sample=replace(one.sample, positions=one.sample.positions + 1.0))
        if isinstance(one.sample, JointSample)
        else one
        for one in entries
    ]
    twice = [(one, 1 + at) for at, one in enumerate([*entries, *again])]
    log = open_recording(write_logged(tmp_path / "a.mcap", twice), profile)
    once = [one.sample.positions for one in entries if isinstance(one.sample, JointSample)]
    np.testing.assert_array_equal(log.joint_track().positions, once)
    assert "repeat a stamp; the first one counts" in " ".join(log.health.describe())


LATE_NS = 30 * 10**9


@pytest.mark.parametrize(
    ("late", "joints_s", "base_s"),
    [("", 0.0, 0.0), ("_js", 29.84, 0.0), ("/tf", 0.0, 29.84), ("logged", 0.0, 0.0)],
)
def test_what_is_near_no_image_is_told_with_how_far_the_nearest_is(tmp_path, profile, entries, late, joints_s, base_s):
    """By stamps in what is looked at; what is logged late is waited for."""
    frames = profile.frames.model_copy(update={"base": "tool"})
    shifted = [
        (
            Entry(topic, stamped(sample, sample.stamp_ns + LATE_NS * (late in topic and bool(late)))),
            sample.stamp_ns + LATE_NS * (late == "logged" and "_js" in topic),
        )
        for topic, sample in entries
    ]
    log = open_recording(
        write_logged(tmp_path / "a.mcap", sorted(shifted, key=itemgetter(1))),
        profile.model_copy(update={"frames": frames}),
    )
    found = inspect_recording(log, 0.1)
    assert (found.joints_apart_s, found.base_apart_s) == pytest.approx((joints_s, base_s))
    assert found.transforms.links("camera", "tool")
    assert len(list(log.encoded_observations())) == 5
    said = " ".join(log.remarks)
    assert ("joint states never on both sides" in said) == bool(joints_s)
    assert ("transform from the camera to the base never" in said) == bool(base_s)


def test_transforms_of_several_topics_link_nothing_before_one_is_chosen(tmp_path, profile, entries):
    several = [Entry("/tf_b" if topic == "/tf" else topic, sample) for topic, sample in entries]
    several += [Entry("/tf_a", sample) for topic, sample in entries if topic == "/tf"]
    path = write_scene(tmp_path / "a.mcap", several)
    for topics, is_linked in (({}, False), ({"tf": "/tf_b"}, True)):
        summary = inspect_recording(open_recording(path, profile, topics=topics))
        assert summary.transforms.links("camera", "tool") is is_linked
        assert {"camera", "tool"} <= set(summary.frames)


def test_a_bare_file_with_compressed_messages_says_to_open_the_folder(tmp_path, entries, profile):
    for storage, suffix in ((MCAP, "mcap"), (SQLITE, "db3")):
        folder = write_rosbag2(tmp_path / suffix, ros_messages(entries), storage, compressed=True)
        (bare,) = folder.glob(f"*.{suffix}")
        with pytest.raises(RecordingError, match="open the folder"):
            open_recording(bare, profile)


def test_a_cut_ros1_bag_names_the_command_that_repairs_it(tmp_path, profile):
    path = write_rosbag1(tmp_path / "a.bag", ros_messages(scene(20)))
    data = path.read_bytes()
    for size_bytes in (20, 4200, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:size_bytes])
        with pytest.raises(RecordingError, match=r"a ROS 1 bag that is .*rosbag reindex a\.bag$"):
            open_recording(path, profile)


def test_a_missing_part_of_a_folder_is_a_loss(folder, profile):
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("- a.db3", "- a.db3\n  - a_1.db3"))
    recording = open_recording(folder, profile)
    assert "a_1.db3" in recording.health.describe()[0]


def test_a_file_that_lacks_messages_is_a_loss(folder, profile):
    """SQLite delivers what is left without a word: the folder's counts show it."""
    with closing(sqlite3.connect(next(folder.glob("*.db3")))) as database:
        database.execute("DELETE FROM messages WHERE id > 20")
        database.commit()
    recording = open_recording(folder, profile)
    recording.joint_track()
    assert "declares" in recording.health.describe()[0]


def test_a_cut_database_is_refused_and_an_unmerged_one_is_a_loss(folder, profile):
    (file,) = folder.glob("*.db3")
    data = file.read_bytes()
    for size_bytes in (50, 5000, len(data) // 2, len(data) - 4000, len(data) - 1):
        file.write_bytes(data[:size_bytes])
        with pytest.raises(RecordingError, match=f"truncated at byte {size_bytes}"):
            open_recording(folder, profile)
    file.write_bytes(data)
    Path(f"{file}-wal").write_bytes(b"left")
    assert "a.db3-wal" in open_recording(folder, profile).health.describe()[0]


def test_an_unsupported_rosbag2_says_what_it_is(folder, profile):
    metadata = folder / "metadata.yaml"
    text = metadata.read_text()
    for changed, reason in (
        (text.replace("a.db3", "a.db3.zstd"), r"zstd -d a\.db3\.zstd"),
        (text.replace("a.db3", "a.other"), r"names, as a\.other; found a\.db3, metadata\.yaml"),
        ("a: [", "metadata.yaml is not usable"),
    ):
        metadata.write_text(changed)
        with pytest.raises(RecordingError, match=reason):
            open_recording(folder, profile)

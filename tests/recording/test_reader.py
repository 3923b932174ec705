"""The facade: clear errors at the door, broken frames as rejections, topics by role, joints at image stamps."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from svmdist.errors import RecordingError
from svmdist.profile import Profile
from svmdist.recording.log import open_recording
from svmdist.recording.source import LossKind
from svmdist.recording.writer import encode
from svmdist.samples import (
    CameraSample,
    ImageSample,
    JointSample,
    Observation,
    Rejection,
    Status,
    TransformSample,
    TransformsSample,
)
from svmdist.transforms import inverse

from .builders import CAMERA, Entry, pose, write_messages, write_scene

IMAGE = "foxglove.CompressedImage"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (None, "no such file"),
        (b"", "is empty"),
        (b"hello, this is text", "is not a recording; expected an MCAP file"),
        (b"\x89MCAP", "truncated at byte 5"),
        (gzip.compress(b"x"), "gzip-compressed"),
        (b"#ROSBAG V1.2\n", "version 1"),
        (b"version https://git-lfs.github.com/spec/v1\n", "Git LFS pointer"),
        (b"SQLite format 3\x00" + bytes(100), "no usable rosbag2 database"),
    ],
    ids=["missing", "empty", "text", "MCAP magic", "gzip", "bag of version 1", "LFS pointer", "bare SQLite"],
)
def test_what_is_no_recording_is_one_clear_line(
    tmp_path: Path, profile: Profile, content: bytes | None, reason: str
) -> None:
    path = tmp_path / "a.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(RecordingError, match=reason) as caught:
        open_recording(path, profile)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_corrupt_image_is_rejected_and_the_rest_is_read(tmp_path: Path, profile: Profile) -> None:
    good = encode(ImageSample(1, "camera", np.zeros((24, 32, 3), np.uint8)))
    last = encode(ImageSample(5, "camera", np.zeros((24, 32, 3), np.uint8)))
    small = encode(ImageSample(4, "camera", np.zeros((10, 10, 3), np.uint8)))
    broken = CompressedImage(data=CompressedImage.FromString(good).data[:-20]).SerializeToString()
    rows = [
        (
            "/ECM/left/camera_info",
            "foxglove.CameraCalibration",
            "protobuf",
            encode(CameraSample(1, CAMERA)),
            1,
        )
    ]
    rows += [
        ("/ECM/left/image", IMAGE, "protobuf", data, number)
        for number, data in enumerate((good, broken, b"\xff\xff", small, last), 1)
    ]
    recording = open_recording(write_messages(tmp_path / "a.mcap", rows), profile)
    found = list(recording.observations())
    assert [type(item) for item in found] == [Observation, Rejection, Rejection, Rejection, Observation]
    assert all(item.status is Status.CORRUPT_IMAGE for item in found if isinstance(item, Rejection))
    assert {loss.kind for loss in recording.health.losses} == {LossKind.IMAGE}
    assert {loss.topic for loss in recording.health.losses} == {"/ECM/left/image"}


def test_joints_meet_the_image_stamps_whatever_the_order_in_the_file(
    tmp_path: Path, profile: Profile
) -> None:
    """Images stamped two seconds late or early still find their joints; where there are none, there are none."""
    entries: list[Entry] = [Entry("/ECM/left/camera_info", CameraSample(0, CAMERA))]
    image = np.zeros((24, 32, 3), np.uint8)
    for step in range(1000):
        stamp_ns = step * 10_000_000
        entries.append(Entry("/PSM1/measured_js", JointSample(stamp_ns, ("a",), np.array([stamp_ns / 1e9]))))
    path = tmp_path / "a.mcap"
    for offset_ns in (-2_000_000_000, 0, 1_234_567, 2_000_000_000):
        mixed = list(entries)
        for frame in range(9, -1, -1):
            logged_ns = 500_000_000 + frame * 900_000_000
            sample = ImageSample(max(logged_ns + offset_ns, 0), "camera", image)
            mixed.insert(2 + logged_ns // 10_000_000, Entry("/ECM/left/image", sample))
        recording = open_recording(_write_in_order(path, mixed), profile)
        for item in recording.observations():
            assert isinstance(item, Observation)
            if item.stamp_ns <= 9_990_000_000:
                assert item.joints is not None
                np.testing.assert_allclose(item.joints.positions, [item.stamp_ns / 1e9], atol=1e-12)
            else:
                assert item.joints is None


def _write_in_order(path: Path, entries: list[Entry]) -> Path:
    """Write with log times that follow the order, as a recorder's clock does, beside the samples' own stamps."""
    names = {
        ImageSample: IMAGE,
        JointSample: "foxglove.JointStates",
        CameraSample: "foxglove.CameraCalibration",
    }
    rows = []
    log_time_ns = 0
    for entry in entries:
        if isinstance(entry.sample, JointSample):
            log_time_ns = entry.sample.stamp_ns
        rows.append((entry.topic, names[type(entry.sample)], "protobuf", encode(entry.sample), log_time_ns))
    return write_messages(path, rows)


def test_transforms_are_composed_along_the_tree(tmp_path: Path, profile: Profile) -> None:
    entries = []
    for number in range(10):
        stamp_ns = number * 10_000_000
        steps = {
            ("world", "camera"): pose(number),
            ("world", "base"): pose(2),
            ("base", "tool"): pose(-number),
        }
        samples = tuple(TransformSample(stamp_ns, *frames, T) for frames, T in steps.items())
        entries.append(Entry("/tf", TransformsSample(stamp_ns, samples)))
    lone = (TransformSample(0, "elsewhere", "thing", pose(1)),)
    entries.append(Entry("/tf_static", TransformsSample(0, (TransformSample(0, "tool", "tip", pose(4)),))))
    entries.append(Entry("/tf_static", TransformsSample(0, lone)))
    recording = open_recording(write_scene(tmp_path / "a.mcap", entries), profile)
    track = recording.transform_track("camera", "tip")
    assert len(track.stamps_ns) == 10
    for number, T in enumerate(track.T_parent_child):
        expected = inverse(pose(number)) @ pose(2) @ pose(-number) @ pose(4)
        np.testing.assert_allclose(T, expected, atol=1e-14)
    back = recording.transform_track("tip", "camera")
    np.testing.assert_allclose(
        back.T_parent_child @ track.T_parent_child, np.tile(np.eye(4), (10, 1, 1)), atol=1e-13
    )
    assert recording.transform_track("tool", "tip").is_static
    with pytest.raises(
        RecordingError, match=r"one side are base, camera, tip, tool, world.*other elsewhere, thing"
    ):
        recording.transform_track("camera", "thing")
    with pytest.raises(RecordingError, match=r"no frame tol.*did you mean tool"):
        recording.transform_track("camera", "tol")


def test_joint_values_that_mean_nothing_are_losses(tmp_path: Path, profile: Profile) -> None:
    samples = [
        JointSample(1, ("a",), np.array([1.0])),
        JointSample(2, ("a",), np.array([np.nan])),
        JointSample(3, ("a", "a"), np.array([1.0, 2.0])),
        JointSample(4, ("b",), np.array([1.0])),
        JointSample(5, ("a",), np.array([2.0])),
    ]
    path = write_scene(tmp_path / "a.mcap", [Entry("/PSM1/measured_js", sample) for sample in samples])
    recording = open_recording(path, profile)
    assert recording.joint_track().stamps_ns.tolist() == [1, 5]
    assert len(recording.health.losses) == 3
    assert recording.joint_track().positions[:, 0].tolist() == [1.0, 2.0]
    assert len(recording.health.losses) == 3  # a second reading finds the same losses, not more

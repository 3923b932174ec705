"""Observations that are decoded ahead in threads are the same as those decoded one by one, losses included."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from svmdist.profile import Profile
from svmdist.recording.log import Recording, open_recording
from svmdist.recording.observations import LEFT_IMAGES
from svmdist.recording.source import LossKind
from svmdist.recording.writer import encode
from svmdist.samples import CameraSample, ImageSample, Observation, Rejection

from .builders import CAMERA, scene, write_messages, write_scene
from .test_stereo import with_right
from .test_video import KEY_INTERVAL, frame_image, packets  # noqa: F401  (a fixture)

CALIBRATION, IMAGE = "foxglove.CameraCalibration", "foxglove.CompressedImage"


def decoded_backwards(recording: Recording) -> Iterator[tuple[Observation, ...] | Rejection]:
    """Decode everything in threads, hand in the losses in reverse, and give the rest in order."""
    with ThreadPoolExecutor(3) as pool:
        decoded = list(
            pool.map(lambda one: one.decode(), recording.encoded_observations(recording.instruments))
        )
    found = [recording.record_losses(one) for one in reversed(decoded)]
    return reversed(found)


def assert_same(
    mine: tuple[Observation, ...] | Rejection, other: tuple[Observation, ...] | Rejection
) -> None:
    if isinstance(mine, Rejection) or isinstance(other, Rejection):
        assert mine == other
        return
    for one, two in zip(mine, other, strict=True):
        assert one.stamp_ns == two.stamp_ns
        np.testing.assert_array_equal(one.image_bgr, two.image_bgr)
        assert (one.joints is None) == (two.joints is None)
        if one.joints is not None and two.joints is not None:
            np.testing.assert_array_equal(one.joints.positions, two.joints.positions)
        assert (one.right is None) == (two.right is None)
        if one.right is not None and two.right is not None:
            np.testing.assert_array_equal(one.right.image_bgr, two.right.image_bgr)


def damaged(path: Path) -> Path:
    """A log of 60 images, every third of them broken in a way of its own, among joints that are broken too."""
    rows = [("/ECM/left/camera_info", CALIBRATION, "protobuf", encode(CameraSample(1, CAMERA)).data, 1)]
    rng = np.random.default_rng(3)
    for frame in range(60):
        good = encode(
            ImageSample(frame + 1, "camera", np.asarray(rng.integers(0, 256, (24, 32, 3)), np.uint8))
        ).data
        data = good
        if frame % 3 == 0:
            short = CompressedImage.FromString(good)
            short.data = short.data[: -20 - frame]
            data = short.SerializeToString()
        rows.append(("/ECM/left/image", IMAGE, "protobuf", data, frame + 1))
        joints = JointStates(joints=[{"name": "a", "position": float("nan") if frame % 4 == 0 else 1.0}])
        joints.timestamp.nanos = frame + 1
        rows.append(
            (
                "/PSM1/measured_js",
                "foxglove.JointStates",
                "protobuf",
                joints.SerializeToString(),
                frame + 1,
            )
        )
    return write_messages(path, rows)


def test_threads_change_nothing(tmp_path: Path, profile: Profile) -> None:
    path = write_scene(tmp_path / "pair.mcap", with_right(scene(12)))
    one_by_one, ahead = open_recording(path, profile), open_recording(path, profile)
    for mine, other in zip(
        one_by_one.observations_of(one_by_one.instruments), decoded_backwards(ahead), strict=True
    ):
        assert_same(mine, other)


def test_losses_are_listed_in_file_order_whenever_they_are_found(tmp_path: Path, profile: Profile) -> None:
    path = damaged(tmp_path / "a.mcap")
    one_by_one, ahead = open_recording(path, profile), open_recording(path, profile)
    pairs = zip(one_by_one.observations_of(one_by_one.instruments), decoded_backwards(ahead), strict=True)
    for mine, other in pairs:
        assert_same(mine, other)
    losses = one_by_one.health.losses
    assert {loss.kind for loss in losses} == {LossKind.IMAGE, LossKind.MESSAGE}
    assert ahead.health.losses == losses


def test_what_is_not_needed_is_checked_and_left_out(tmp_path: Path, profile: Profile) -> None:
    """A planar method gets images alone; a broken joint state is a loss all the same."""
    recording = open_recording(damaged(tmp_path / "a.mcap"), profile)
    found = list(recording.observations_of(recording.instruments, LEFT_IMAGES))
    assert len(found) == 60
    assert all(item[0].joints is None for item in found if not isinstance(item, Rejection))
    assert {loss.topic for loss in recording.health.losses} == {"/ECM/left/image", "/PSM1/measured_js"}

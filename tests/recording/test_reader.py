"""The facade: joints at image stamps, transforms along the tree, and values that mean nothing."""

import numpy as np
import pytest

from svmdist.errors import RecordingError
from svmdist.recording.log import open_recording
from svmdist.recording.writer import encode
from svmdist.samples import (
    CameraSample,
    ImageSample,
    JointSample,
    TransformSample,
    TransformsSample,
)
from svmdist.transforms import Array, inverse
from tests.reading import read_observations

from .builders import CAMERA, Entry, pose, write_messages, write_scene

IMAGE = "foxglove.CompressedImage"


@pytest.mark.parametrize("offset_ns", [-2_000_000_000, 0, 1_234_567, 2_000_000_000])
def test_joints_meet_the_image_stamps_whatever_the_order_in_the_file(tmp_path, profile, offset_ns):
    """Images stamped two seconds late or early still find their joints; where there are none, there are none.

    Log times follow the order in the file, as a recorder's clock does.
    """
    rows = [("/ECM/left/camera_info", "foxglove.CameraCalibration", encode(CameraSample(0, CAMERA)).data, 0)]
    for at_ns in range(0, 10_000_000_000, 10_000_000):
        joints = encode(JointSample(at_ns, ("a",), np.array([at_ns / 1e9]))).data
        rows.append(("/PSM1/measured_js", "foxglove.JointStates", joints, at_ns))
        if at_ns % 900_000_000 == 500_000_000:
            image = ImageSample(max(at_ns + offset_ns, 0), "camera", np.zeros((24, 32, 3), np.uint8))
            rows.append(("/ECM/left/image", IMAGE, encode(image).data, at_ns))
    logged = [(topic, schema, "protobuf", data, at_ns) for topic, schema, data, at_ns in rows]
    found = list(read_observations(open_recording(write_messages(tmp_path / "a.mcap", logged), profile)))
    assert len(found) >= 9
    for item in found:
        assert (item.joints is not None) == (item.stamp_ns <= 9_990_000_000)
        if item.joints is not None:
            np.testing.assert_allclose(item.joints.positions, [item.stamp_ns / 1e9], atol=1e-12)


def test_transforms_are_composed_along_the_tree(tmp_path, profile):

    def transforms(topic: str, stamp_ns: int, *edges: tuple[str, str, Array]) -> Entry:
        samples = tuple(TransformSample(stamp_ns, *edge) for edge in edges)
        return Entry(topic, TransformsSample(stamp_ns, samples))

    entries = []
    for number in range(10):
        edges = (
            ("world", "camera", pose(number)), ("world", "base", pose(2)), ("base", "tool", pose(-number))
        )  # fmt: skip
        entries.append(transforms("/tf", number * 10_000_000, *edges))
    entries.append(transforms("/tf_static", 0, ("tool", "tip", pose(4)), ("elsewhere", "thing", pose(1))))
    recording = open_recording(write_scene(tmp_path / "a.mcap", entries), profile)
    track = recording.transform_track("camera", "tip")
    assert len(track.stamps_ns) == 10
    for number, T in enumerate(track.T_parent_child):
        expected = inverse(pose(number)) @ pose(2) @ pose(-number) @ pose(4)
        np.testing.assert_allclose(T, expected, atol=1e-14)
    back = recording.transform_track("tip", "camera")
    identities = np.tile(np.eye(4), (10, 1, 1))
    np.testing.assert_allclose(back.T_parent_child @ track.T_parent_child, identities, atol=1e-13)
    assert recording.transform_track("tool", "tip").is_static
    sides = r"one side are base, camera, tip, tool, world.*other elsewhere, thing"
    with pytest.raises(RecordingError, match=sides):
        recording.transform_track("camera", "thing")
    with pytest.raises(RecordingError, match=r"no frame tol.*did you mean tool"):
        recording.transform_track("camera", "tol")


def test_joint_values_that_mean_nothing_are_losses(tmp_path, profile):
    reported = [("a", [1.0]), ("a", [np.nan]), ("aa", [1.0, 2.0]), ("b", [1.0]), ("a", [2.0])]
    entries = [
        Entry("/PSM1/measured_js", JointSample(stamp_ns, tuple(names), np.array(values)))
        for stamp_ns, (names, values) in enumerate(reported, 1)
    ]
    recording = open_recording(write_scene(tmp_path / "a.mcap", entries), profile)
    for _ in range(2):  # a second reading finds the same losses, not more
        track = recording.joint_track()
        assert (track.stamps_ns.tolist(), track.positions[:, 0].tolist()) == ([1, 5], [1.0, 2.0])
        assert len(recording.health.losses) == 3

"""Samples out of Foxglove's protobuf messages: the values that were set, and the documented error for any other."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from svmdist.profile import Limits
from svmdist.recording.encode import encode, message_type
from svmdist.recording.ground_truth_distance_pb2 import GroundTruthDistance
from svmdist.recording.images import ImageError, VideoDecoder
from svmdist.recording.messages import foxglove
from svmdist.recording.messages.checks import MAX_JOINTS, MAX_TRANSFORMS, DecodeError
from svmdist.recording.source import RawMessage
from svmdist.samples import (
    CameraSample,
    DistanceSample,
    JointSample,
    PoseSample,
    Sample,
    TransformSample,
    TransformsSample,
)
from tests.recording.builders import CAMERA, pose

STAMP_NS, LOG_NS = 1_000_000_001, 5
LIMITS = Limits()
ROUNDING = 1e-12
"""Rotations travel as quaternions of 64 bits."""


def parsed(sample: Sample) -> object:
    """A sample written and parsed again, not yet converted."""
    raw = RawMessage("/a", message_type(type(sample)).name, "protobuf", LOG_NS, encode(sample))
    return foxglove.parse_protobuf(raw)


def test_joints_come_back() -> None:
    sample = JointSample(STAMP_NS, ("yaw", "pitch"), np.array([0.5, -1.0]))
    found = foxglove.to_joints(parsed(sample), LOG_NS)
    assert (found.stamp_ns, found.names) == (STAMP_NS, sample.names)
    np.testing.assert_array_equal(found.positions, sample.positions)


def test_a_camera_comes_back() -> None:
    found = foxglove.to_camera(parsed(CameraSample(STAMP_NS, CAMERA)), LOG_NS)
    assert found.stamp_ns == STAMP_NS
    assert (found.camera.width_px, found.camera.height_px) == (CAMERA.width_px, CAMERA.height_px)
    np.testing.assert_array_equal(found.camera.K, CAMERA.K)
    np.testing.assert_array_equal(found.camera.D, CAMERA.D)


def test_a_pose_and_transforms_come_back() -> None:
    found = foxglove.to_pose(parsed(PoseSample(STAMP_NS, "base", pose(3))), LOG_NS)
    assert (found.stamp_ns, found.frame_id) == (STAMP_NS, "base")
    np.testing.assert_allclose(found.T_frame_pose, pose(3), atol=ROUNDING)
    parts = tuple(TransformSample(STAMP_NS + n, "a", f"tool {n}", pose(n)) for n in range(3))
    stated = foxglove.to_transforms(parsed(TransformsSample(STAMP_NS, parts)), LOG_NS)
    for one, part in zip(stated.to_sample().transforms, parts, strict=True):
        assert (one.stamp_ns, one.parent, one.child) == (part.stamp_ns, part.parent, part.child)
        np.testing.assert_allclose(one.T_parent_child, part.T_parent_child, atol=ROUNDING)


def test_a_single_transform_is_a_message_of_one() -> None:
    message = FrameTransform(parent_frame_id="a", child_frame_id="b")
    message.translation.x = 0.5
    (one,) = foxglove.to_transforms(message, LOG_NS).transforms
    assert (one.stamp_ns, one.parent, one.child) == (LOG_NS, "a", "b")
    assert one.translation_m == (0.5, 0.0, 0.0)


def test_distances_come_back() -> None:
    sample = DistanceSample(STAMP_NS, 0.1, 0.2, -0.001)
    assert foxglove.to_distance(parsed(sample), LOG_NS) == sample
    with pytest.raises(DecodeError, match="a distance"):
        foxglove.to_distance(GroundTruthDistance(planar_m=math.nan), LOG_NS)


def test_a_message_without_a_stamp_has_the_log_time() -> None:
    """One that is set to zero is zero: protobuf can tell the two apart."""
    message = JointStates()
    assert foxglove.stamp_of(message, LOG_NS) == LOG_NS
    message.timestamp.SetInParent()
    assert foxglove.stamp_of(message, LOG_NS) == 0
    message.timestamp.seconds, message.timestamp.nanos = 2, 7
    assert foxglove.stamp_of(message, LOG_NS) == 2_000_000_007
    message.timestamp.seconds = 1 << 62
    with pytest.raises(DecodeError, match="out of range"):
        foxglove.stamp_of(message, LOG_NS)


def test_a_rotation_that_is_not_set_is_none_and_zeros_are_an_error() -> None:
    message = PoseInFrame(frame_id="base")
    message.pose.position.z = 2.0
    expected = np.eye(4)
    expected[2, 3] = 2.0
    np.testing.assert_array_equal(foxglove.to_pose(message, LOG_NS).T_frame_pose, expected)
    message.pose.orientation.SetInParent()
    with pytest.raises(DecodeError):
        foxglove.to_pose(message, LOG_NS)


def test_joints_without_a_position_are_left_out() -> None:
    message = JointStates()
    for name, position in (("a", 0.5), ("b", None), ("c", 0.0)):
        joint = message.joints.add(name=name)
        if position is not None:
            joint.position = position
    found = foxglove.to_joints(message, LOG_NS)
    assert found.names == ("a", "c")
    assert found.positions.tolist() == [0.5, 0.0]


def test_counts_above_the_limits_are_refused() -> None:
    joints, transforms = JointStates(), FrameTransforms()
    joints.joints.extend([type(joints.joints.add())()] * (MAX_JOINTS + 1))
    with pytest.raises(DecodeError, match="joints, the limit is"):
        foxglove.to_joints(joints, LOG_NS)
    transforms.transforms.extend([FrameTransform()] * (MAX_TRANSFORMS + 1))
    with pytest.raises(DecodeError, match="transforms, the limit is"):
        foxglove.to_transforms(transforms, LOG_NS)


@pytest.mark.parametrize("schema", sorted(foxglove.MESSAGES))
def test_bytes_that_are_no_message_are_refused(schema: str) -> None:
    for data in (b"\xff", b"\x0a\xff\xff\xff\xff\x0f", b"\x0b" * 1000):
        with pytest.raises(DecodeError, match=f"not a {schema}"):
            foxglove.parse_protobuf(RawMessage("/a", schema, "protobuf", LOG_NS, memoryview(data)))


def test_stills_and_raw_images_decode_when_asked() -> None:
    """The format of a still is not believed: its data say what they are."""
    image = np.random.default_rng(1).integers(0, 256, (4, 5, 3), np.uint8)
    png = cv2.imencode(".png", image)[1].tobytes()
    still = foxglove.to_compressed_image(
        CompressedImage(data=png, format="jpeg", frame_id="camera"), LOG_NS, LIMITS
    )
    assert (still.stamp_ns, still.frame_id, still.is_ordered) == (LOG_NS, "camera", False)
    np.testing.assert_array_equal(still.decode(), image)
    fields = {"width": 5, "height": 4, "step": 15, "data": image.tobytes()}
    raw = foxglove.to_raw_image(RawImage(encoding="bgr8", **fields), LOG_NS, LIMITS)
    np.testing.assert_array_equal(raw.decode(), image)
    with pytest.raises(ImageError, match="is not known"):
        foxglove.to_raw_image(RawImage(encoding="16UC1", **fields), LOG_NS, LIMITS).decode()


def test_a_frame_of_a_video_is_to_be_decoded_in_order() -> None:
    message = CompressedVideo(data=b"", format="vp9")
    frame = foxglove.to_video_frame(message, LOG_NS, VideoDecoder(LIMITS), 0)
    assert frame.is_ordered
    with pytest.raises(ImageError, match="'vp9' is not known"):
        frame.decode()

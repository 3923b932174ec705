"""Samples out of ROS messages: the same values from ROS 1 and ROS 2, and the documented error for any other."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from svmdist.profile import Limits
from svmdist.recording.images import ImageError
from svmdist.recording.messages import ros
from svmdist.recording.messages.checks import MAX_JOINTS, MAX_TRANSFORMS, DecodeError
from svmdist.recording.messages.ros_wire import CdrWire, Ros1Wire
from svmdist.samples import CameraSample, JointSample, PoseSample, Sample, TransformSample, TransformsSample
from tests.recording.builders import CAMERA, pose
from tests.recording.other_recorders import build, header, rigid, ros_image, ros_message

STAMP_NS, LOG_NS = 1_000_000_001, 5
LIMITS = Limits()
ROUNDING = 1e-12
"""Rotations travel as quaternions of 64 bits."""
WIRES = pytest.mark.parametrize("wire_type", [Ros1Wire, CdrWire], ids=["ROS 1", "CDR"])


def serialized(wire_type: type[Ros1Wire], type_name: str, fields: dict[str, Any]) -> bytes:
    """A message as rosbags writes it."""
    if wire_type is CdrWire:
        store = get_typestore(Stores.ROS2_HUMBLE)
        return bytes(store.serialize_cdr(build(store, type_name, fields), type_name))
    store = get_typestore(Stores.ROS1_NOETIC)
    definition = get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
    store.register(definition)
    return bytes(store.serialize_ros1(build(store, type_name, fields), type_name))


def wire_of(wire_type: type[Ros1Wire], sample: Sample) -> Ros1Wire:
    """A sample as a message."""
    message = ros_message(sample)
    assert message is not None
    return wire_type(serialized(wire_type, *message))


@WIRES
def test_joints(wire_type: type[Ros1Wire]) -> None:
    sample = JointSample(STAMP_NS, ("yaw", "pitch"), np.array([0.5, -1.0]))
    found = ros.to_joints(wire_of(wire_type, sample), LOG_NS)
    assert (found.stamp_ns, found.names) == (STAMP_NS, sample.names)
    np.testing.assert_array_equal(found.positions, sample.positions)


@WIRES
def test_a_camera(wire_type: type[Ros1Wire]) -> None:
    found = ros.to_camera(wire_of(wire_type, CameraSample(STAMP_NS, CAMERA)), LOG_NS)
    assert found.stamp_ns == STAMP_NS
    assert (found.camera.width_px, found.camera.height_px) == (CAMERA.width_px, CAMERA.height_px)
    np.testing.assert_array_equal(found.camera.K, CAMERA.K)
    np.testing.assert_array_equal(found.camera.P, CAMERA.P)


@WIRES
def test_poses_and_transforms(wire_type: type[Ros1Wire]) -> None:
    """A PoseStamped, a TransformStamped that stands for one, and a TFMessage of three."""
    found = ros.to_pose(wire_of(wire_type, PoseSample(STAMP_NS, "base", pose(3))), LOG_NS)
    assert (found.stamp_ns, found.frame_id) == (STAMP_NS, "base")
    np.testing.assert_allclose(found.T_frame_pose, pose(3), atol=ROUNDING)
    fields = {
        "header": header(STAMP_NS, "base"),
        "child_frame_id": "tool",
        "transform": rigid(pose(4), "translation", "rotation"),
    }
    data = serialized(wire_type, "geometry_msgs/msg/TransformStamped", fields)
    found = ros.to_transform_as_pose(wire_type(data), LOG_NS)
    assert (found.stamp_ns, found.frame_id) == (STAMP_NS, "base")
    np.testing.assert_allclose(found.T_frame_pose, pose(4), atol=ROUNDING)
    parts = tuple(TransformSample(STAMP_NS + n, "a", f"tool {n}", pose(n)) for n in range(3))
    stated = ros.to_transforms(wire_of(wire_type, TransformsSample(STAMP_NS, parts)), LOG_NS)
    assert stated.stamp_ns == STAMP_NS
    for one, part in zip(stated.to_sample().transforms, parts, strict=True):
        assert (one.stamp_ns, one.parent, one.child) == (part.stamp_ns, part.parent, part.child)
        np.testing.assert_allclose(one.T_parent_child, part.T_parent_child, atol=ROUNDING)


@WIRES
def test_images_decode_when_asked(wire_type: type[Ros1Wire]) -> None:
    """Pixels to the bit; an encoding that is not known is told by the image and not by its message."""
    image = np.random.default_rng(1).integers(0, 256, (4, 5, 3), np.uint8)
    head = {"header": header(STAMP_NS, "camera")}
    data = serialized(wire_type, "sensor_msgs/msg/Image", head | ros_image(image, "bgr8"))
    found = ros.to_image(wire_type(data), LOG_NS, LIMITS)
    assert (found.stamp_ns, found.frame_id, found.is_ordered) == (STAMP_NS, "camera", False)
    np.testing.assert_array_equal(found.decode(), image)
    data = serialized(wire_type, "sensor_msgs/msg/Image", head | ros_image(image, "none"))
    with pytest.raises(ImageError, match="is not known"):
        ros.to_image(wire_type(data), LOG_NS, LIMITS).decode()
    png = cv2.imencode(".png", image)[1].ravel()
    fields = head | {"format": "jpeg", "data": png}
    data = serialized(wire_type, "sensor_msgs/msg/CompressedImage", fields)
    still = ros.to_compressed_image(wire_type(data), LOG_NS, LIMITS)
    np.testing.assert_array_equal(still.decode(), image)


@WIRES
def test_a_stamp_that_was_never_set_is_the_log_time(wire_type: type[Ros1Wire]) -> None:
    sample = JointSample(0, ("a",), np.zeros(1))
    assert ros.to_joints(wire_of(wire_type, sample), LOG_NS).stamp_ns == LOG_NS
    empty = ros.to_transforms(wire_of(wire_type, TransformsSample(0, ())), LOG_NS)
    assert (empty.stamp_ns, empty.transforms) == (LOG_NS, ())


def test_a_time_before_1970_is_refused() -> None:
    with pytest.raises(DecodeError, match="out of range"):
        ros.to_joints(wire_of(CdrWire, JointSample(-1_000_000_000, ("a",), np.zeros(1))), LOG_NS)


@WIRES
def test_counts_above_the_limits_are_refused_before_they_are_read(wire_type: type[Ros1Wire]) -> None:
    """The message holds nothing of what it counts."""
    head = b"\0\1\0\0" * (wire_type is CdrWire)
    many = (MAX_TRANSFORMS + 1).to_bytes(4, "little")
    with pytest.raises(DecodeError, match=f"{MAX_TRANSFORMS + 1} elements, the limit is"):
        ros.to_transforms(wire_type(head + many), LOG_NS)
    data = serialized(
        wire_type,
        "sensor_msgs/msg/JointState",
        {"header": header(1, ""), "name": [], "position": np.zeros(0)}
        | {"velocity": np.zeros(0), "effort": np.zeros(0)},
    )
    place = len(data) - 16  # four empty sequences
    broken = data[:place] + (MAX_JOINTS + 1).to_bytes(4, "little") + data[place + 4 :]
    with pytest.raises(DecodeError, match=f"{MAX_JOINTS + 1} elements, the limit is"):
        ros.to_joints(wire_type(broken), LOG_NS)


@WIRES
def test_values_that_mean_nothing_are_refused(wire_type: type[Ros1Wire]) -> None:
    """A rotation of zeros, a number that is not one, joints that repeat."""
    stamped = {"header": header(STAMP_NS, "base")}
    still = rigid(np.eye(4), "position", "orientation")
    no_rotation = still | {"orientation": dict.fromkeys("xyzw", 0.0)}
    no_number = still | {"position": dict.fromkeys("xyz", float("nan"))}
    for broken in (no_rotation, no_number):
        data = serialized(wire_type, "geometry_msgs/msg/PoseStamped", stamped | {"pose": broken})
        with pytest.raises(DecodeError):
            ros.to_pose(wire_type(data), LOG_NS)
    with pytest.raises(DecodeError, match="names repeat"):
        ros.to_joints(wire_of(wire_type, JointSample(1, ("a", "a"), np.zeros(2))), LOG_NS)

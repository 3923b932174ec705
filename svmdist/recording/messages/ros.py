"""Samples out of the ROS messages that svmdist understands, the same for ROS 1 and ROS 2.

The layouts are written down here rather than taken from the definitions in a file: they are fixed by
ROS, and a parser that follows a file's own description can be led anywhere.
"""

from __future__ import annotations

from svmdist.profile import Limits
from svmdist.recording.images import decode_raw, decode_still
from svmdist.recording.messages.checks import (
    MAX_JOINTS,
    MAX_TRANSFORMS,
    DecodeError,
    EncodedImage,
    RawTransform,
    RawTransforms,
    checked_camera,
    checked_joints,
    checked_stamp_ns,
    checked_transform,
)
from svmdist.recording.messages.ros_wire import Ros1Wire
from svmdist.samples import CameraSample, JointSample, PoseSample


def to_image(wire: Ros1Wire, log_time_ns: int, limits: Limits) -> EncodedImage:
    """Read a sensor_msgs/Image."""
    stamp_ns, frame_id = _header(wire, log_time_ns)
    height_px, width_px = wire.u32(), wire.u32()
    encoding = wire.text()
    wire.u8()  # the byte order, which images of 8 bits do not have
    step_bytes = wire.u32()
    data = bytes(wire.octets())
    return EncodedImage(
        stamp_ns, frame_id, lambda: decode_raw(encoding, (width_px, height_px), step_bytes, data, limits)
    )


def to_compressed_image(wire: Ros1Wire, log_time_ns: int, limits: Limits) -> EncodedImage:
    """Read a sensor_msgs/CompressedImage."""
    stamp_ns, frame_id = _header(wire, log_time_ns)
    wire.text()  # the format; the data say themselves what they are
    data = bytes(wire.octets())
    return EncodedImage(stamp_ns, frame_id, lambda: decode_still(data, limits))


def to_camera(wire: Ros1Wire, log_time_ns: int) -> CameraSample:
    """Read a sensor_msgs/CameraInfo."""
    stamp_ns, frame_id = _header(wire, log_time_ns)
    height_px, width_px = wire.u32(), wire.u32()
    model = wire.text()
    D, K, R, P = wire.float_sequence(), wire.floats(9), wire.floats(9), wire.floats(12)
    size_px = (width_px, height_px)
    camera = checked_camera(size_px, K.tolist(), D.tolist(), R.tolist(), P.tolist(), frame_id, model)
    return CameraSample(stamp_ns, camera)


def to_joints(wire: Ros1Wire, log_time_ns: int) -> JointSample:
    """Read a sensor_msgs/JointState."""
    stamp_ns, _ = _header(wire, log_time_ns)
    count = _checked_count(wire.u32(), MAX_JOINTS)
    names = [wire.text() for _ in range(count)]
    return checked_joints(stamp_ns, names, wire.float_sequence().tolist())


def to_transforms(wire: Ros1Wire, log_time_ns: int) -> RawTransforms:
    """Read a tf2_msgs/TFMessage."""
    count = _checked_count(wire.u32(), MAX_TRANSFORMS)
    transforms = tuple(_stamped_transform(wire, log_time_ns) for _ in range(count))
    first_ns = transforms[0].stamp_ns if transforms else checked_stamp_ns(log_time_ns)
    return RawTransforms(first_ns, transforms)


def to_transform_as_pose(wire: Ros1Wire, log_time_ns: int) -> PoseSample:
    """Read a geometry_msgs/TransformStamped as the pose of its child, as older CRTK publishes `*_cp`."""
    transform = _stamped_transform(wire, log_time_ns)
    return PoseSample(transform.stamp_ns, transform.parent, transform.T_parent_child)


def to_pose(wire: Ros1Wire, log_time_ns: int) -> PoseSample:
    """Read a geometry_msgs/PoseStamped."""
    transform = _transform(wire, *_header(wire, log_time_ns), "")
    return PoseSample(transform.stamp_ns, transform.parent, transform.T_parent_child)


def _stamped_transform(wire: Ros1Wire, log_time_ns: int) -> RawTransform:
    stamp_ns, parent = _header(wire, log_time_ns)
    return _transform(wire, stamp_ns, parent, wire.text())


def _transform(wire: Ros1Wire, stamp_ns: int, parent: str, child: str) -> RawTransform:
    tx, ty, tz, qx, qy, qz, qw = wire.floats(7).tolist()
    return checked_transform(stamp_ns, parent, child, (tx, ty, tz), (qx, qy, qz, qw))


def _header(wire: Ros1Wire, log_time_ns: int) -> tuple[int, str]:
    """Read a header; a stamp of zero is one that was never set, and the log time stands for it."""
    stamp_ns, frame_id = wire.header()
    return checked_stamp_ns(stamp_ns or log_time_ns), frame_id


def _checked_count(count: int, limit: int) -> int:
    if count > limit:
        raise DecodeError(f"{count} elements, the limit is {limit}")
    return count

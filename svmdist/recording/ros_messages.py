"""Messages of ROS 1 and ROS 2, read with the types of the `rosbags` library."""

from __future__ import annotations

from functools import cache
from typing import Any

from svmdist.recording import messages
from svmdist.samples import JointSample


@cache
def _types(encoding: str) -> Any:
    """The types of ROS, imported when the first of its messages is read."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if encoding == "cdr":
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(
        get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
    )
    return store


def decode_ros(encoding: str, schema: str, data: bytes, log_time_ns: int) -> messages.Message:
    """Decode a message of ROS 1 (`ros1`) or ROS 2 (`cdr`), whose schema is named without `/msg/`."""
    package, _, name = ("tf2_msgs/TFMessage" if schema == "tf/tfMessage" else schema).partition("/")
    types = _types(encoding)
    if encoding == "cdr" and data[:2] not in (b"\0\0", b"\0\1"):
        raise messages.DecodeError(f"not plain CDR: it begins with {data[:2].hex(' ')}")
    read = types.deserialize_cdr if encoding == "cdr" else types.deserialize_ros1
    try:
        message = read(data, f"{package}/msg/{name}")
    except Exception as problem:  # of the library: an error of its own, or of struct, NumPy and text
        raise messages.DecodeError(f"not a {schema}: {' '.join(str(problem).split())}") from None
    if name == "TFMessage":
        stamped = [_stamped(one, *_header(one, log_time_ns)) for one in message.transforms]
        return messages.transforms_of(stamped, log_time_ns)
    return CONVERTERS[name](message, *_header(message, log_time_ns))


def _header(message: Any, log_time_ns: int) -> tuple[int, str]:
    """Stamp and frame of a header; a stamp of zero was never set, and the log time stands for it."""
    header = message.header
    own_ns = header.stamp.sec * messages.NS + header.stamp.nanosec
    return messages.checked_stamp(own_ns or log_time_ns), header.frame_id


def _joints(message: Any, stamp_ns: int, _: str) -> JointSample:
    return messages.checked_joints(stamp_ns, message.name, message.position.tolist())


def _stamped(message: Any, stamp_ns: int, parent: str) -> messages.RawTransform:
    """A TransformStamped; as a topic of its own it is the pose of its child, as older CRTK publishes `*_cp`."""
    transform = message.transform
    return messages.checked_transform(
        stamp_ns, parent, message.child_frame_id, transform.translation, transform.rotation
    )


def _pose(message: Any, stamp_ns: int, parent: str) -> messages.RawTransform:
    return messages.checked_transform(stamp_ns, parent, "", message.pose.position, message.pose.orientation)


CONVERTERS: dict[str, messages.Converter] = {
    "Image": messages.raw_image,
    "CompressedImage": messages.still_image,
    "CameraInfo": messages.camera_sample,
    "JointState": _joints,
    "PoseStamped": _pose,
    "TransformStamped": _stamped,
}

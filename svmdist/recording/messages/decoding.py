"""From raw messages to samples: which schemas are understood, and what each one becomes."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from typing import Any

from svmdist.profile import Limits
from svmdist.recording.images import VideoDecoder
from svmdist.recording.messages import foxglove, ros
from svmdist.recording.messages.checks import DecodeError, EncodedImage, RawTransforms, checked_stamp_ns
from svmdist.recording.messages.foxglove_json import parse_json
from svmdist.recording.messages.ros_wire import CdrWire, Ros1Wire
from svmdist.recording.source import RawMessage
from svmdist.samples import Sample


class Kind(StrEnum):
    """What a topic carries, whatever its encoding."""

    IMAGE = "images"
    CAMERA = "camera calibrations"
    JOINTS = "joint states"
    POSE = "poses"
    TRANSFORMS = "transforms"
    DISTANCE = "true distances"


Message = Sample | EncodedImage | RawTransforms
"""What a message becomes: images stay encoded, and transforms have no matrices, until these are asked for."""
Converter = Callable[..., Message]

FOXGLOVE: dict[str, tuple[Kind, Converter]] = {
    "foxglove.CompressedImage": (Kind.IMAGE, foxglove.to_compressed_image),
    "foxglove.RawImage": (Kind.IMAGE, foxglove.to_raw_image),
    "foxglove.CompressedVideo": (Kind.IMAGE, foxglove.to_video_frame),
    "foxglove.CameraCalibration": (Kind.CAMERA, foxglove.to_camera),
    "foxglove.JointStates": (Kind.JOINTS, foxglove.to_joints),
    "foxglove.PoseInFrame": (Kind.POSE, foxglove.to_pose),
    "foxglove.FrameTransform": (Kind.TRANSFORMS, foxglove.to_transforms),
    "foxglove.FrameTransforms": (Kind.TRANSFORMS, foxglove.to_transforms),
    "svmdist.GroundTruthDistance": (Kind.DISTANCE, foxglove.to_distance),
}
ROS: dict[str, tuple[Kind, Converter]] = {
    "sensor_msgs/Image": (Kind.IMAGE, ros.to_image),
    "sensor_msgs/CompressedImage": (Kind.IMAGE, ros.to_compressed_image),
    "sensor_msgs/CameraInfo": (Kind.CAMERA, ros.to_camera),
    "sensor_msgs/JointState": (Kind.JOINTS, ros.to_joints),
    "geometry_msgs/PoseStamped": (Kind.POSE, ros.to_pose),
    "geometry_msgs/TransformStamped": (Kind.POSE, ros.to_transform_as_pose),
    "tf2_msgs/TFMessage": (Kind.TRANSFORMS, ros.to_transforms),
    "tf/tfMessage": (Kind.TRANSFORMS, ros.to_transforms),
}
SCHEMAS = {"protobuf": FOXGLOVE, "json": FOXGLOVE, "cdr": ROS, "ros1": ROS}
WIRES = {"cdr": CdrWire, "ros1": Ros1Wire}


def kind_of(schema: str, message_encoding: str) -> Kind | None:
    """Tell what a topic carries; None for a schema or an encoding that svmdist does not read."""
    found = SCHEMAS.get(message_encoding, {}).get(_short(schema))
    return None if found is None else found[0]


class Decoder:
    """Turns the messages of one pass over a log into samples; videos need one that goes on."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._videos: dict[str, VideoDecoder] = {}
        self._failure_count = 0

    def decode(self, raw: RawMessage) -> Sample | EncodedImage:
        """Turn a message into a sample; the pixels of an image stay encoded until they are asked for.

        Raises DecodeError for a message that is too large, malformed, or holds values that mean nothing.
        """
        message = self.read(raw)
        return message.to_sample() if isinstance(message, RawTransforms) else message

    def read(self, raw: RawMessage) -> Message:
        """Read and check a message as `decode` does, without the matrices of transforms."""
        try:
            return self._decode(raw)
        except DecodeError:
            self._failure_count += 1
            raise

    def _decode(self, raw: RawMessage) -> Message:
        checked_stamp_ns(raw.log_time_ns)
        found = SCHEMAS.get(raw.message_encoding, {}).get(_short(raw.schema))
        if found is None:
            raise DecodeError(
                f"schema {raw.schema!r} in {raw.message_encoding!r} is not one that svmdist reads"
            )
        kind, convert = found
        limit = self._limit_bytes(kind, raw)
        if len(raw.data) > limit:
            raise DecodeError(f"a message of {len(raw.data)} bytes, the limit is {limit}")
        message = self._parse(raw)
        if kind is not Kind.IMAGE:
            return convert(message, raw.log_time_ns)
        if convert is foxglove.to_video_frame:
            video = self._videos.setdefault(raw.topic, VideoDecoder(self._limits))
            return convert(message, raw.log_time_ns, video, raw.losses_before + self._failure_count)
        return convert(message, raw.log_time_ns, self._limits)

    def _parse(self, raw: RawMessage) -> Any:
        if raw.message_encoding in WIRES:
            return WIRES[raw.message_encoding](raw.data)
        return parse_json(raw) if raw.message_encoding == "json" else foxglove.parse_protobuf(raw)

    def _limit_bytes(self, kind: Kind, raw: RawMessage) -> int:
        if kind is not Kind.IMAGE:
            return self._limits.message_bytes
        if raw.message_encoding == "json":
            return self._limits.json_bytes
        # The fields around the pixels take less than a message that has none.
        is_raw = _short(raw.schema) in {"foxglove.RawImage", "sensor_msgs/Image"}
        pixels = 4 * self._limits.image_pixels if is_raw else self._limits.image_bytes
        return pixels + self._limits.message_bytes


def _short(schema: str) -> str:
    """Leave out the `/msg/` of ROS 2, which ROS 1 and some recorders do not write."""
    return schema.replace("/msg/", "/", 1)

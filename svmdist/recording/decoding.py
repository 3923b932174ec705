"""From raw messages to samples: which schemas are understood, and what each one becomes."""

from __future__ import annotations

from enum import StrEnum
from typing import Any

from svmdist.recording import foxglove
from svmdist.recording.checks import DecodeError, EncodedImage, checked_stamp_ns
from svmdist.recording.limits import Limits
from svmdist.recording.sources import RawMessage
from svmdist.samples import Sample


class Kind(StrEnum):
    """What a topic carries, whatever its encoding."""

    IMAGE = "images"
    CAMERA = "camera calibrations"
    JOINTS = "joint states"
    POSE = "poses"
    TRANSFORMS = "transforms"
    DISTANCE = "true distances"


FOXGLOVE_KINDS = {
    "foxglove.CompressedImage": Kind.IMAGE,
    "foxglove.CameraCalibration": Kind.CAMERA,
    "foxglove.JointStates": Kind.JOINTS,
    "foxglove.PoseInFrame": Kind.POSE,
    "foxglove.FrameTransform": Kind.TRANSFORMS,
    "foxglove.FrameTransforms": Kind.TRANSFORMS,
    "svmdist.GroundTruthDistance": Kind.DISTANCE,
}


def kind_of(schema: str, message_encoding: str) -> Kind | None:
    """Tell what a topic carries; None for a schema or an encoding that svmdist does not read."""
    return FOXGLOVE_KINDS.get(schema) if message_encoding == "protobuf" else None


def decode(raw: RawMessage, limits: Limits) -> Sample | EncodedImage:
    """Turn a message into a sample; the pixels of an image stay encoded until they are asked for.

    Raises DecodeError for a message that is too large, malformed, or holds values that mean nothing.
    """
    checked_stamp_ns(raw.log_time_ns)
    kind = kind_of(raw.schema, raw.message_encoding)
    # The fields around an image take less than the smallest limit.
    limit = limits.message_bytes + (limits.image_bytes if kind is Kind.IMAGE else 0)
    if len(raw.data) > limit:
        raise DecodeError(f"a message of {len(raw.data)} bytes, the limit is {limit}")
    message = foxglove.parse_protobuf(raw)
    return _convert(kind, message, raw.log_time_ns, limits)


def _convert(kind: Kind | None, message: Any, log_time_ns: int, limits: Limits) -> Sample | EncodedImage:
    match kind:
        case Kind.IMAGE:
            return foxglove.to_compressed_image(message, log_time_ns, limits)
        case Kind.CAMERA:
            return foxglove.to_camera(message, log_time_ns)
        case Kind.JOINTS:
            return foxglove.to_joints(message, log_time_ns)
        case Kind.POSE:
            return foxglove.to_pose(message, log_time_ns)
        case Kind.TRANSFORMS:
            return foxglove.to_transforms(message, log_time_ns)
        case Kind.DISTANCE:
            return foxglove.to_distance(message, log_time_ns)
        case None:
            raise DecodeError("the schema is not one that svmdist reads")

"""Samples out of Foxglove's messages, and out of svmdist's own, as protobuf objects."""

from __future__ import annotations

from typing import Any

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError as ProtobufError

from svmdist.profile import Limits
from svmdist.recording.ground_truth_distance_pb2 import GroundTruthDistance
from svmdist.recording.images import VideoDecoder, decode_raw, decode_still
from svmdist.recording.messages.checks import (
    MAX_JOINTS,
    MAX_TRANSFORMS,
    NS,
    DecodeError,
    EncodedImage,
    Quaternion,
    RawTransforms,
    check_numbers,
    checked_camera,
    checked_joints,
    checked_stamp_ns,
    checked_transform,
)
from svmdist.recording.source import RawMessage
from svmdist.samples import (
    CameraSample,
    DistanceSample,
    JointSample,
    PoseSample,
    Vector,
)

IDENTITY_XYZW = (0.0, 0.0, 0.0, 1.0)
MESSAGES: dict[str, Any] = {
    message.DESCRIPTOR.full_name: message
    for message in (
        CompressedImage,
        CompressedVideo,
        RawImage,
        CameraCalibration,
        JointStates,
        PoseInFrame,
        FrameTransform,
        FrameTransforms,
        GroundTruthDistance,
    )
}


def parse_protobuf(raw: RawMessage) -> Any:
    """Parse the bytes as the message that the schema names; DecodeError when they are none."""
    try:
        return MESSAGES[raw.schema].FromString(bytes(raw.data))
    except (ProtobufError, RecursionError, UnicodeDecodeError, ValueError) as problem:
        raise DecodeError(f"not a {raw.schema}: {problem}") from None


def stamp_of(message: Any, log_time_ns: int) -> int:
    """Take the message's own stamp in ns, or the log time where it has none."""
    if not message.HasField("timestamp"):
        return checked_stamp_ns(log_time_ns)
    return checked_stamp_ns(message.timestamp.seconds * NS + message.timestamp.nanos)


def to_compressed_image(message: Any, log_time_ns: int, limits: Limits) -> EncodedImage:
    """Take over a foxglove.CompressedImage; its `format` is ignored, for the data say what they are."""
    data = message.data
    return EncodedImage(stamp_of(message, log_time_ns), message.frame_id, lambda: decode_still(data, limits))


def to_raw_image(message: Any, log_time_ns: int, limits: Limits) -> EncodedImage:
    """Take over a foxglove.RawImage."""
    size_px = (message.width, message.height)
    encoding, step_bytes, data = message.encoding, message.step, message.data
    return EncodedImage(
        stamp_of(message, log_time_ns),
        message.frame_id,
        lambda: decode_raw(encoding, size_px, step_bytes, data, limits),
    )


def to_video_frame(message: Any, log_time_ns: int, video: VideoDecoder, loss_count: int) -> EncodedImage:
    """Take over a foxglove.CompressedVideo; its frames must be decoded in order, each exactly once."""
    video_format, data = message.format, message.data
    return EncodedImage(
        stamp_of(message, log_time_ns),
        message.frame_id,
        lambda: video.decode(video_format, data, loss_count),
        is_ordered=True,
    )


def to_camera(message: Any, log_time_ns: int) -> CameraSample:
    """Convert a foxglove.CameraCalibration."""
    size_px = (message.width, message.height)
    camera = checked_camera(
        size_px, message.K, message.D, message.R, message.P, message.frame_id, message.distortion_model
    )
    return CameraSample(stamp_of(message, log_time_ns), camera)


def to_joints(message: Any, log_time_ns: int) -> JointSample:
    """Convert a foxglove.JointStates; joints without a position are left out."""
    if len(message.joints) > MAX_JOINTS:
        raise DecodeError(f"{len(message.joints)} joints, the limit is {MAX_JOINTS}")
    joints = [joint for joint in message.joints if joint.HasField("position")]
    return checked_joints(
        stamp_of(message, log_time_ns),
        [joint.name for joint in joints],
        [joint.position for joint in joints],
    )


def to_pose(message: Any, log_time_ns: int) -> PoseSample:
    """Convert a foxglove.PoseInFrame."""
    pose = message.pose
    numbers = _numbers(pose, pose.position, pose.orientation, "orientation")
    transform = checked_transform(stamp_of(message, log_time_ns), message.frame_id, "", *numbers)
    return PoseSample(transform.stamp_ns, transform.parent, transform.T_parent_child)


def to_transforms(message: Any, log_time_ns: int) -> RawTransforms:
    """Take over a foxglove.FrameTransform or FrameTransforms."""
    parts = message.transforms if hasattr(message, "transforms") else [message]
    if len(parts) > MAX_TRANSFORMS:
        raise DecodeError(f"{len(parts)} transforms, the limit is {MAX_TRANSFORMS}")
    transforms = tuple(
        checked_transform(
            stamp_of(part, log_time_ns),
            part.parent_frame_id,
            part.child_frame_id,
            *_numbers(part, part.translation, part.rotation, "rotation"),
        )
        for part in parts
    )
    first_ns = transforms[0].stamp_ns if transforms else checked_stamp_ns(log_time_ns)
    return RawTransforms(first_ns, transforms)


def to_distance(message: Any, log_time_ns: int) -> DistanceSample:
    """Convert a svmdist.GroundTruthDistance."""
    values = (message.planar_m, message.spatial_m, message.clearance_m)
    check_numbers(values, "a distance")
    return DistanceSample(stamp_of(message, log_time_ns), *values)


def _numbers(message: Any, position: Any, rotation: Any, rotation_field: str) -> tuple[Vector, Quaternion]:
    # An unset rotation means none; one that is set to four zeros is an error.
    xyzw = (
        (rotation.x, rotation.y, rotation.z, rotation.w)
        if message.HasField(rotation_field)
        else IDENTITY_XYZW
    )
    return (position.x, position.y, position.z), xyzw

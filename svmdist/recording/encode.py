"""How each sample is written: its protobuf schema and its bytes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message

from svmdist.camera import Camera
from svmdist.image_input import require_bgr
from svmdist.profile import Limits
from svmdist.recording.ground_truth_distance_pb2 import GroundTruthDistance
from svmdist.recording.images import still_format, still_size
from svmdist.samples import (
    CameraSample,
    DistanceSample,
    ImageSample,
    JointSample,
    PoseSample,
    Sample,
    TransformSample,
    TransformsSample,
)
from svmdist.transforms import Array, quaternion_xyzw_from_rotation

PNG_OPTIONS = (cv2.IMWRITE_PNG_COMPRESSION, 6)
"""A sixth smaller than OpenCV's default for 17 ms of a rendered frame of 640x480, less than rendering takes."""

JPEG_OPTIONS = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
"""Colour at full resolution: segmentation by hue stands on it."""


@dataclass(frozen=True, slots=True)
class EncodedSample:
    """A sample as its bytes: its stamp, the type of sample that it is, and its serialised message.

    For what is no sample, `sample_type` is the class of the protobuf message.
    """

    stamp_ns: int
    sample_type: type
    data: bytes


@dataclass(frozen=True)
class MessageType:
    """A protobuf message type as a recording declares it: its name and a serialised FileDescriptorSet."""

    name: str
    descriptor_set: bytes


MESSAGE_CLASSES: dict[type, Any] = {
    ImageSample: CompressedImage,
    CameraSample: CameraCalibration,
    JointSample: JointStates,
    PoseSample: PoseInFrame,
    TransformsSample: FrameTransforms,
    DistanceSample: GroundTruthDistance,
}


def message_type(sample_type: type) -> MessageType:
    """Look up the message type that a type of sample is written as; ValueError for any other object.

    The class of a protobuf message is written as itself.
    """
    if issubclass(sample_type, Message):
        message_class: Any = sample_type
        return _describe(message_class)
    if sample_type not in MESSAGE_CLASSES:
        names = ", ".join(known.__name__ for known in MESSAGE_CLASSES)
        raise ValueError(f"cannot record a {sample_type.__name__}; the choices are {names}")
    return _describe(MESSAGE_CLASSES[sample_type])


@cache
def _describe(message_class: Any) -> MessageType:
    files: dict[str, Any] = {}

    def collect(file: Any) -> None:
        for dependency in file.dependencies:
            collect(dependency)
        files.setdefault(file.name, file)

    collect(message_class.DESCRIPTOR.file)
    descriptors = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(descriptors.file.add())
    return MessageType(message_class.DESCRIPTOR.full_name, descriptors.SerializeToString(deterministic=True))


def encode(sample: Sample, jpeg_quality: int | None = None) -> bytes:
    """Serialise a sample as its message type; ValueError when an image is not (height, width, 3) uint8.

    Images become PNG, which loses nothing, or JPEG of a quality from 1 to 100 with colour at full resolution.
    """
    return _encode(sample, iter(_quaternions(_transforms_of(sample))), jpeg_quality)


def encode_still(stamp_ns: int, frame_id: str, data: bytes, limits: Limits) -> EncodedSample:
    """Wrap a PNG or JPEG as it is, without decoding it; ImageError for any other format, or where its header is bad."""
    still_size(data, limits)
    message = CompressedImage(frame_id=frame_id, data=data, format=still_format(data) or "")
    _stamp(message, stamp_ns)
    return EncodedSample(stamp_ns, ImageSample, message.SerializeToString(deterministic=True))


def encode_all(
    samples: Iterable[tuple[str, Sample]], jpeg_quality: int | None = None
) -> list[tuple[str, EncodedSample]]:
    """Serialise (topic, sample) pairs as `encode` does each, which takes less time for many transforms."""
    pairs = list(samples)
    quaternions = iter(_quaternions([T for _, sample in pairs for T in _transforms_of(sample)]))
    return [
        (topic, EncodedSample(sample.stamp_ns, type(sample), _encode(sample, quaternions, jpeg_quality)))
        for topic, sample in pairs
    ]


def _transforms_of(sample: Sample) -> Sequence[Array]:
    """The transforms whose rotations are written as quaternions, in the order of the message."""
    match sample:
        case PoseSample():
            return (sample.T_frame_pose,)
        case TransformsSample():
            return [one.T_parent_child for one in sample.transforms]
        case _:
            return ()


def _quaternions(transforms: Sequence[Array]) -> list[list[float]]:
    """Quaternions in the order x, y, z, w of transforms (4, 4): one call for all, since calls cost most of the time."""
    if not transforms:
        return []
    quaternions: list[list[float]] = quaternion_xyzw_from_rotation(np.stack(transforms)[:, :3, :3]).tolist()
    return quaternions


def _model_name(camera: Camera) -> str:
    """What Foxglove calls the lens."""
    if camera.distortion_model == "fisheye":
        return "kannala_brandt"
    return "plumb_bob" if len(camera.D) <= 5 else "rational_polynomial"


def _encode(sample: Sample, quaternions: Iterator[list[float]], jpeg_quality: int | None) -> bytes:
    """Serialise a sample, whose transforms' quaternions are the next ones."""
    message: Message
    match sample:
        case ImageSample():
            data, name = _compressed(sample, jpeg_quality)
            message = CompressedImage(frame_id=sample.frame_id, data=data, format=name)
        case CameraSample(camera=camera):
            message = CameraCalibration(
                frame_id=camera.frame_id,
                width=camera.width_px,
                height=camera.height_px,
                distortion_model=_model_name(camera),
                D=camera.D,
                K=camera.K.ravel(),
                R=() if camera.R_rectified_camera is None else camera.R_rectified_camera.ravel(),
                P=() if camera.P is None else camera.P.ravel(),
            )
        case JointSample():
            pairs = zip(sample.names, np.asarray(sample.positions, np.float64).tolist(), strict=True)
            message = JointStates(joints=[JointState(name=name, position=value) for name, value in pairs])
        case PoseSample():
            message = PoseInFrame(frame_id=sample.frame_id)
            _fill(message.pose.position, message.pose.orientation, sample.T_frame_pose, next(quaternions))
        case TransformsSample():
            return FrameTransforms(
                transforms=[_transform(one, next(quaternions)) for one in sample.transforms]
            ).SerializeToString(deterministic=True)
        case DistanceSample():
            message = GroundTruthDistance(
                planar_m=sample.planar_m, spatial_m=sample.spatial_m, clearance_m=sample.clearance_m
            )
        case _:
            message_type(type(sample))
            raise AssertionError("unreachable")
    _stamp(message, sample.stamp_ns)
    return message.SerializeToString(deterministic=True)


def _stamp(message: Any, stamp_ns: int) -> None:
    message.timestamp.seconds, message.timestamp.nanos = divmod(stamp_ns, 1_000_000_000)


def _compressed(sample: ImageSample, jpeg_quality: int | None) -> tuple[bytes, str]:
    image = sample.image_bgr
    require_bgr(image)
    if jpeg_quality is None:
        return cv2.imencode(".png", image, PNG_OPTIONS)[1].tobytes(), "png"
    options = (cv2.IMWRITE_JPEG_QUALITY, jpeg_quality, *JPEG_OPTIONS)
    return cv2.imencode(".jpg", image, options)[1].tobytes(), "jpeg"


def _transform(sample: TransformSample, quaternion_xyzw: list[float]) -> FrameTransform:
    message = FrameTransform(parent_frame_id=sample.parent, child_frame_id=sample.child)
    _stamp(message, sample.stamp_ns)
    _fill(message.translation, message.rotation, sample.T_parent_child, quaternion_xyzw)
    return message


def _fill(position: Any, orientation: Any, T: Array, quaternion_xyzw: list[float]) -> None:
    position.x, position.y, position.z = T[:3, 3].tolist()
    orientation.x, orientation.y, orientation.z, orientation.w = quaternion_xyzw

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
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
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
    TransformsSample,
)
from svmdist.transforms import Array, quaternion_xyzw_from_rotation

PNG_OPTIONS = (cv2.IMWRITE_PNG_COMPRESSION, 6)
"""A sixth smaller than OpenCV's default for 17 ms of a rendered frame of 640x480, less than rendering takes."""
JPEG_OPTIONS = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
"""Colour at full resolution: segmentation by hue depends on it."""
MESSAGE_CLASSES: dict[type, Any] = {
    ImageSample: CompressedImage,
    CameraSample: CameraCalibration,
    JointSample: JointStates,
    PoseSample: PoseInFrame,
    TransformsSample: FrameTransforms,
    DistanceSample: GroundTruthDistance,
}


@dataclass(frozen=True, slots=True)
class EncodedSample:
    """A serialised message; `sample_type` is the type of sample, else the class of the protobuf message."""

    stamp_ns: int
    sample_type: type
    data: bytes


@dataclass(frozen=True)
class MessageType:
    """A protobuf message type as a recording declares it: its name and a serialised FileDescriptorSet."""

    name: str
    descriptor_set: bytes


def message_type(sample_type: type) -> MessageType:
    """The message type that a type of sample, or a protobuf class, is written as; ValueError for any other."""
    message_class: Any = sample_type if issubclass(sample_type, Message) else MESSAGE_CLASSES.get(sample_type)
    if message_class is None:
        names = ", ".join(known.__name__ for known in MESSAGE_CLASSES)
        raise ValueError(f"cannot record a {sample_type.__name__}; the choices are {names}")
    return _describe(message_class)


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
    message_type(type(sample))
    ((_, encoded),) = encode_all([("", sample)], jpeg_quality)
    return encoded.data


def encode_still(stamp_ns: int, frame_id: str, data: bytes, limits: Limits) -> EncodedSample:
    """Wrap a PNG or JPEG as it is, without decoding it; ImageError for any other format, or where its header is bad."""
    still_size(data, limits)
    message = CompressedImage(frame_id=frame_id, data=data, format=still_format(data) or "")
    return EncodedSample(stamp_ns, ImageSample, serialised(message, stamp_ns))


def encode_all(
    samples: Iterable[tuple[str, Sample]], jpeg_quality: int | None = None
) -> list[tuple[str, EncodedSample]]:
    """Serialise (topic, sample) pairs as `encode` does each."""
    pairs = list(samples)
    # All quaternions in one call, since calls cost most of the time.
    transforms = [T for _, sample in pairs for T in _transforms_of(sample)]
    rotations = np.array(transforms).reshape(-1, 4, 4)[:, :3, :3]
    quaternions = iter(quaternion_xyzw_from_rotation(rotations).tolist() if transforms else [])
    return [
        (topic, EncodedSample(sample.stamp_ns, type(sample), _encode(sample, quaternions, jpeg_quality)))
        for topic, sample in pairs
    ]


def serialised(message: Message, stamp_ns: int | None = None) -> bytes:
    """The bytes of a message, the same on a rerun; `stamp_ns` becomes its timestamp."""
    if stamp_ns is not None:
        set_stamp(message, stamp_ns)
    return message.SerializeToString(deterministic=True)


def set_stamp(message: Any, stamp_ns: int) -> None:
    """Set the timestamp of a message."""
    message.timestamp.seconds, message.timestamp.nanos = divmod(stamp_ns, 1_000_000_000)


def _transforms_of(sample: Sample) -> Sequence[Array]:
    """The transforms whose rotations are written as quaternions, in the order of the message."""
    if isinstance(sample, PoseSample):
        return (sample.T_frame_pose,)
    return [one.T_parent_child for one in sample.transforms] if isinstance(sample, TransformsSample) else ()


def _encode(sample: Sample, quaternions: Iterator[list[float]], jpeg_quality: int | None) -> bytes:
    """Serialise a sample, whose transforms' quaternions are the next ones."""
    message: Any = MESSAGE_CLASSES[type(sample)]()
    match sample:
        case ImageSample():
            message.frame_id = sample.frame_id
            message.data, message.format = _compressed(sample, jpeg_quality)
        case CameraSample(camera=camera):
            _fill_camera(message, camera)
        case JointSample():
            for name, value in zip(sample.names, np.asarray(sample.positions).tolist(), strict=True):
                message.joints.add(name=name, position=value)
        case PoseSample():
            message.frame_id = sample.frame_id
            pose = message.pose
            _fill(pose.position, pose.orientation, sample.T_frame_pose, next(quaternions))
        case TransformsSample():
            for one in sample.transforms:
                part = message.transforms.add(parent_frame_id=one.parent, child_frame_id=one.child)
                set_stamp(part, one.stamp_ns)
                _fill(part.translation, part.rotation, one.T_parent_child, next(quaternions))
            return serialised(message)
        case DistanceSample():
            message.planar_m, message.spatial_m = sample.planar_m, sample.spatial_m
            message.clearance_m = sample.clearance_m
    return serialised(message, sample.stamp_ns)


def _compressed(sample: ImageSample, jpeg_quality: int | None) -> tuple[bytes, str]:
    require_bgr(sample.image_bgr)
    if jpeg_quality is None:
        return cv2.imencode(".png", sample.image_bgr, PNG_OPTIONS)[1].tobytes(), "png"
    options = (cv2.IMWRITE_JPEG_QUALITY, jpeg_quality, *JPEG_OPTIONS)
    return cv2.imencode(".jpg", sample.image_bgr, options)[1].tobytes(), "jpeg"


def _fill_camera(message: Any, camera: Camera) -> None:
    message.frame_id, message.width, message.height = camera.frame_id, camera.width_px, camera.height_px
    plumb_bob = "plumb_bob" if len(camera.D) <= 5 else "rational_polynomial"
    # Foxglove's names of the lenses.
    message.distortion_model = "kannala_brandt" if camera.distortion_model == "fisheye" else plumb_bob
    message.D.extend(camera.D)
    message.K.extend(camera.K.ravel())
    for values, target in ((camera.R_rectified_camera, message.R), (camera.P, message.P)):
        if values is not None:
            target.extend(values.ravel())


def _fill(position: Any, orientation: Any, T: Array, quaternion_xyzw: list[float]) -> None:
    position.x, position.y, position.z = T[:3, 3].tolist()
    orientation.x, orientation.y, orientation.z, orientation.w = quaternion_xyzw

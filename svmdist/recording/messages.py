"""From raw messages to samples: which schemas are understood, what each one becomes, and the checks of its values.

Foxglove's messages and svmdist's own come in protobuf, those of ROS in the layout of ROS 1 or in CDR.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache, lru_cache, partial
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from google.protobuf.message import DecodeError as ProtobufError

from svmdist import samples
from svmdist.camera import KNOWN_DISTORTION, MAX_COEFFICIENTS, Camera
from svmdist.profile import Limits
from svmdist.recording.ground_truth_distance_pb2 import GroundTruthDistance
from svmdist.recording.images import ImageError, VideoDecoder, decode_raw, decode_still
from svmdist.recording.source import RawMessage, cut
from svmdist.transforms import Array, make_transform, rotation_from_quaternion_xyzw

MAX_STAMP_NS = (1 << 63) - 1
NS = 1_000_000_000
MAX_MAGNITUDE = 1e12
"""In m, rad or px, far beyond anything real; squares and differences of such numbers are still finite."""
MIN_QUATERNION = 1e-9
"""Its length; a shorter one names no rotation."""


class DecodeError(ValueError):
    """A message that does not hold what its schema promises."""


class Kind(StrEnum):
    """What a topic carries, whatever its encoding."""

    IMAGE = "images"
    CAMERA = "camera calibrations"
    JOINTS = "joint states"
    POSE = "poses"
    TRANSFORMS = "transforms"
    DISTANCE = "true distances"


@dataclass(frozen=True, slots=True)
class EncodedImage:
    """An image whose pixels `decode` makes when asked, in any thread, or raises ImageError; those of videos at once."""

    stamp_ns: int
    frame_id: str
    decode: Callable[..., samples.Image]
    """From a `Decoder` it takes nothing; from a converter, the limits."""
    video: tuple[str, bytes] | None = None
    """Format and data of a frame that is not decoded."""
    topic: str = ""
    log_time_ns: int = 0
    size_bytes: int = 0
    offset: int | None = None


class RawTransform(NamedTuple):
    """A transform, or the pose of something in `parent`: translation in m, and quaternion as x, y, z, w."""

    stamp_ns: int
    parent: str
    child: str
    values: tuple[float, ...]


class RawTransforms(NamedTuple):
    """The transforms of one message."""

    stamp_ns: int
    transforms: tuple[RawTransform, ...]


Numbers = samples.JointSample | samples.CameraSample | samples.DistanceSample
Message = Numbers | EncodedImage | RawTransform | RawTransforms


def matrices(values: Array) -> Array:
    """The transforms, shape (n, 4, 4), of translations and quaternions, shape (n, 7)."""
    return make_transform(rotation_from_quaternion_xyzw(values[:, 3:]), values[:, :3])


def to_sample(message: Message) -> samples.Sample:
    """The same with matrices and pixels; ImageError where an image cannot be decoded."""
    match message:
        case EncodedImage():
            return samples.ImageSample(message.stamp_ns, message.frame_id, message.decode())
        case RawTransform(stamp_ns, parent, values=values):
            return samples.PoseSample(stamp_ns, parent, matrices(np.array([values]))[0])
        case RawTransforms(stamp_ns, parts):
            T = matrices(np.array([one.values for one in parts]).reshape(-1, 7))
            transforms = (samples.TransformSample(*one[:3], each) for one, each in zip(parts, T, strict=True))
            return samples.TransformsSample(stamp_ns, tuple(transforms))
    return message


class Decoder:
    """Turns the messages of one pass over a log into samples; videos need one that goes on."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._videos: dict[str, VideoDecoder] = {}
        self._failure_count = 0

    def decode(self, raw: RawMessage, *, with_video: bool = True) -> Message:
        """Turn a message into a sample, of a video with or without pixels; DecodeError where it is malformed."""
        try:
            found = self._converted(raw)
        except DecodeError:
            self._failure_count += 1
            raise
        if not isinstance(found, EncodedImage):
            return found
        if found.video is None:
            return replace(found, decode=partial(found.decode, self._limits))
        if not with_video:
            return found
        video = self._videos.setdefault(raw.topic, VideoDecoder(self._limits))
        try:
            pixels = video.decode(*found.video, raw.losses_before + self._failure_count)
        except ImageError as problem:
            return broken_image(found.stamp_ns, str(problem))
        return EncodedImage(found.stamp_ns, found.frame_id, lambda: pixels)

    def image(self, raw: RawMessage) -> EncodedImage:
        """Turn a message into an image; one that is broken becomes an image that is broken."""
        try:
            found = self.decode(raw)
        except DecodeError as problem:
            found = broken_image(raw.log_time_ns, str(problem))
        if not isinstance(found, EncodedImage):
            found = broken_image(raw.log_time_ns, "no image")
        logged_ns, size_bytes = raw.log_time_ns, len(raw.data)
        return replace(
            found, topic=raw.topic, log_time_ns=logged_ns, size_bytes=size_bytes, offset=raw.offset
        )

    def _converted(self, raw: RawMessage) -> Message:
        checked_stamp(raw.log_time_ns)
        schema, kind, parser, converter = _reader(raw.message_encoding, raw.schema)
        if kind is None:
            raise DecodeError(f"schema {raw.schema!r} in {raw.message_encoding!r} is not known")
        limit = self._limits.message_bytes
        if kind is Kind.IMAGE:
            is_raw = schema in {"foxglove.RawImage", "sensor_msgs/Image"}
            limit += 4 * self._limits.image_pixels if is_raw else self._limits.image_bytes
        if len(raw.data) > limit:
            raise DecodeError(f"a message of {len(raw.data)} bytes, the limit is {limit}")
        if parser is None:
            from svmdist.recording.ros_messages import decode_ros

            return decode_ros(raw.message_encoding, schema, raw.data, raw.log_time_ns)
        try:
            message = parser(raw.data)
        except (ProtobufError, RecursionError, UnicodeDecodeError, ValueError) as problem:
            raise DecodeError(f"not a {schema}: {problem}") from None
        stamp_ns = raw.log_time_ns
        if kind is not Kind.TRANSFORMS:  # whose parts have each its own
            stamp_ns = _stamp_of(message, stamp_ns)
        found: Message = converter(message, stamp_ns, getattr(message, "frame_id", ""))
        return found


@lru_cache(maxsize=256)
def _reader(message_encoding: str, schema: str) -> tuple[str, Kind | None, Any, Any]:
    """A schema's short name and kind, and of protobuf what parses and converts its messages."""
    short, kind = _short(schema), kind_of(schema, message_encoding)
    if kind is None or message_encoding != "protobuf":
        return short, kind, None, None
    return short, kind, message_class(short).FromString, FOXGLOVE[short][1]


@cache
def message_class(schema: str) -> Any:
    """The protobuf class of a schema that svmdist reads."""
    if schema == GroundTruthDistance.DESCRIPTOR.full_name:
        return GroundTruthDistance
    name = schema.removeprefix("foxglove.")
    return getattr(import_module(f"foxglove_schemas_protobuf.{name}_pb2"), name)


def kind_of(schema: str, message_encoding: str) -> Kind | None:
    """Tell what a topic carries; None for a schema or an encoding that svmdist does not read."""
    return KINDS.get(message_encoding, {}).get(_short(schema))


def broken_image(log_time_ns: int, reason: str) -> EncodedImage:
    """Make an image whose decoding fails, for a message that is broken before its pixels."""

    def fail() -> samples.Image:
        raise ImageError(reason)

    return EncodedImage(min(log_time_ns, MAX_STAMP_NS), "", fail)


def _short(schema: str) -> str:
    """Leave out the `/msg/` of ROS 2, which ROS 1 and some recorders do not write."""
    return schema.replace("/msg/", "/", 1)


def _stamp_of(message: Any, log_time_ns: int) -> int:
    """The message's own stamp in ns, or the log time where it has none."""
    own_ns = message.timestamp.seconds * NS + message.timestamp.nanos
    return checked_stamp(own_ns if message.HasField("timestamp") else log_time_ns)


def _foxglove_video(message: Any, stamp_ns: int, frame_id: str) -> EncodedImage:
    image = broken_image(stamp_ns, "a frame of a video that was not decoded")
    return replace(image, frame_id=frame_id, video=(message.format, message.data))


def _foxglove_joints(message: Any, stamp_ns: int, _: str) -> samples.JointSample:
    """Joints without a position are left out."""
    joints = [joint for joint in message.joints if joint.HasField("position")]
    return checked_joints(stamp_ns, [joint.name for joint in joints], [joint.position for joint in joints])


def _foxglove_pose(message: Any, stamp_ns: int, frame_id: str) -> RawTransform:
    pose = message.pose
    q = pose.orientation if pose.HasField("orientation") else None
    return checked_transform(stamp_ns, frame_id, "", pose.position, q)


def _foxglove_transforms(message: Any, log_time_ns: int, _: str) -> RawTransforms:
    """Of a FrameTransform or FrameTransforms. An unset rotation means none; four zeros that are set are an error."""
    parts = message.transforms if hasattr(message, "transforms") else [message]
    transforms = []
    for part in parts:
        q = part.rotation if part.HasField("rotation") else None
        frames = part.parent_frame_id, part.child_frame_id
        transforms.append(checked_transform(_stamp_of(part, log_time_ns), *frames, part.translation, q))
    return transforms_of(transforms, log_time_ns)


def _distance(message: Any, stamp_ns: int, _: str) -> samples.DistanceSample:
    values = (message.planar_m, message.spatial_m, message.clearance_m)
    _check_numbers(values, "a distance")
    return samples.DistanceSample(stamp_ns, *values)


def raw_image(message: Any, stamp_ns: int, frame_id: str) -> EncodedImage:
    """An uncompressed image."""
    size_px = message.width, message.height
    decode = partial(decode_raw, message.encoding, size_px, message.step, message.data)
    return EncodedImage(stamp_ns, frame_id, decode)


def still_image(message: Any, stamp_ns: int, frame_id: str) -> EncodedImage:
    """A compressed image; its `format` is ignored, for its data say what they are."""
    return EncodedImage(stamp_ns, frame_id, partial(decode_still, message.data))


def checked_stamp(stamp_ns: int) -> int:
    """Return a stamp that fits into 64 bits with sign and is not negative; DecodeError for any other."""
    if not 0 <= stamp_ns <= MAX_STAMP_NS:
        raise DecodeError(f"the stamp {stamp_ns} ns is out of range")
    return stamp_ns


def _check_numbers(values: Sequence[float], what: str) -> None:
    """Refuse numbers that are not finite or absurdly large."""
    # The sum is ten times as fast as an array, and False for NaN and infinity too.
    if not sum(map(abs, values)) <= MAX_MAGNITUDE:
        for bad in (value for value in values if not abs(value) <= MAX_MAGNITUDE):
            raise DecodeError(f"{what}: {bad} is no usable number")


def checked_transform(stamp_ns: int, parent: str, child: str, position: Any, rotation: Any) -> RawTransform:
    """A transform; DecodeError for values that are not finite or name no rotation."""
    q = (0.0, 0.0, 0.0, 1.0) if rotation is None else (rotation.x, rotation.y, rotation.z, rotation.w)
    values = (position.x, position.y, position.z, *q)
    _check_numbers(values, "a transform")
    if math.hypot(*q) <= MIN_QUATERNION:
        raise DecodeError("a rotation needs a finite quaternion that is not zero")
    return RawTransform(stamp_ns, parent, child, values)


def transforms_of(transforms: Sequence[RawTransform], log_time_ns: int) -> RawTransforms:
    """One message of transforms, with the stamp of the first one."""
    return RawTransforms(transforms[0].stamp_ns if transforms else log_time_ns, tuple(transforms))


def checked_joints(stamp_ns: int, names: Sequence[str], positions: Sequence[float]) -> samples.JointSample:
    """A sample; DecodeError for names that repeat and positions that are missing or not finite."""
    if len(names) != len(positions) or not names:
        raise DecodeError(f"{len(names)} joint names and {len(positions)} positions")
    if len(set(names)) != len(names):
        raise DecodeError("joint names repeat")
    _check_numbers(positions, "joint positions")
    # Every message brings the same names: one string each serves all the samples that are kept.
    return samples.JointSample(stamp_ns, tuple(map(sys.intern, names)), np.array(positions, np.float64))


def camera_sample(message: Any, stamp_ns: int, frame_id: str) -> samples.CameraSample:
    """A camera; DecodeError for a matrix of another size, an uncalibrated camera or an unknown distortion."""
    names = "KDRP" if hasattr(message, "K") else "kdrp"  # ROS 2 writes them small, others large
    K, D, R, P = (np.array(getattr(message, name), np.float64) for name in names)
    if len(K) != 9 or len(R) not in {0, 9} or len(P) not in {0, 12} or len(D) > MAX_COEFFICIENTS:
        raise DecodeError(f"K, R, P, D have {len(K)}, {len(R)}, {len(P)}, {len(D)} elements")
    _check_numbers([*K, *D, *R, *P], "a calibration")
    name = cut(message.distortion_model)
    model = KNOWN_DISTORTION.get(name.lower()) if D.any() else "plumb_bob"
    if model is None:
        choices = ", ".join(sorted(filter(None, KNOWN_DISTORTION)))
        raise DecodeError(f"distortion model {name!r} is not known; the choices are {choices}")
    R_rectified = R.reshape(3, 3) if R.any() else None
    size_px, P_rectified = (message.width, message.height), P.reshape(3, 4) if P.any() else None
    try:
        camera = Camera(*size_px, K.reshape(3, 3), D, R_rectified, P_rectified, frame_id, model)
    except ValueError as problem:
        raise DecodeError(str(problem)) from None
    return samples.CameraSample(stamp_ns, camera)


Converter = Callable[[Any, int, str], Message]
"""From a parsed message, its stamp in ns, and its frame."""
FOXGLOVE: dict[str, tuple[Kind, Converter]] = {
    "foxglove.CompressedImage": (Kind.IMAGE, still_image),
    "foxglove.RawImage": (Kind.IMAGE, raw_image),
    "foxglove.CompressedVideo": (Kind.IMAGE, _foxglove_video),
    "foxglove.CameraCalibration": (Kind.CAMERA, camera_sample),
    "foxglove.JointStates": (Kind.JOINTS, _foxglove_joints),
    "foxglove.PoseInFrame": (Kind.POSE, _foxglove_pose),
    "foxglove.FrameTransform": (Kind.TRANSFORMS, _foxglove_transforms),
    "foxglove.FrameTransforms": (Kind.TRANSFORMS, _foxglove_transforms),
    "svmdist.GroundTruthDistance": (Kind.DISTANCE, _distance),
}
ROS: dict[str, Kind] = {
    "sensor_msgs/Image": Kind.IMAGE,
    "sensor_msgs/CompressedImage": Kind.IMAGE,
    "sensor_msgs/CameraInfo": Kind.CAMERA,
    "sensor_msgs/JointState": Kind.JOINTS,
    "geometry_msgs/PoseStamped": Kind.POSE,
    "geometry_msgs/TransformStamped": Kind.POSE,
    "tf2_msgs/TFMessage": Kind.TRANSFORMS,
    "tf/tfMessage": Kind.TRANSFORMS,
}
KINDS = {"protobuf": {schema: kind for schema, (kind, _) in FOXGLOVE.items()}, "cdr": ROS, "ros1": ROS}
"""By encoding and schema."""

"""From raw messages to samples: which schemas are understood, what each one becomes, and the checks of its values.

Foxglove's messages and svmdist's own come in protobuf, those of ROS in the layout of ROS 1 or in CDR, by `rosbags`.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cache, partial
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from google.protobuf import message as protobuf

from svmdist import samples
from svmdist.camera import KNOWN_DISTORTION, MAX_COEFFICIENTS, Camera
from svmdist.errors import restated
from svmdist.profile import Limits
from svmdist.recording import own_messages_pb2
from svmdist.recording.images import ImageError, VideoDecoder, decode_raw, decode_still
from svmdist.recording.source import RawMessage, TopicInfo, cut, sanitize_list
from svmdist.transforms import Array, frame_name, make_transform, rotation_from_quaternion_xyzw

MAX_STAMP_NS = (1 << 63) - 1
NS = 1_000_000_000
MAX_MAGNITUDE = 1e12  # in m, rad or px, far beyond anything real; squares and differences of these are still finite
Protobuf: Any = protobuf.Message  # what messages that are not of ROS derive from


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
    """An image whose pixels `decode` makes when asked, in any thread, or raises ImageError."""

    stamp_ns: int
    frame_id: str
    decode: Callable[[], samples.Image]
    video_format: str | None = None  # of a frame that needs those before it
    topic: str = ""
    log_time_ns: int = 0
    size_bytes: int = 0
    offset: int | None = None
    data: Any = field(default=b"", repr=False, compare=False)  # bytes, or an array of them
    since_ns: int = 0  # the stamp of the first one in a row, up to this one, with these data


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
        self._last: dict[str, EncodedImage] = {}
        self._failure_count = 0

    def image(self, raw: RawMessage) -> EncodedImage:
        """Turn a message into an image, of a video with its pixels; a broken one becomes an image that is broken."""
        try:
            found = self.decode(raw)
        except DecodeError as problem:
            self._failure_count += 1
            found = broken_image(raw.log_time_ns, str(problem))
        if not isinstance(found, EncodedImage):
            found = broken_image(raw.log_time_ns, "no image")
        data, last, since_ns = found.data, self._last.get(raw.topic), found.stamp_ns
        if last is not None and len(data) and memoryview(last.data) == memoryview(data):
            since_ns = last.since_ns
        if found.video_format is not None:
            video = self._videos.setdefault(raw.topic, VideoDecoder(self._limits))
            try:
                pixels = video.decode(found.video_format, data, raw.losses_before + self._failure_count)
                found = EncodedImage(found.stamp_ns, found.frame_id, lambda: pixels)
            except ImageError as problem:
                found = broken_image(found.stamp_ns, str(problem))
        found = replace(found, topic=raw.topic, log_time_ns=raw.log_time_ns, data=data, since_ns=since_ns)
        self._last[raw.topic] = found = replace(found, size_bytes=len(raw.data), offset=raw.offset)
        return found

    def decode(self, raw: RawMessage) -> Message:
        """Turn a message into a sample, of images without pixels; DecodeError where it is malformed."""
        _checked_stamp(raw.log_time_ns)
        encoding, schema = raw.message_encoding, _short(raw.schema)
        if kind_of(raw) is None:
            raise DecodeError(f"schema {raw.schema!r} in {encoding!r} is not known")
        kind, convert = SCHEMAS[encoding][schema]
        limit = self._limits.message_bytes
        if kind is Kind.IMAGE:
            limit += 4 * self._limits.image_pixels if convert is _raw_image else self._limits.image_bytes
        if len(raw.data) > limit:
            raise DecodeError(f"a message of {len(raw.data)} bytes, the limit is {limit}")
        if encoding == "cdr" and raw.data[:2] not in (b"\0\0", b"\0\1"):
            raise DecodeError(f"not plain CDR: it begins with {raw.data[:2].hex(' ')}")
        try:
            message = _parser(encoding, schema)(raw.data)
        except Exception as problem:  # protobuf and rosbags raise their own, and those of NumPy and text
            raise DecodeError(f"not a {schema}: {' '.join(str(problem).split())}") from None
        if kind is Kind.TRANSFORMS:  # whose parts have each a stamp of its own
            return convert(message, raw.log_time_ns, "")
        of_images = (self._limits,) if kind is Kind.IMAGE else ()
        return convert(message, *_header(message, raw.log_time_ns), *of_images)


def kind_of(one: TopicInfo | RawMessage) -> Kind | None:
    """What a topic or a message carries; None for a schema or an encoding that svmdist does not read."""
    known = SCHEMAS.get(one.message_encoding, {}).get(_short(one.schema))
    return known[0] if known else None


def unread(infos: Iterable[TopicInfo]) -> str:
    """What encodings topics of known schemas have that are not read, in words that go on with a line, or ""."""
    known = {schema for table in SCHEMAS.values() for schema in table}
    found = {one.message_encoding for one in infos if _short(one.schema) in known} - {*SCHEMAS}
    read = ", ".join(SCHEMAS)
    return f"; messages in {sanitize_list(sorted(found))} are not read, those in {read} are" if found else ""


def _short(schema: str) -> str:
    """Leave out the `/msg/` of ROS 2, which ROS 1 and some recorders do not write."""
    return schema.replace("/msg/", "/", 1)


@cache
def message_class(schema: str) -> Any:
    """The protobuf class of one of Foxglove's schemas, or of svmdist's own."""
    package, _, name = schema.partition(".")
    is_own = package == "svmdist"
    return getattr(own_messages_pb2 if is_own else import_module(f"foxglove_schemas_protobuf.{name}_pb2"), name)


@cache
def _parser(encoding: str, schema: str) -> Callable[[bytes], Any]:
    """What parses messages of a known schema; its types are imported when the first of them is read."""
    if encoding == "protobuf":
        parse: Callable[[bytes], Any] = message_class(schema).FromString
        return parse
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    package, _, name = ("tf2_msgs/TFMessage" if schema == "tf/tfMessage" else schema).partition("/")
    if encoding == "cdr":
        return partial(get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr, typename=f"{package}/msg/{name}")
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    return partial(store.deserialize_ros1, typename=f"{package}/msg/{name}")


def broken_image(log_time_ns: int, reason: str) -> EncodedImage:
    """Make an image whose decoding fails, for a message that is broken before its pixels."""

    def fail() -> samples.Image:
        raise ImageError(reason)

    return EncodedImage(min(log_time_ns, MAX_STAMP_NS), "", fail)


def _header(message: Any, log_time_ns: int) -> tuple[int, str]:
    """The stamp in ns, the log time where none was set, and the frame of a message or a transform."""
    if isinstance(message, Protobuf):
        stamp, frame_id = message.timestamp, getattr(message, "frame_id", "")
        own_ns = stamp.seconds * NS + stamp.nanos
    else:
        stamp, frame_id = message.header.stamp, message.header.frame_id
        own_ns = stamp.sec * NS + stamp.nanosec
    # Zero in ROS was never set, and converters write it on.
    return _checked_stamp(own_ns or log_time_ns), frame_name(frame_id)


def _checked_stamp(stamp_ns: int) -> int:
    if not 0 <= stamp_ns <= MAX_STAMP_NS:
        raise DecodeError(f"the stamp {stamp_ns} ns is out of range")
    return stamp_ns


def _check_numbers(values: Sequence[float], what: str) -> None:
    # The sum is ten times as fast as an array, and False for NaN and infinity too.
    if not sum(map(abs, values)) <= MAX_MAGNITUDE:
        for bad in (value for value in values if not abs(value) <= MAX_MAGNITUDE):
            raise DecodeError(f"{what}: {bad} is no usable number")


def _raw_image(message: Any, stamp_ns: int, frame_id: str, limits: Limits) -> EncodedImage:
    size_px = message.width, message.height
    decode = partial(decode_raw, message.encoding, size_px, message.step, message.data, limits)
    return EncodedImage(stamp_ns, frame_id, decode, data=message.data)


def _still_image(message: Any, stamp_ns: int, frame_id: str, limits: Limits) -> EncodedImage:
    """A compressed image; its `format` is ignored, for its data say what they are."""
    return EncodedImage(stamp_ns, frame_id, partial(decode_still, message.data, limits), data=message.data)


def _video(message: Any, stamp_ns: int, frame_id: str, _: Limits) -> EncodedImage:
    image = broken_image(stamp_ns, "a frame of a video that was not decoded")
    return replace(image, frame_id=frame_id, video_format=message.format, data=message.data)


def _camera(message: Any, stamp_ns: int, frame_id: str) -> samples.CameraSample:
    names = "KDRP" if hasattr(message, "K") else "kdrp"  # ROS 2 writes them small, others large
    K, D, R, P = (np.array(getattr(message, name), np.float64) for name in names)
    if len(K) != 9 or len(R) not in {0, 9} or len(P) not in {0, 12} or len(D) > MAX_COEFFICIENTS:
        raise DecodeError(f"K, R, P, D have {len(K)}, {len(R)}, {len(P)}, {len(D)} elements")
    _check_numbers([*K, *D, *R, *P], "a calibration")
    name = cut(message.distortion_model)
    # Zeros bend nothing whatever the model is, but for a fisheye's: r = f·θ. None at all are of a rectified image.
    model = KNOWN_DISTORTION.get(name.lower(), None if D.any() else "plumb_bob") if len(D) else "plumb_bob"
    if model is None:
        choices = ", ".join(sorted(filter(None, KNOWN_DISTORTION)))
        raise DecodeError(f"distortion model {name!r} is not known; the choices are {choices}")
    R_rectified = R.reshape(3, 3) if R.any() else None
    A, size_px = np.eye(3), (message.width, message.height)  # A: pixels of the image from those that K is for
    if not isinstance(message, Protobuf):
        # ROS alone has parts of images. The region is in pixels of the sensor, of which `binning` make one.
        roi, binning = message.roi, np.maximum(1, [message.binning_x, message.binning_y])
        width, height = [roi.width or message.width, roi.height or message.height] // binning
        size_px = int(width), int(height)
        A[[0, 1], [0, 1]] = 1.0 / binning
        A[:2, 2] = (0.5 - np.array([roi.x_offset, roi.y_offset])) / binning - 0.5  # from corner to centre
    P_rectified = A @ P.reshape(3, 4) if P.any() else None
    with restated(ValueError, DecodeError):
        camera = Camera(*size_px, A @ K.reshape(3, 3), D, R_rectified, P_rectified, frame_id, model)
    return samples.CameraSample(stamp_ns, camera)


def _joints(message: Any, stamp_ns: int, _: str) -> samples.JointSample:
    """A sample, without joints whose positions are no usable numbers; DecodeError for none, and names that repeat."""
    if isinstance(message, Protobuf):  # which may leave a position out: such a joint is left out
        joints = [joint for joint in message.joints if joint.HasField("position")]
        names, positions = [joint.name for joint in joints], [joint.position for joint in joints]
    else:
        names, positions = message.name, message.position.tolist()
    if len(names) != len(positions) or not names:
        raise DecodeError(f"{len(names)} joint names and {len(positions)} positions")
    if len(set(names)) != len(names):
        raise DecodeError("joint names repeat")
    # Which joints matter is the chain's affair. The sum is as in `_check_numbers`.
    if not sum(map(abs, positions)) <= MAX_MAGNITUDE:
        pairs = zip(names, positions, strict=True)
        usable = {name: position for name, position in pairs if abs(position) <= MAX_MAGNITUDE}
        if not usable:
            raise DecodeError(f"joint positions: {positions[0]} is no usable number")
        names, positions = [*usable], [*usable.values()]
    # Every message brings the same names: one string each serves all the samples that are kept.
    return samples.JointSample(stamp_ns, tuple(map(sys.intern, names)), np.array(positions, np.float64))


def _pose(message: Any, stamp_ns: int, frame_id: str) -> RawTransform:
    return _rigid(stamp_ns, frame_id, "", message.pose, "position", "orientation")


def _transform(message: Any, stamp_ns: int, frame_id: str) -> RawTransform:
    """A transform; as a topic of its own it is in ROS the pose of its child, as older CRTK publishes `*_cp`."""
    is_ros = not isinstance(message, Protobuf)
    rigid, parent = (message.transform, frame_id) if is_ros else (message, message.parent_frame_id)
    parent, child = frame_name(parent), frame_name(message.child_frame_id)
    return _rigid(stamp_ns, parent, child, rigid, "translation", "rotation")


def _transforms(message: Any, log_time_ns: int, _: str) -> RawTransforms:
    parts = message.transforms if hasattr(message, "transforms") else [message]
    found = tuple(_transform(part, *_header(part, log_time_ns)) for part in parts)
    return RawTransforms(found[0].stamp_ns if found else log_time_ns, found)


def _rigid(stamp_ns: int, parent: str, child: str, of: Any, position: str, rotation: str) -> RawTransform:
    """The transform in two parts of a message; DecodeError for values that are not finite or name no rotation."""
    is_turned = not isinstance(of, Protobuf) or of.HasField(rotation)  # which protobuf alone may leave out
    t, turn = getattr(of, position), getattr(of, rotation)
    q = (turn.x, turn.y, turn.z, turn.w) if is_turned else (0.0, 0.0, 0.0, 1.0)
    values = (t.x, t.y, t.z, *q)
    _check_numbers(values, "a transform")
    if math.hypot(*q) <= 1e-9:
        raise DecodeError("a rotation needs a finite quaternion that is not zero")
    return RawTransform(stamp_ns, parent, child, values)


def _distance(message: Any, stamp_ns: int, _: str) -> samples.DistanceSample:
    values = (message.planar_m, message.spatial_m, message.clearance_m)
    _check_numbers(values, "a distance")
    return samples.DistanceSample(stamp_ns, *values)


Converter = Callable[..., Message]  # of a parsed message, its stamp in ns, its frame, and for images the limits
PROTOBUF: dict[str, tuple[Kind, Converter]] = {
    "foxglove.CompressedImage": (Kind.IMAGE, _still_image),
    "foxglove.RawImage": (Kind.IMAGE, _raw_image),
    "foxglove.CompressedVideo": (Kind.IMAGE, _video),
    "foxglove.CameraCalibration": (Kind.CAMERA, _camera),
    "foxglove.JointStates": (Kind.JOINTS, _joints),
    "foxglove.PoseInFrame": (Kind.POSE, _pose),
    "foxglove.FrameTransform": (Kind.TRANSFORMS, _transforms),
    "foxglove.FrameTransforms": (Kind.TRANSFORMS, _transforms),
    "svmdist.GroundTruthDistance": (Kind.DISTANCE, _distance),
}
ROS: dict[str, tuple[Kind, Converter]] = {
    "sensor_msgs/Image": (Kind.IMAGE, _raw_image),
    "sensor_msgs/CompressedImage": (Kind.IMAGE, _still_image),
    "sensor_msgs/CameraInfo": (Kind.CAMERA, _camera),
    "sensor_msgs/JointState": (Kind.JOINTS, _joints),
    "geometry_msgs/PoseStamped": (Kind.POSE, _pose),
    "geometry_msgs/TransformStamped": (Kind.POSE, _transform),
    "tf2_msgs/TFMessage": (Kind.TRANSFORMS, _transforms),
    "tf/tfMessage": (Kind.TRANSFORMS, _transforms),
}
SCHEMAS = {"protobuf": PROTOBUF, "cdr": ROS, "ros1": ROS}  # by encoding and schema: kind, and what makes samples

"""Writing a recording: samples as protobuf, in MCAP with zstd chunks, byte-identical on a rerun."""

from __future__ import annotations

import errno
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import cv2
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message
from mcap.writer import CompressionType, Writer

from svmdist import samples
from svmdist.camera import Camera
from svmdist.errors import OutputError, UsageError
from svmdist.files import open_new, why
from svmdist.profile import Limits
from svmdist.recording.ground_truth_distance_pb2 import GroundTruthDistance
from svmdist.recording.images import still_format, still_size
from svmdist.recording.mcap import METADATA_NAME
from svmdist.transforms import Array, quaternion_xyzw_from_rotation

PNG_OPTIONS = (cv2.IMWRITE_PNG_COMPRESSION, 6)
"""A sixth smaller than OpenCV's default for 17 ms of a rendered frame of 640x480, less than rendering takes."""
JPEG_OPTIONS = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
"""Colour at full resolution: segmentation by hue depends on it."""
MESSAGE_CLASSES: dict[type, Any] = {
    samples.ImageSample: CompressedImage,
    samples.CameraSample: CameraCalibration,
    samples.JointSample: JointStates,
    samples.PoseSample: PoseInFrame,
    samples.TransformsSample: FrameTransforms,
    samples.DistanceSample: GroundTruthDistance,
}

NO_SPACE = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", None))


@dataclass(frozen=True, slots=True)
class EncodedSample:
    """A serialised message; `sample_type` is the type of sample, else the class of the protobuf message."""

    stamp_ns: int
    sample_type: type
    data: bytes


def message_class_of(sample_type: type) -> Any:
    """The protobuf class that a type of sample, or such a class itself, is written as."""
    return sample_type if issubclass(sample_type, Message) else MESSAGE_CLASSES[sample_type]


def _descriptor_set(file: Any) -> bytes:
    """A protobuf file with those that it imports, each behind its own, as an MCAP schema has them."""
    descriptors = FileDescriptorSet()

    def collect(file: Any) -> None:
        for dependency in file.dependencies:
            collect(dependency)
        if file.name not in {one.name for one in descriptors.file}:
            file.CopyToProto(descriptors.file.add())

    collect(file)
    return descriptors.SerializeToString(deterministic=True)


def encode_still(stamp_ns: int, frame_id: str, data: bytes, limits: Limits) -> EncodedSample:
    """Wrap a PNG or JPEG without decoding it; ImageError for any other, or one with a bad header."""
    still_size(data, limits)
    message = CompressedImage(frame_id=frame_id, data=data, format=still_format(data) or "")
    return EncodedSample(stamp_ns, samples.ImageSample, serialised(message, stamp_ns))


def serialised(message: Message, stamp_ns: int | None = None) -> bytes:
    """The bytes of a message, the same on a rerun; `stamp_ns` becomes its timestamp."""
    if stamp_ns is not None:
        set_stamp(message, stamp_ns)
    return message.SerializeToString(deterministic=True)


def set_stamp(message: Any, stamp_ns: int) -> None:
    """Set the timestamp of a message."""
    message.timestamp.seconds, message.timestamp.nanos = divmod(stamp_ns, 1_000_000_000)


def encode(sample: samples.Sample, jpeg_quality: int | None = None) -> EncodedSample:
    """Serialise a sample as its message type, images as PNG or JPEG; ValueError for one not (h, w, 3) of uint8."""
    message: Any = message_class_of(type(sample))()
    stamp_ns: int | None = sample.stamp_ns
    match sample:
        case samples.ImageSample():
            message.frame_id = sample.frame_id
            samples.require_bgr(sample.image_bgr)
            options = (cv2.IMWRITE_JPEG_QUALITY, jpeg_quality, *JPEG_OPTIONS) if jpeg_quality else PNG_OPTIONS
            message.format = "jpeg" if jpeg_quality else "png"
            message.data = cv2.imencode(f".{message.format}", sample.image_bgr, options)[1].tobytes()
        case samples.CameraSample(camera=camera):
            _fill_camera(message, camera)
        case samples.JointSample():
            for name, value in zip(sample.names, np.asarray(sample.positions).tolist(), strict=True):
                message.joints.add(name=name, position=value)
        case samples.PoseSample():
            message.frame_id = sample.frame_id
            _fill([(message.pose.position, message.pose.orientation)], [sample.T_frame_pose])
        case samples.TransformsSample():
            for one in sample.transforms:
                part = message.transforms.add(parent_frame_id=one.parent, child_frame_id=one.child)
                set_stamp(part, one.stamp_ns)
            targets = [(part.translation, part.rotation) for part in message.transforms]
            _fill(targets, [one.T_parent_child for one in sample.transforms])
            stamp_ns = None  # each transform has its own
        case samples.DistanceSample():
            message.planar_m, message.spatial_m = sample.planar_m, sample.spatial_m
            message.clearance_m = sample.clearance_m
    return EncodedSample(sample.stamp_ns, type(sample), serialised(message, stamp_ns))


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


def _fill(targets: Sequence[tuple[Any, Any]], transforms: Sequence[Array]) -> None:
    """Set pairs of a position and a quaternion."""
    T = np.array(transforms).reshape(-1, 4, 4)
    values = T[:, :3, 3].tolist(), quaternion_xyzw_from_rotation(T[:, :3, :3]).tolist()
    for (position, q), t_m, q_xyzw in zip(targets, *values, strict=True):
        position.x, position.y, position.z = t_m
        q.x, q.y, q.z, q.w = q_xyzw


CHUNK_BYTES = 240 * 1024
"""Leaves room in 256 KiB for the schemas and channels that a chunk may have to declare."""
CHUNK_SPAN_NS = 250_000_000
"""What a killed recorder loses; in log time and not wall time, for a rerun shall be byte-identical."""
MESSAGE_HEAD_BYTES = 9 + 22  # of a record, and of a message in it


class RecordingWriter:
    """Writes samples to `NAME.mcap.part` and renames the file when it is complete.

    >>> with RecordingWriter(path, {"scenario": "sweep"}) as writer:      # doctest: +SKIP
    ...     writer.write("/tf", sample)

    An exception inside the block keeps the `.part` file, with everything written so far, unless it has no message or
    the disk is full.
    Chunks hold at most 256 KiB, or one message that is larger. `metadata` becomes the record `svmdist`; images become
    PNG, or JPEG of a quality from 1 to 100, with colour at full resolution.
    Raises UsageError when the file exists and `force` is not set, OutputError when it cannot be written.
    """

    def __init__(
        self, path: Path, metadata: Mapping[str, str], *, force: bool = False, jpeg_quality: int | None = None
    ) -> None:
        self.path = Path(path)
        self.part_path = self.path.with_name(self.path.name + ".part")
        self._metadata, self._force, self._jpeg_quality = dict(metadata), force, jpeg_quality
        self._file: IO[bytes] | None = None
        self._channels: dict[str, tuple[int, type]] = {}
        self._schemas: dict[type, int] = {}
        self._sequences = Counter[int]()
        self._chunk_bytes = 0
        self._chunk_start_ns: int | None = None

    @property
    def opened(self) -> bool:
        """Whether the `.part` file is this writer's own."""
        return self._file is not None

    def __enter__(self) -> Self:
        if self.path.is_dir():
            raise OutputError(f"{self.path}: is a directory, expected the name of a file to write")
        self._refuse_to_replace(self.path)
        self._refuse_to_replace(self.part_path)
        try:
            if self._force:
                self.part_path.unlink(missing_ok=True)
            self._file = open_new(self.part_path)
            self._writer = Writer(
                self._file,
                chunk_size=1 << 40,  # this class ends the chunks, before they grow too large
                compression=CompressionType.ZSTD,
                enable_data_crcs=True,
            )
            self._writer.start(library=f"svmdist {version('svmdist')}")
            self._writer.add_metadata(METADATA_NAME, dict(sorted(self._metadata.items())))
            self._file.flush()
        except OSError as problem:
            raise self._failure(problem) from problem
        return self

    def write(self, topic: str, sample: samples.Sample | EncodedSample) -> None:
        """Append a sample, its stamp as log time; OutputError, ValueError for a topic of another type."""
        if not isinstance(sample, EncodedSample):
            sample = encode(sample, self._jpeg_quality)
        stamp_ns, needed_bytes = sample.stamp_ns, MESSAGE_HEAD_BYTES + len(sample.data)
        try:
            self._end_chunk_before(stamp_ns, needed_bytes)
            channel_id = self._channel(topic, sample.sample_type)
            self._writer.add_message(channel_id, stamp_ns, sample.data, stamp_ns, self._sequences[channel_id])
        except OSError as problem:
            raise self._failure(problem) from problem
        self._sequences[channel_id] += 1
        self._chunk_bytes += needed_bytes
        if self._chunk_start_ns is None:
            self._chunk_start_ns = stamp_ns

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is None:
            return
        if self._channels and isinstance(error, KeyboardInterrupt | OutputError) and self.part_path.exists():
            error.add_note(f"what was recorded until then is in {self.part_path}")
        if self._file.closed:
            return
        if kind is not None:
            # Keep what there is; the caller's exception matters more than another one from here.
            with suppress(OSError):
                self._writer.flush()
            with suppress(OSError):
                self._file.close()
            if not self._channels:  # there is nothing in it worth keeping
                self.part_path.unlink(missing_ok=True)
            return
        try:
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())  # a full disk may show only here
            self._file.close()
            self._refuse_to_replace(self.path)
            self.part_path.replace(self.path)
        except OSError as problem:
            raise self._failure(problem) from problem

    def _end_chunk_before(self, stamp_ns: int, needed_bytes: int) -> None:
        if self._chunk_start_ns is None:
            return
        too_long = abs(stamp_ns - self._chunk_start_ns) >= CHUNK_SPAN_NS
        if too_long or self._chunk_bytes + needed_bytes > CHUNK_BYTES:
            self._writer.flush()
            self._chunk_bytes, self._chunk_start_ns = 0, None

    def _channel(self, topic: str, sample_type: type) -> int:
        if topic in self._channels:
            channel_id, known_type = self._channels[topic]
            if known_type is sample_type:
                return channel_id
            raise ValueError(f"{topic} carries {known_type.__name__}, not {sample_type.__name__}")
        if sample_type not in self._schemas:
            declared = message_class_of(sample_type).DESCRIPTOR
            self._schemas[sample_type] = self._writer.register_schema(
                declared.full_name, "protobuf", _descriptor_set(declared.file)
            )
        channel_id = self._writer.register_channel(topic, "protobuf", self._schemas[sample_type])
        self._channels[topic] = (channel_id, sample_type)
        return channel_id

    def _refuse_to_replace(self, path: Path) -> None:
        if not self._force and os.path.lexists(path):
            what = "is left from an interrupted recording" if path == self.part_path else "exists already"
            raise UsageError(f"{path}: {what}; give another name, or --force to replace it")

    def _failure(self, problem: OSError) -> OutputError:
        if self._file is not None:
            # Closing tries to write the rest once more and fails in the same way.
            with suppress(OSError):
                self._file.close()
            if problem.errno in NO_SPACE:  # what is left would keep the disk full
                with suppress(OSError):
                    self.part_path.unlink()
        return OutputError(f"{self.path}: cannot write: {why(problem)}")

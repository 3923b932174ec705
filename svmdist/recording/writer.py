"""Writing a recording: samples, and drawings for viewers, as protobuf in MCAP with zstd chunks.

The same samples give the same bytes.
"""

from __future__ import annotations

import errno
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import IO, Any, Self

import cv2
import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.writer import CompressionType, Writer

from svmdist import drawing as draw
from svmdist import samples
from svmdist.errors import OutputError, UsageError
from svmdist.files import why
from svmdist.geometry import Capsules, Mesh
from svmdist.profile import Limits
from svmdist.recording.images import still_format, still_size
from svmdist.recording.mcap import METADATA_NAME
from svmdist.recording.messages import message_class
from svmdist.transforms import Array, quaternion_xyzw_from_rotation

# A sixth smaller than OpenCV's default for 17 ms of a rendered frame of 640x480, less than rendering takes.
PNG_OPTIONS = (cv2.IMWRITE_PNG_COMPRESSION, 6)
# Colour at full resolution: segmentation by hue depends on it.
JPEG_OPTIONS = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
NO_SPACE = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", None))
Fields = dict[str, Any]  # of a message, by their names; protobuf makes messages of those inside

FORMS = {draw.Form.POINTS: "POINTS", draw.Form.LINE: "LINE_STRIP", draw.Form.LOOP: "LINE_LOOP"}
GROUND: draw.Rgb = (20, 20, 20)
LINE_PX, POINT_PX, SMALL_POINT_PX, FONT_PX = 2.0, 6.0, 3.0, 14.0
LINE_PIXELS, TEXT_PIXELS = 3.0, 14.0  # of lines and texts in space, in px of the screen
SOLID, SHEER = 0.9, 0.5
UNTURNED = {"w": 1.0}


@dataclass(frozen=True, slots=True)
class EncodedSample:
    """A serialised message; `schema` is the full name of its protobuf type."""

    stamp_ns: int
    schema: str
    data: bytes


def encoded(schema: str, stamp_ns: int, **fields: Any) -> EncodedSample:
    """A message with its stamp, where its type has one, as bytes that are the same on a rerun."""
    kind = message_class(schema)
    if "timestamp" in kind.DESCRIPTOR.fields_by_name:
        fields["timestamp"] = stamp_fields(stamp_ns)
    return EncodedSample(stamp_ns, schema, kind(**fields).SerializeToString(deterministic=True))


def encode_still(stamp_ns: int, frame_id: str, data: bytes, limits: Limits) -> EncodedSample:
    """Wrap a PNG or JPEG without decoding it; ImageError for any other, or one with a bad header."""
    still_size(data, limits)
    return encoded("foxglove.CompressedImage", stamp_ns, frame_id=frame_id, data=data, format=still_format(data))


def encode(sample: samples.Sample, jpeg_quality: int | None = None) -> EncodedSample:
    """Serialise a sample as its message type, images as PNG or JPEG; ValueError for one not (h, w, 3) of uint8."""
    stamp_ns = sample.stamp_ns
    match sample:
        case samples.ImageSample(frame_id=frame_id, image_bgr=image):
            samples.require_bgr(image)
            options = (cv2.IMWRITE_JPEG_QUALITY, jpeg_quality, *JPEG_OPTIONS) if jpeg_quality else PNG_OPTIONS
            name = "jpeg" if jpeg_quality else "png"
            data = cv2.imencode(f".{name}", image, options)[1].tobytes()
            return encoded("foxglove.CompressedImage", stamp_ns, frame_id=frame_id, format=name, data=data)
        case samples.CameraSample(camera=camera):
            # Foxglove's names of the lenses.
            pinhole = "plumb_bob" if len(camera.D) <= 5 else "rational_polynomial"
            lens = "kannala_brandt" if camera.distortion_model == "fisheye" else pinhole
            R, P = (None if one is None else one.ravel() for one in (camera.R_rectified_camera, camera.P))
            size = {"width": camera.width_px, "height": camera.height_px}
            fields = {"frame_id": camera.frame_id, "distortion_model": lens, "D": camera.D, "K": camera.K.ravel()}
            return encoded("foxglove.CameraCalibration", stamp_ns, **size, **fields, R=R, P=P)
        case samples.JointSample(names=names, positions=positions):
            pairs = zip(names, np.asarray(positions).tolist(), strict=True)
            joints = [{"name": name, "position": position} for name, position in pairs]
            return encoded("foxglove.JointStates", stamp_ns, joints=joints)
        case samples.PoseSample(frame_id=frame_id, T_frame_pose=T):
            (pose,) = _rigid_fields([T], "position", "orientation")
            return encoded("foxglove.PoseInFrame", stamp_ns, frame_id=frame_id, pose=pose)
        case samples.TransformsSample(transforms=transforms):
            parts = _rigid_fields([one.T_parent_child for one in transforms], "translation", "rotation")
            for part, one in zip(parts, transforms, strict=True):
                part.update(timestamp=stamp_fields(one.stamp_ns), parent_frame_id=one.parent, child_frame_id=one.child)
            return encoded("foxglove.FrameTransforms", stamp_ns, transforms=parts)
        case samples.DistanceSample():
            return encoded("svmdist.GroundTruthDistance", **asdict(sample))


def _rigid_fields(transforms: Sequence[Array], position: str, rotation: str) -> list[Fields]:
    """The position and the quaternion of each transform, shape (4, 4), under the names that a message gives them."""
    T = np.array(transforms).reshape(-1, 4, 4)
    pairs = zip(T[:, :3, 3], quaternion_xyzw_from_rotation(T[:, :3, :3]), strict=True)
    return [{position: vector_fields(t_m), rotation: vector_fields(q_xyzw)} for t_m, q_xyzw in pairs]


def stamp_fields(stamp_ns: int) -> Fields:
    """A timestamp."""
    return dict(zip(("seconds", "nanos"), divmod(stamp_ns, 1_000_000_000), strict=True))


def vector_fields(values: Array) -> Fields:
    """A point or vector, shape (2,) or (3,), or a quaternion x, y, z, w, shape (4,)."""
    return dict(zip("xyzw", values.tolist(), strict=False))


def image_annotations(drawing: draw.FrameDrawing) -> EncodedSample:
    """The shapes, labels and status lines of an image as `foxglove.ImageAnnotations`."""
    texts = [(label.text, label.place_px, draw.COLOURS[label.part]) for label in drawing.labels]
    rows = enumerate(drawing.lines, 1)
    texts += [(line.text, np.array([4.0, row * (FONT_PX + 6.0)]), line.colour) for row, line in rows]
    stamp = stamp_fields(drawing.stamp_ns)
    look = {"font_size": FONT_PX, "background_color": _colour(GROUND, SOLID), "timestamp": stamp}
    points = [_points(shape) | {"timestamp": stamp} for shape in drawing.shapes]
    written = [
        {"text": text, "position": vector_fields(place_px), "text_color": _colour(colour), **look}
        for text, place_px, colour in texts
    ]
    return encoded("foxglove.ImageAnnotations", drawing.stamp_ns, points=points, texts=written)


def scene_update(drawing: draw.FrameDrawing, instruments: Iterable[str], frame_id: str) -> EncodedSample:
    """Instruments, tissue and distances in space as `foxglove.SceneUpdate`; what is not there now is deleted."""
    shown = {f"{name} instrument": _capsules(body) for name, body in drawing.bodies.items()}
    if isinstance(drawing.tissue, Mesh):
        look = {"pose": {"orientation": UNTURNED}, "color": _colour(draw.COLOURS[draw.Part.TISSUE], SHEER)}
        points, indices = list(map(vector_fields, drawing.tissue.vertices_m)), drawing.tissue.faces.ravel().tolist()
        shown["tissue"] = {"triangles": [{"points": points, "indices": indices, **look}]}
    shown |= {segment.name: _segment(segment) for segment in drawing.segments}
    parts = ("instrument", draw.Part.DISTANCE, draw.Part.BETWEEN)
    possible = {"tissue", *(f"{name} {part}" for name in instruments for part in parts)}
    gone, stamp = {"type": "MATCHING_ID"}, {"timestamp": stamp_fields(drawing.stamp_ns)}
    entities = [{"id": name, "frame_id": frame_id, **stamp, **of} for name, of in shown.items()]
    deletions = [{"id": name, **gone, **stamp} for name in sorted(possible - shown.keys())]
    return encoded("foxglove.SceneUpdate", drawing.stamp_ns, entities=entities, deletions=deletions)


def point_cloud(points_m: Array, std_m: Array, bgr: samples.Image, frame_id: str, stamp_ns: int) -> EncodedSample:
    """Points, shape (n, 3), with a deviation each, (n,), and a colour, (n, 3), as `foxglove.PointCloud`."""
    kinds = [(name, "<f4") for name in ("x", "y", "z", "std_m")]
    kinds += [(name, "u1") for name in ("red", "green", "blue", "alpha")]
    packed = np.empty(len(points_m), kinds)
    for (name, _), values in zip(kinds, (*points_m.T, std_m, *bgr[:, ::-1].T, 255), strict=True):
        packed[name] = values
    numbers = {"<f4": "FLOAT32", "u1": "UINT8"}
    offsets: Any = packed.dtype.fields
    fields = [{"name": name, "offset": offsets[name][1], "type": numbers[kind]} for name, kind in kinds]
    packing = {"point_stride": packed.itemsize, "fields": fields, "data": packed.tobytes()}
    return encoded("foxglove.PointCloud", stamp_ns, frame_id=frame_id, pose={"orientation": UNTURNED}, **packing)


def log_line(text: str, stamp_ns: int, *, is_warning: bool) -> EncodedSample:
    """A line of `foxglove.Log`, as a warning or for information."""
    level = "WARNING" if is_warning else "INFO"
    return encoded("foxglove.Log", stamp_ns, level=level, message=text, name="svmdist")


def _points(shape: draw.Shape) -> Fields:
    colour = _colour(draw.COLOURS[shape.part])
    look: Fields = {"outline_color": colour, "thickness": LINE_PX}
    if shape.form is draw.Form.POINTS:
        is_small = shape.part in (draw.Part.INLIER, draw.Part.MATCH)
        look |= {"fill_color": colour, "thickness": SMALL_POINT_PX if is_small else POINT_PX}
    return {"type": FORMS[shape.form], "points": list(map(vector_fields, shape.points_px)), **look}


def _capsules(body: Capsules) -> Fields:
    """Each capsule as a cylinder with a sphere at both ends."""
    look = {"color": _colour(draw.COLOURS[draw.Part.SHAFT], SOLID)}
    spheres, cylinders = list[Fields](), list[Fields]()
    for start_m, end_m, radius_m in zip(body.start_m, body.end_m, body.radius_m, strict=True):
        wide = 2.0 * radius_m
        for centre_m in (start_m, end_m):
            pose = {"position": vector_fields(centre_m), "orientation": UNTURNED}
            spheres.append({"pose": pose, "size": vector_fields(np.full(3, wide)), **look})
        length_m = float(np.linalg.norm(end_m - start_m))
        if length_m > 0.0:
            turn = vector_fields(quaternion_xyzw_from_rotation(_along_z((end_m - start_m) / length_m)))
            pose = {"position": vector_fields(0.5 * (start_m + end_m)), "orientation": turn}
            size = vector_fields(np.array([wide, wide, length_m]))
            cylinders.append({"pose": pose, "size": size, "bottom_scale": 1.0, "top_scale": 1.0, **look})
    return {"spheres": spheres, "cylinders": cylinders}


def _segment(segment: draw.Segment) -> Fields:
    look = {"color": _colour(draw.COLOURS[segment.part]), "scale_invariant": True}
    ends = list(map(vector_fields, (segment.start_m, segment.end_m)))
    line = {"type": "LINE_STRIP", "pose": {"orientation": UNTURNED}, "thickness": LINE_PIXELS}
    pose = {"position": vector_fields(0.5 * (segment.start_m + segment.end_m)), "orientation": UNTURNED}
    text = {"pose": pose, "billboard": True, "font_size": TEXT_PIXELS, "text": segment.text}
    return {"lines": [line | look | {"points": ends}], "texts": [text | look]}


def _along_z(direction: Array) -> Array:
    """A rotation, shape (3, 3), whose z axis is a unit vector, shape (3,)."""
    side = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(direction, side), direction], -1)


def _colour(colour: draw.Rgb, alpha: float = 1.0) -> Fields:
    r, g, b = (level / 255.0 for level in colour)
    return {"r": r, "g": g, "b": b, "a": alpha}


def _descriptor_set(file: Any) -> bytes:
    """A protobuf file with those that it imports, each behind its own, as an MCAP schema has them."""

    def with_imports(file: Any) -> list[Any]:
        return [one for dependency in file.dependencies for one in with_imports(dependency)] + [file]

    descriptors = FileDescriptorSet()
    for one in dict.fromkeys(with_imports(file)):
        one.CopyToProto(descriptors.file.add())
    return descriptors.SerializeToString(deterministic=True)


CHUNK_BYTES = 240 * 1024  # leaves room in 256 KiB for the schemas and channels that a chunk may have to declare
CHUNK_SPAN_NS = 250_000_000  # what a killed recorder loses; not in wall time, for a rerun shall be byte-identical
MESSAGE_HEAD_BYTES = 9 + 22  # of a record, and of a message in it


class RecordingWriter:
    """Writes samples to `NAME.mcap.part` and renames the file when it is complete.

    >>> with RecordingWriter(path, {"scenario": "sweep"}) as writer:      # doctest: +SKIP
    ...     writer.write("/tf", sample)

    An exception inside the block keeps the `.part` file, unless it has no message or the disk is full. Chunks hold at
    most 256 KiB, or one message that is larger. `metadata` becomes the record `svmdist`; images become PNG, or JPEG of
    a quality from 1 to 100. UsageError when the file exists without `force`, OutputError when it cannot be written.
    """

    def __init__(
        self, path: Path, metadata: Mapping[str, str], *, force: bool = False, jpeg_quality: int | None = None
    ) -> None:
        self.path = Path(path)
        self.part_path = self.path.with_name(self.path.name + ".part")
        self._metadata, self._force, self._jpeg_quality = dict(metadata), force, jpeg_quality
        self._file: IO[bytes] | None = None
        self._channels: dict[str, tuple[int, str]] = {}
        self._schemas: dict[str, int] = {}
        self.counts = Counter[str]()  # of the messages that were written, by topic
        self._chunk_bytes = self._chunk_start_ns = 0

    def discard(self) -> None:
        """Remove the `.part` file where it is this writer's own."""
        if self._file is not None:
            with suppress(OSError):
                self.part_path.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        if self.path.is_dir():
            raise OutputError(f"{self.path}: is a directory, expected the name of a file to write")
        self._refuse_to_replace(self.path)
        self._refuse_to_replace(self.part_path)
        with self._writing():
            if self._force:
                self.part_path.unlink(missing_ok=True)
            self._file = open(self.part_path, "xb")  # which follows no link that somebody has put there
            # This class ends the chunks, before they grow too large.
            self._writer = Writer(self._file, 1 << 40, CompressionType.ZSTD, enable_data_crcs=True)
            self._writer.start(library=f"svmdist {version('svmdist')}")
            self._writer.add_metadata(METADATA_NAME, dict(sorted(self._metadata.items())))
            self._file.flush()
        return self

    def write(self, topic: str, sample: samples.Sample | EncodedSample) -> None:
        """Append a sample, its stamp as log time; OutputError, ValueError for a topic of another type."""
        if not isinstance(sample, EncodedSample):
            sample = encode(sample, self._jpeg_quality)
        stamp_ns, needed_bytes = sample.stamp_ns, MESSAGE_HEAD_BYTES + len(sample.data)
        with self._writing():
            is_over = abs(stamp_ns - self._chunk_start_ns) >= CHUNK_SPAN_NS
            if self._chunk_bytes and (is_over or self._chunk_bytes + needed_bytes > CHUNK_BYTES):
                self._writer.flush()
                self._chunk_bytes = 0
            channel_id = self._channel(topic, sample.schema)
            self._writer.add_message(channel_id, stamp_ns, sample.data, stamp_ns, self.counts[topic])
        self.counts[topic] += 1
        if not self._chunk_bytes:
            self._chunk_start_ns = stamp_ns
        self._chunk_bytes += needed_bytes

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> None:
        assert self._file is not None
        if self._channels and isinstance(error, KeyboardInterrupt | OutputError) and self.part_path.exists():
            error.add_note(f"what was recorded until then is in {self.part_path}")
        if self._file.closed:
            return
        if error is not None:
            # Keep what there is; the caller's exception matters more than another one from here.
            with suppress(OSError):
                self._writer.flush()
            with suppress(OSError):
                self._file.close()
            if not self._channels:  # there is nothing in it worth keeping
                self.discard()
            return
        with self._writing():
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())  # a full disk may show only here
            self._file.close()
            self._refuse_to_replace(self.path)
            self.part_path.replace(self.path)

    def _channel(self, topic: str, schema: str) -> int:
        if topic not in self._channels:
            if schema not in self._schemas:
                described = _descriptor_set(message_class(schema).DESCRIPTOR.file)
                self._schemas[schema] = self._writer.register_schema(schema, "protobuf", described)
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", self._schemas[schema]), schema
        channel_id, known = self._channels[topic]
        if known != schema:
            raise ValueError(f"{topic} carries {known}, not {schema}")
        return channel_id

    def _refuse_to_replace(self, path: Path) -> None:
        if not self._force and os.path.lexists(path):
            what = "is left from an interrupted recording" if path == self.part_path else "exists already"
            raise UsageError(f"{path}: {what}; give another name, or --force to replace it")

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as problem:
            if self._file is not None:
                # Closing tries to write the rest once more and fails in the same way.
                with suppress(OSError):
                    self._file.close()
                if problem.errno in NO_SPACE:  # what is left would keep the disk full
                    self.discard()
            raise OutputError(f"{self.path}: cannot write: {why(problem)}") from problem

"""Drawings of frames as messages that viewers show: annotations of the image, the scene, transforms and log lines."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from svmdist import drawing as draw
from svmdist.geometry import Capsules, Mesh
from svmdist.recording.distance_estimate_pb2 import DistanceEstimate
from svmdist.recording.writer import EncodedSample, encode, serialised
from svmdist.samples import Image, TransformSample, TransformsSample
from svmdist.transforms import Array, quaternion_xyzw_from_rotation

FORMS = {
    draw.Form.POINTS: PointsAnnotation.POINTS,
    draw.Form.LINE: PointsAnnotation.LINE_STRIP,
    draw.Form.LOOP: PointsAnnotation.LINE_LOOP,
}
GROUND: draw.Rgb = (20, 20, 20)
LINE_PX, POINT_PX, SMALL_POINT_PX, FONT_PX = 2.0, 6.0, 3.0, 14.0
LINE_PIXELS, TEXT_PIXELS = 3.0, 14.0
"""Of lines and texts in space, in px of the screen."""
SOLID, SHEER = 0.9, 0.5
CHANNELS = ("red", "green", "blue", "alpha")
UNTURNED = {"w": 1.0}
Fields = dict[str, Any]
"""Of a message, by their names; protobuf makes messages of those inside."""


def image_annotations(drawing: draw.FrameDrawing) -> EncodedSample:
    """The shapes, labels and status lines of an image as `foxglove.ImageAnnotations`."""
    texts = [(label.text, label.place_px, draw.COLOURS[label.part]) for label in drawing.labels]
    for row, line in enumerate(drawing.lines):
        texts.append((line.text, np.array([4.0, (row + 1) * (FONT_PX + 6.0)]), line.colour))
    stamp = _stamp(drawing.stamp_ns)
    look = {"font_size": FONT_PX, "background_color": _colour(GROUND, SOLID), "timestamp": stamp}
    points = [_points(shape) | {"timestamp": stamp} for shape in drawing.shapes]
    written = [
        {"text": text, "position": _vector(place_px), "text_color": _colour(colour), **look}
        for text, place_px, colour in texts
    ]
    return _encoded(ImageAnnotations, drawing.stamp_ns, points=points, texts=written)


def scene_update(drawing: draw.FrameDrawing, instruments: Iterable[str], frame_id: str) -> EncodedSample:
    """Instruments, tissue and distances in space as `foxglove.SceneUpdate`; what is not there now is deleted."""
    shown = {f"{name} instrument": _capsules(body) for name, body in drawing.bodies.items()}
    if isinstance(drawing.tissue, Mesh):
        triangles = {
            "pose": {"orientation": UNTURNED},
            "color": _colour(draw.COLOURS[draw.Part.TISSUE], SHEER),
            "points": list(map(_vector, drawing.tissue.vertices_m)),
            "indices": drawing.tissue.faces.ravel().tolist(),
        }
        shown["tissue"] = {"triangles": [triangles]}
    shown |= {segment.name: _segment(segment) for segment in drawing.segments}
    parts = ("instrument", draw.Part.DISTANCE, draw.Part.BETWEEN)
    possible = {"tissue", *(f"{name} {part}" for name in instruments for part in parts)}
    gone, stamp = {"type": SceneEntityDeletion.MATCHING_ID}, {"timestamp": _stamp(drawing.stamp_ns)}
    entities = [{"id": name, "frame_id": frame_id, **stamp, **of} for name, of in shown.items()]
    deletions = [{"id": name, **gone, **stamp} for name in sorted(possible - shown.keys())]
    return _encoded(SceneUpdate, drawing.stamp_ns, entities=entities, deletions=deletions)


def point_cloud(points_m: Array, std_m: Array, bgr: Image, frame_id: str, stamp_ns: int) -> EncodedSample:
    """Points, shape (n, 3), with a deviation each, (n,), and a colour, (n, 3), as `foxglove.PointCloud`."""
    kinds = [*((name, "<f4") for name in ("x", "y", "z", "std_m")), *((name, "u1") for name in CHANNELS)]
    packed = np.empty(len(points_m), kinds)
    for (name, _), values in zip(kinds, (*points_m.T, std_m, *bgr[:, ::-1].T, 255), strict=True):
        packed[name] = values
    numbers = {"<f4": PackedElementField.FLOAT32, "u1": PackedElementField.UINT8}
    offsets: Any = packed.dtype.fields
    return _encoded(
        PointCloud,
        stamp_ns,
        frame_id=frame_id,
        pose={"orientation": UNTURNED},
        point_stride=packed.itemsize,
        fields=[{"name": name, "offset": offsets[name][1], "type": numbers[kind]} for name, kind in kinds],
        data=packed.tobytes(),
    )


def tool_transforms(poses: Iterable[tuple[str, Array]], frame_id: str, stamp_ns: int) -> EncodedSample:
    """Estimated poses of tools as `foxglove.FrameTransforms`: (child frame, `T_camera_tool` of shape (4, 4)) pairs."""
    transforms = tuple(TransformSample(stamp_ns, frame_id, child, T) for child, T in poses)
    return encode(TransformsSample(stamp_ns, transforms))


def distance_estimate(fields: Mapping[str, Any], stamp_ns: int) -> EncodedSample:
    """What was measured of one instrument as `svmdist.DistanceEstimate`; a field that is None is left out."""
    return _encoded(DistanceEstimate, stamp_ns, **fields)


def log_line(text: str, stamp_ns: int, *, is_warning: bool) -> EncodedSample:
    """A line of `foxglove.Log`, as a warning or for information."""
    level = Log.WARNING if is_warning else Log.INFO
    return _encoded(Log, stamp_ns, level=level, message=text, name="svmdist")


def _encoded(kind: Any, stamp_ns: int, **fields: Any) -> EncodedSample:
    """A message as the sample that `RecordingWriter` takes; a scene has no timestamp of its own."""
    has_stamp = "timestamp" in kind.DESCRIPTOR.fields_by_name
    return EncodedSample(stamp_ns, kind, serialised(kind(**fields), stamp_ns if has_stamp else None))


def _points(shape: draw.Shape) -> Fields:
    colour = _colour(draw.COLOURS[shape.part])
    look: Fields = {"outline_color": colour, "thickness": LINE_PX}
    if shape.form is draw.Form.POINTS:
        is_small = shape.part in (draw.Part.INLIER, draw.Part.MATCH)
        look |= {"fill_color": colour, "thickness": SMALL_POINT_PX if is_small else POINT_PX}
    return {"type": FORMS[shape.form], "points": list(map(_vector, shape.points_px)), **look}


def _capsules(body: Capsules) -> Fields:
    """Each capsule as a cylinder with a sphere at both ends."""
    look = {"color": _colour(draw.COLOURS[draw.Part.SHAFT], SOLID)}
    spheres, cylinders = list[Fields](), list[Fields]()
    for start_m, end_m, radius_m in zip(body.start_m, body.end_m, body.radius_m, strict=True):
        wide = 2.0 * radius_m
        for centre_m in (start_m, end_m):
            pose = {"position": _vector(centre_m), "orientation": UNTURNED}
            spheres.append({"pose": pose, "size": _vector(np.full(3, wide)), **look})
        length_m = float(np.linalg.norm(end_m - start_m))
        if length_m > 0.0:
            turn = _vector(quaternion_xyzw_from_rotation(_along_z((end_m - start_m) / length_m)))
            pose = {"position": _vector(0.5 * (start_m + end_m)), "orientation": turn}
            size = _vector(np.array([wide, wide, length_m]))
            cylinders.append({"pose": pose, "size": size, "bottom_scale": 1.0, "top_scale": 1.0, **look})
    return {"spheres": spheres, "cylinders": cylinders}


def _segment(segment: draw.Segment) -> Fields:
    look = {"color": _colour(draw.COLOURS[segment.part]), "scale_invariant": True}
    ends_m = segment.start_m, segment.end_m
    line = {
        "type": LinePrimitive.LINE_STRIP,
        "pose": {"orientation": UNTURNED},
        "points": list(map(_vector, ends_m)),
        "thickness": LINE_PIXELS,
    }
    pose = {"position": _vector(0.5 * (segment.start_m + segment.end_m)), "orientation": UNTURNED}
    text = {"pose": pose, "billboard": True, "font_size": TEXT_PIXELS, "text": segment.text}
    return {"lines": [line | look], "texts": [text | look]}


def _along_z(direction: Array) -> Array:
    """A rotation, shape (3, 3), whose z axis is a unit vector, shape (3,)."""
    side = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(direction, side), direction], -1)


def _colour(colour: draw.Rgb, alpha: float = 1.0) -> Fields:
    r, g, b = (level / 255.0 for level in colour)
    return {"r": r, "g": g, "b": b, "a": alpha}


def _stamp(stamp_ns: int) -> Fields:
    return dict(zip(("seconds", "nanos"), divmod(stamp_ns, 1_000_000_000), strict=True))


def _vector(values: Array) -> Fields:
    """A point or vector, shape (2,) or (3,), or a quaternion x, y, z, w, shape (4,)."""
    return dict(zip("xyzw", values.tolist(), strict=False))

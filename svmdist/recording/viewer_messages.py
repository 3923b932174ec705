"""Drawings of frames as messages that viewers show: annotations of the image, the scene, transforms and log lines."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from svmdist import drawing as draw
from svmdist.geometry import Capsules
from svmdist.recording.distance_estimate_pb2 import DistanceEstimate
from svmdist.recording.writer import EncodedSample, encode, serialised, set_stamp
from svmdist.samples import TransformSample, TransformsSample
from svmdist.transforms import Array, quaternion_xyzw_from_rotation

FORMS = {
    draw.Form.POINTS: PointsAnnotation.POINTS,
    draw.Form.LINE: PointsAnnotation.LINE_STRIP,
    draw.Form.LOOP: PointsAnnotation.LINE_LOOP,
}
WHITE: draw.Rgb = (255, 255, 255)
GROUND: draw.Rgb = (20, 20, 20)
LINE_PX, POINT_PX, SMALL_POINT_PX, FONT_PX = 2.0, 6.0, 3.0, 14.0
LINE_PIXELS, TEXT_PIXELS = 3.0, 14.0
"""Of lines and texts in space, in px of the screen."""
SOLID, SHEER = 0.9, 0.5


def image_annotations(drawing: draw.FrameDrawing) -> EncodedSample:
    """The shapes, labels and status lines of an image as `foxglove.ImageAnnotations`."""
    message = ImageAnnotations()
    for shape in drawing.shapes:
        _points(message.points.add(), shape, drawing.stamp_ns)
    for label in drawing.labels:
        _text(message.texts.add(), label.text, label.place_px, draw.COLOURS[label.part], drawing.stamp_ns)
    for row, line in enumerate(drawing.lines):
        place_px = np.array([4.0, (row + 1) * (FONT_PX + 6.0)])
        colour = draw.ALARM_COLOUR if line.alarm or not line.measured else WHITE
        _text(message.texts.add(), line.text, place_px, colour, drawing.stamp_ns)
    return _encoded(message, drawing.stamp_ns)


def scene_update(drawing: draw.FrameDrawing, instruments: Iterable[str], frame_id: str) -> EncodedSample:
    """Instruments, tissue and distances in space as `foxglove.SceneUpdate`; what is not there now is deleted."""
    message, stamp_ns = SceneUpdate(), drawing.stamp_ns
    for name, body in drawing.bodies.items():
        _capsules(_entity(message, f"{name} instrument", frame_id, stamp_ns), body)
    if drawing.tissue is not None:
        triangles = _entity(message, "tissue", frame_id, stamp_ns).triangles.add()
        triangles.pose.orientation.w = 1.0
        _colour(triangles.color, draw.COLOURS[draw.Part.TISSUE], SHEER)
        for corner in drawing.tissue.vertices_m.tolist():
            triangles.points.add(x=corner[0], y=corner[1], z=corner[2])
        triangles.indices.extend(drawing.tissue.faces.ravel().tolist())
    for segment in drawing.segments:
        _segment(_entity(message, segment.name, frame_id, stamp_ns), segment)
    known = {entity.id for entity in message.entities}
    parts = ("instrument", draw.Part.DISTANCE, draw.Part.BETWEEN)
    possible = {"tissue", *(f"{name} {part}" for name in instruments for part in parts)}
    for name in sorted(possible - known):
        deletion = message.deletions.add(type=SceneEntityDeletion.MATCHING_ID, id=name)
        set_stamp(deletion, stamp_ns)
    return _encoded(message, stamp_ns)


def tool_transforms(poses: Iterable[tuple[str, Array]], frame_id: str, stamp_ns: int) -> EncodedSample:
    """Estimated poses of tools as `foxglove.FrameTransforms`: (child frame, `T_camera_tool` of shape (4, 4)) pairs."""
    transforms = tuple(TransformSample(stamp_ns, frame_id, child, T) for child, T in poses)
    return encode(TransformsSample(stamp_ns, transforms))


def distance_estimate(fields: Mapping[str, Any], stamp_ns: int) -> EncodedSample:
    """What was measured of one instrument as `svmdist.DistanceEstimate`; a field that is None is left out."""
    return _encoded(DistanceEstimate(**fields), stamp_ns)


def log_line(text: str, stamp_ns: int, *, is_warning: bool) -> EncodedSample:
    """A line of `foxglove.Log`, as a warning or for information."""
    message = Log(level=Log.WARNING if is_warning else Log.INFO, message=text, name="svmdist")
    return _encoded(message, stamp_ns)


def _encoded(message: Any, stamp_ns: int) -> EncodedSample:
    """A message as the sample that `RecordingWriter` takes; a scene has no timestamp of its own."""
    has_stamp = "timestamp" in message.DESCRIPTOR.fields_by_name
    return EncodedSample(stamp_ns, type(message), serialised(message, stamp_ns if has_stamp else None))


def _points(target: Any, shape: draw.Shape, stamp_ns: int) -> None:
    target.type = FORMS[shape.form]
    for x, y in shape.points_px.tolist():
        target.points.add(x=x, y=y)
    _colour(target.outline_color, draw.COLOURS[shape.part])
    target.thickness = LINE_PX
    if shape.form is draw.Form.POINTS:
        target.thickness = SMALL_POINT_PX if shape.part in (draw.Part.INLIER, draw.Part.MATCH) else POINT_PX
        _colour(target.fill_color, draw.COLOURS[shape.part])
    set_stamp(target, stamp_ns)


def _text(target: Any, text: str, place_px: Array, colour: draw.Rgb, stamp_ns: int) -> None:
    target.position.x, target.position.y = place_px.tolist()
    target.text, target.font_size = text, FONT_PX
    _colour(target.text_color, colour)
    _colour(target.background_color, GROUND, SOLID)
    set_stamp(target, stamp_ns)


def _entity(message: Any, name: str, frame_id: str, stamp_ns: int) -> SceneEntity:
    entity: SceneEntity = message.entities.add(id=name, frame_id=frame_id)
    set_stamp(entity, stamp_ns)
    return entity


def _capsules(entity: Any, body: Capsules) -> None:
    """Each capsule as a cylinder with a sphere at both ends."""
    colour = draw.COLOURS[draw.Part.INSTRUMENT]
    for start_m, end_m, radius_m in zip(body.start_m, body.end_m, body.radius_m, strict=True):
        for centre_m in (start_m, end_m):
            sphere = entity.spheres.add()
            _place(sphere.pose.position, centre_m)
            sphere.pose.orientation.w = 1.0
            sphere.size.x = sphere.size.y = sphere.size.z = 2.0 * radius_m
            _colour(sphere.color, colour, SOLID)
        length_m = float(np.linalg.norm(end_m - start_m))
        if length_m > 0.0:
            cylinder = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0)
            _place(cylinder.pose.position, 0.5 * (start_m + end_m))
            _turn(cylinder.pose.orientation, _along_z((end_m - start_m) / length_m))
            cylinder.size.x = cylinder.size.y = 2.0 * radius_m
            cylinder.size.z = length_m
            _colour(cylinder.color, colour, SOLID)


def _segment(entity: Any, segment: draw.Segment) -> None:
    line = entity.lines.add(type=LinePrimitive.LINE_STRIP, thickness=LINE_PIXELS, scale_invariant=True)
    line.pose.orientation.w = 1.0
    for end_m in (segment.start_m, segment.end_m):
        line.points.add(x=end_m[0], y=end_m[1], z=end_m[2])
    _colour(line.color, draw.COLOURS[segment.part])
    text = entity.texts.add(billboard=True, font_size=TEXT_PIXELS, scale_invariant=True, text=segment.text)
    text.pose.orientation.w = 1.0
    _place(text.pose.position, 0.5 * (segment.start_m + segment.end_m))
    _colour(text.color, draw.COLOURS[segment.part])


def _along_z(direction: Array) -> Array:
    """A rotation, shape (3, 3), whose z axis is a unit vector, shape (3,)."""
    side = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(direction, side), direction], -1)


def _colour(target: Color, colour: draw.Rgb, alpha: float = 1.0) -> None:
    target.r, target.g, target.b = (level / 255.0 for level in colour)
    target.a = alpha


def _place(target: Any, place_m: Array) -> None:
    target.x, target.y, target.z = (float(value) for value in place_m)


def _turn(target: Any, R: Array) -> None:
    target.x, target.y, target.z, target.w = quaternion_xyzw_from_rotation(R).tolist()

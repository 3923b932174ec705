"""Drawings of frames as messages that viewers show: annotations of the image, the scene, transforms and log lines."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from svmdist import drawing as draw
from svmdist.geometry import Capsules, Mesh
from svmdist.recording.writer import EncodedSample, Fields, encoded, stamp_fields, vector_fields
from svmdist.samples import Image
from svmdist.transforms import Array, quaternion_xyzw_from_rotation

FORMS = {draw.Form.POINTS: "POINTS", draw.Form.LINE: "LINE_STRIP", draw.Form.LOOP: "LINE_LOOP"}
GROUND: draw.Rgb = (20, 20, 20)
LINE_PX, POINT_PX, SMALL_POINT_PX, FONT_PX = 2.0, 6.0, 3.0, 14.0
LINE_PIXELS, TEXT_PIXELS = 3.0, 14.0  # of lines and texts in space, in px of the screen
SOLID, SHEER = 0.9, 0.5
UNTURNED = {"w": 1.0}


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


def point_cloud(points_m: Array, std_m: Array, bgr: Image, frame_id: str, stamp_ns: int) -> EncodedSample:
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

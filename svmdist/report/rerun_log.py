"""A log with what a method found as a recording for Rerun, which draws no annotations of Foxglove's."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as views
from rerun import escape_entity_path_part as escaped

from svmdist.drawing import ALARM_COLOUR, COLOURS, Form, FrameDrawing, Part
from svmdist.files import atomic_file
from svmdist.geometry import Mesh
from svmdist.recording.log import Recording
from svmdist.report.annotated import tool_poses, warnings
from svmdist.report.rows import estimate_fields
from svmdist.workflows.frame_drawing import DrawnFrame
from svmdist.workflows.request import Setup

SHOWN = ("planar", "spatial", "clearance", "clearance_low", "clearance_high", "to_instrument")
"""The distances over time, by their fields in `svmdist.DistanceEstimate` without the unit; shown in mm."""
IMAGE, DRAWN, SCENE = "camera/image", "camera/image/drawn", "camera/scene"
LINE_PX, POINT_PX, CLOUD_M, LINE_M, AXIS_M = 1.0, 3.0, 3e-4, 2e-4, 0.01
JPEG_QUALITY = 90


def write_rrd(frames: Iterable[DrawnFrame], path: Path, recording: Recording, setup: Setup, *_: object) -> None:
    """Write images, drawings on them and in space, and distances over time; raises OutputError."""
    stream = rr.RecordingStream("svmdist", recording_id=f"{recording.name}-{setup.method}")
    camera = recording.logged_camera
    with atomic_file(path) as file, TemporaryDirectory() as folder:  # the library writes to a path of its own
        made = Path(folder) / "made.rrd"
        stream.save(made, _layout())
        stream.log("camera", rr.ViewCoordinates.RDF, static=True)
        size_px = [camera.width_px, camera.height_px]
        stream.log(IMAGE, rr.Pinhole(image_from_camera=camera.K, resolution=size_px), static=True)
        for frame in frames:
            stream.set_time("frame", sequence=frame.number)
            stream.set_time("time", timestamp=np.datetime64(frame.drawing.stamp_ns, "ns"))
            _log_frame(stream, frame, setup)
        stream.disconnect()
        with made.open("rb") as written:
            shutil.copyfileobj(written, file)


def _layout() -> views.Blueprint:
    image, scene = views.Spatial2DView(origin=IMAGE, name="image"), views.Spatial3DView(origin="camera", name="scene")
    distances = views.TimeSeriesView(origin="distances", name="distances [mm]")
    alarms, log = views.TimeSeriesView(origin="alarms", name="alarm"), views.TextLogView(origin="log", name="log")
    numbers = views.Vertical(distances, alarms, log, row_shares=[3, 1, 2])
    return views.Blueprint(views.Horizontal(views.Vertical(image, scene), numbers), collapse_panels=True)


def _log_frame(stream: rr.RecordingStream, frame: DrawnFrame, setup: Setup) -> None:
    drawing, image = frame.drawing, frame.replayed.image_bgr
    for place in (DRAWN, SCENE):  # nothing stays from the frame before
        stream.log(place, rr.Clear(recursive=True))
    if image is not None:
        jpeg = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))[1].tobytes()
        stream.log(IMAGE, rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))
    for place, found in ((DRAWN, _on_image(drawing)), (SCENE, _in_space(drawing))):
        for name, what in found.items():
            stream.log(f"{place}/{escaped(name)}", what)
    for name, T_camera_tool in tool_poses(frame.replayed.results):
        turn = rr.Transform3D(translation=T_camera_tool[:3, 3], mat3x3=T_camera_tool[:3, :3])
        stream.log(f"{SCENE}/{escaped(name)}", turn, rr.TransformAxes3D(AXIS_M))
    for result in frame.replayed.results:
        fields: Any = estimate_fields(result, setup.method)
        name = escaped(result.instrument)
        for key in SHOWN:
            if (distance_m := fields.get(f"{key}_m")) is not None:
                stream.log(f"distances/{name}/{key}", rr.Scalars(1e3 * distance_m))
        if (alarm := fields.get("alarm")) is not None:
            stream.log(f"alarms/{name}", rr.Scalars(float(alarm)))
    for text in warnings(drawing):
        stream.log("log", rr.TextLog(text, level="WARN", color=ALARM_COLOUR))


def _on_image(drawing: FrameDrawing) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for part in Part:
        shapes = [one for one in drawing.shapes if one.part is part]
        points = [one.points_px for one in shapes if one.form is Form.POINTS]
        lines = [one for one in shapes if one.form is not Form.POINTS]
        if lines:
            strips = [np.vstack([one.points_px, one.points_px[: one.form is Form.LOOP]]) for one in lines]
            found[str(part)] = rr.LineStrips2D(strips, colors=COLOURS[part], radii=LINE_PX)
        if points:
            found[f"{part} points"] = rr.Points2D(np.concatenate(points), colors=COLOURS[part], radii=POINT_PX)
    if drawing.labels:
        places, texts = zip(*((one.place_px, one.text) for one in drawing.labels), strict=True)
        colours = [COLOURS[one.part] for one in drawing.labels]
        found["labels"] = rr.Points2D(places, labels=texts, colors=colours, radii=0.0, show_labels=True)
    return found


def _in_space(drawing: FrameDrawing) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, body in drawing.bodies.items():
        capsules: Any = np.stack([body.start_m, body.end_m], 1)
        colours = [COLOURS[Part.WRIST if at else Part.SHAFT] for at in range(len(body))]
        found[f"{name} instrument"] = rr.LineStrips3D(capsules, radii=body.radius_m, colors=colours)
    if isinstance(drawing.tissue, Mesh):
        vertices_m, faces = drawing.tissue.vertices_m, drawing.tissue.faces
        colour = COLOURS[Part.TISSUE]
        found["tissue"] = rr.Mesh3D(vertex_positions=vertices_m, triangle_indices=faces, albedo_factor=colour)
    if drawing.cloud_m is not None:
        found["surface"] = rr.Points3D(drawing.cloud_m, colors=COLOURS[Part.TISSUE], radii=CLOUD_M)
    for one in drawing.segments:
        ends_m = [np.stack([one.start_m, one.end_m])]
        found[one.name] = rr.LineStrips3D(ends_m, labels=one.text, colors=COLOURS[one.part], radii=LINE_M)
    return found

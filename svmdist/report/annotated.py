"""A log with what a method found drawn on its images: a copy for viewers, one for Rerun, and a video."""

from __future__ import annotations

import heapq
import shutil
from collections.abc import Iterable, Iterator
from fractions import Fraction
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from svmdist.drawing import ALARM_COLOUR, COLOURS, Form, FrameDrawing, Part
from svmdist.errors import OutputError
from svmdist.files import atomic_file
from svmdist.geometry import Mesh
from svmdist.recording import writer
from svmdist.recording.log import Recording
from svmdist.recording.summary import copied_messages
from svmdist.recording.topics import Role
from svmdist.recording.writer import EncodedSample, RecordingWriter, encoded
from svmdist.report.on_image import draw_on
from svmdist.report.rows import estimate_fields
from svmdist.results import FrameResult
from svmdist.samples import Sample, TransformSample, TransformsSample
from svmdist.transforms import Array
from svmdist.workflows.frame_drawing import DrawnFrame
from svmdist.workflows.request import Setup

SCENE_TOPIC, TF_TOPIC, LOG_TOPIC, SURFACE_TOPIC = (f"/svmdist/{name}" for name in ("scene", "tf", "log", "surface"))
PLOTTED = ("planar", "spatial", "clearance", "clearance_low", "clearance_high", "to_instrument")
"""The distances over time, by their fields in `svmdist.DistanceEstimate` without the unit; shown in mm."""
IMAGE, DRAWN, SCENE = "camera/image", "camera/image/drawn", "camera/scene"
LINE_PX, POINT_PX, CLOUD_M, LINE_M, AXIS_M, JPEG_QUALITY = 1.0, 3.0, 3e-4, 2e-4, 0.01, 90
"""How drawings look in Rerun, which draws no annotations of Foxglove's."""
TIME_BASE = Fraction(1, 1000)  # frames are shown at their stamps: a log has no constant rate
CODECS = {"libx264": {"crf": "20", "preset": "veryfast"}, "mpeg4": {}}
"""The first that this build of FFmpeg has, with its options. H.264 plays everywhere; MPEG-4 is in every build."""
LARGEST_STEP_MS = 10_000  # a pause of a log is shown no longer than this


def write_annotated(
    frames: Iterable[DrawnFrame], output: Path, recording: Recording, setup: Setup, force: bool = False
) -> None:
    """Copy a recording, each image followed by what was drawn of it; UsageError where that exists, unless `force`."""
    copies = copied_messages(recording.origin.open())  # anew, so that losses are counted once
    metadata = {**recording.metadata, "annotated_by": f"svmdist estimate --method {setup.method}"}
    with RecordingWriter(output, metadata, force=force) as copy:
        annotations = _annotations(recording, frames, setup)
        for topic, message in heapq.merge(copies, annotations, key=lambda pair: pair[1].stamp_ns):
            copy.write(topic, message)


def _annotations(
    recording: Recording, frames: Iterable[DrawnFrame], setup: Setup
) -> Iterator[tuple[str, Sample | EncodedSample]]:
    frame_id = recording.logged_camera.frame_id
    for at, frame in enumerate(frames):
        drawing, stamp_ns, results = frame.drawing, frame.drawing.stamp_ns, frame.replayed.results
        if at == 0:
            text = f"svmdist {version('svmdist')}, method {setup.method}, profile {setup.profile.name}"
            yield LOG_TOPIC, writer.log_line(text, stamp_ns, is_warning=False)
        # Below the image's topic: viewers that go by names lay it over the image.
        yield f"{recording.topic_of(Role.IMAGE)}/annotations", writer.image_annotations(drawing)
        for result in results:
            fields = estimate_fields(result, setup.method)  # those that are None are left out
            yield f"/svmdist/{result.instrument}/distance", encoded("svmdist.DistanceEstimate", stamp_ns, **fields)
        if poses := tool_poses(results):
            tools = tuple(TransformSample(stamp_ns, frame_id, child, T) for child, T in poses)
            yield TF_TOPIC, TransformsSample(stamp_ns, tools)
        yield SCENE_TOPIC, writer.scene_update(drawing, [one.instrument for one in results], frame_id)
        scene = frame.replayed.frames[0].scene if frame.replayed.frames else None
        # The tissue's surface where a method looked for it in both views, with an instrument there or not.
        if scene is not None and (surface := vars(scene).get("stereo_surface")) is not None:
            std_m, seen = surface.grid_std_m[surface.is_seen], scene.observation
            colours = surface.colours(seen.image_bgr, seen.camera)
            yield SURFACE_TOPIC, writer.point_cloud(surface.points_m, std_m, colours, frame_id, stamp_ns)
        for text in warnings(drawing):
            yield LOG_TOPIC, writer.log_line(text, stamp_ns, is_warning=True)


def tool_poses(results: Iterable[FrameResult]) -> list[tuple[str, Array]]:
    """Frames of the measured tools by their names, and `T_camera_tool`, shape (4, 4)."""
    measured = (one for one in results if one.measured)
    return [(f"{one.instrument}_tool_estimate", one.tool.pose.T_camera_tool) for one in measured if one.tool]


def warnings(drawing: FrameDrawing) -> list[str]:
    """The lines of rejections and alarms."""
    return [line.text for line in drawing.lines if line.warns]


def write_rrd(frames: Iterable[DrawnFrame], path: Path, recording: Recording, setup: Setup, *_: object) -> None:
    """Write images, drawings on them and in space, and distances over time for Rerun; raises OutputError."""
    import rerun as rr

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


def _layout() -> Any:
    import rerun.blueprint as views

    image, scene = views.Spatial2DView(origin=IMAGE, name="image"), views.Spatial3DView(origin="camera", name="scene")
    distances = views.TimeSeriesView(origin="distances", name="distances [mm]")
    alarms, log = views.TimeSeriesView(origin="alarms", name="alarm"), views.TextLogView(origin="log", name="log")
    numbers = views.Vertical(distances, alarms, log, row_shares=[3, 1, 2])
    return views.Blueprint(views.Horizontal(views.Vertical(image, scene), numbers), collapse_panels=True)


def _log_frame(stream: Any, frame: DrawnFrame, setup: Setup) -> None:
    import rerun as rr
    from rerun import escape_entity_path_part as escaped

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
        for key in PLOTTED:
            if (distance_m := fields.get(f"{key}_m")) is not None:
                stream.log(f"distances/{name}/{key}", rr.Scalars(1e3 * distance_m))
        if (alarm := fields.get("alarm")) is not None:
            stream.log(f"alarms/{name}", rr.Scalars(float(alarm)))
    for text in warnings(drawing):
        stream.log("log", rr.TextLog(text, level="WARN", color=ALARM_COLOUR))


def _on_image(drawing: FrameDrawing) -> dict[str, Any]:
    import rerun as rr

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
    import rerun as rr

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


def write_video(frames: Iterable[DrawnFrame], path: Path, recording: Recording, *_: object) -> None:
    """Write an MP4 as large as the images, black for an unreadable one, with the reason; raises OutputError."""
    import av

    camera = recording.logged_camera
    # The codecs halve the colours' resolution.
    width, height = (length + length % 2 for length in (camera.width_px, camera.height_px))
    begin_ns: int | None = None
    shown_ms = -1
    with atomic_file(path) as file:
        try:
            with av.open(file, "w", format="mp4") as container:
                codec = next(name for name in CODECS if name in av.codecs_available)
                stream: Any = container.add_stream(codec, rate=30, options=CODECS[codec])
                stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
                stream.codec_context.time_base = TIME_BASE
                for frame in frames:
                    stamp_ns = frame.drawing.stamp_ns
                    begin_ns = stamp_ns if begin_ns is None else begin_ns
                    log_ms = round((stamp_ns - begin_ns) / 1e6)
                    # Clocks that are set back, or forth, make no gaps: a video's time only goes on.
                    at_ms = min(max(log_ms, shown_ms + 1), shown_ms + LARGEST_STEP_MS)
                    begin_ns, shown_ms = begin_ns + (log_ms - at_ms) * 1_000_000, at_ms
                    image, padded = frame.replayed.image_bgr, np.zeros((height, width, 3), np.uint8)
                    drawn = draw_on(padded if image is None else image, frame.drawing)[:height, :width]
                    padded[: drawn.shape[0], : drawn.shape[1]] = drawn
                    picture = av.VideoFrame.from_ndarray(padded, format="bgr24")
                    picture.pts, picture.time_base = at_ms, TIME_BASE
                    container.mux(stream.encode(picture))
                container.mux(stream.encode())
        except av.FFmpegError as problem:
            raise OutputError(f"{path}: cannot write: {problem.strerror}") from None

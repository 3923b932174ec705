"""The line of each distance, in space and in the image, and the words for it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from svmdist.camera import Camera
from svmdist.drawing import Body, Form, Label, Part, SceneDrawing, Segment, Shape, StatusLine, Surface
from svmdist.estimation.alarms import AlarmState
from svmdist.estimation.frame import Frame
from svmdist.geometry.surfaces import Mesh
from svmdist.metrics import deviations_at
from svmdist.results import Distance, FrameResult

LEVEL = 0.95


def shown_distance(result: FrameResult) -> tuple[str, Distance] | None:
    """The distance that says most: the clearance, else the spatial, else the planar one; None without any."""
    if not result.measured:
        return None
    distances = result.distances
    named = (
        ("clearance", distances.clearance),
        ("spatial", distances.spatial),
        ("planar", distances.planar),
    )
    return next(((name, found) for name, found in named if found is not None), None)


def interval_m(distance: Distance) -> tuple[float, float] | None:
    """The bounds of the stated 95 % interval; None where the method states none."""
    if distance.std_m is None:
        return None
    half_m = deviations_at(LEVEL) * distance.std_m
    return distance.value_m - half_m, distance.value_m + half_m


def in_words(distance: Distance) -> str:
    """A length and its interval in mm: `4.21 mm [3.40, 5.02]`."""
    bounds_m = interval_m(distance)
    interval = "" if bounds_m is None else f" [{bounds_m[0] * 1e3:.2f}, {bounds_m[1] * 1e3:.2f}]"
    return f"{distance.value_m * 1e3:.2f} mm{interval}"


def status_line(result: FrameResult, method: str, alarm: AlarmState | None = None) -> StatusLine:
    """One line about one instrument's result."""
    who = f"{result.instrument} {method}".strip()
    shown = shown_distance(result)
    if shown is None:
        detail = f" ({result.detail})" if result.detail else ""
        return StatusLine(f"{who}: not measured: {result.status}{detail}", False)
    is_alarm = bool(alarm and alarm.alarm)
    return StatusLine(
        f"{who}: {shown[0]} {in_words(shown[1])}{'  ALARM' if is_alarm else ''}", True, is_alarm
    )


def segments(result: FrameResult) -> Iterator[Segment]:
    """The distances of a result that have a place in space: clearance, and that to another instrument."""
    if not result.measured:
        return
    distances = result.distances
    for part, distance in ((Part.DISTANCE, distances.clearance), (Part.BETWEEN, distances.to_instrument)):
        if distance is None or distance.start_m is None or distance.direction is None:
            continue
        start_m = np.array(distance.start_m)
        end_m = start_m + distance.value_m * np.array(distance.direction)
        yield Segment(f"{result.instrument} {part}".strip(), part, start_m, end_m, in_words(distance))


def distance_shapes(result: FrameResult, lens: Camera) -> Iterator[Shape | Label]:
    """The lines of a result's distances in the recorded image, with their lengths beside them."""
    drawn = [one for one in segments(result) if min(one.start_m[2], one.end_m[2]) > 0.0]
    for one in drawn:
        ends_px = lens.project(np.stack([one.start_m, one.end_m]))
        yield Shape(one.part, Form.LINE, ends_px, result.instrument)
        yield Label(one.part, ends_px.mean(0), one.text)
    if any(one.part is Part.DISTANCE for one in drawn):
        return
    shown, (tool_px, tissue_px) = shown_distance(result), (result.image.tool_px, result.image.tissue_px)
    if shown is not None and shown[0] != "clearance" and tool_px is not None and tissue_px is not None:
        ends_px = np.array([tool_px, tissue_px])
        yield Shape(Part.DISTANCE, Form.LINE, ends_px, result.instrument)
        yield Label(Part.DISTANCE, ends_px.mean(0), f"{shown[0]} {in_words(shown[1])}")


def scene_drawing(frames: tuple[Frame, ...], results: tuple[FrameResult, ...]) -> SceneDrawing:
    """Instruments, tissue and distances in space, as far as the method knows them."""
    bodies = []
    for frame, result in zip(frames, results, strict=True):
        tool, body = result.tool, frame.arm.body
        if tool is not None and body is not None and result.measured:
            posed = body.posed(tool.pose, tool.joints, tool.has_plate)
            bodies.append(Body(result.instrument, posed.start_m, posed.end_m, posed.radius_m))
    tissue = frames[0].scene.found.get("tissue") if frames else None
    surface = None
    if tissue is not None and tissue.pose is not None and isinstance(tissue.pose.surface, Mesh):
        mesh = tissue.pose.surface
        surface = Surface("tissue", mesh.vertices_m, mesh.faces)
    return SceneDrawing(tuple(bodies), surface, tuple(one for result in results for one in segments(result)))

"""The drawing of a replayed frame: the one source of pictures, videos and annotations of recordings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from svmdist.camera import Camera
from svmdist.drawing import Form, FrameDrawing, Label, Shape
from svmdist.estimation.alarms import AlarmState
from svmdist.estimation.frame import Frame
from svmdist.results import FrameResult
from svmdist.transforms import Array
from svmdist.vision.undistortion import seen_through
from svmdist.workflows.drawing.detections import place_shapes, scene_shapes, tool_shapes
from svmdist.workflows.drawing.distances import distance_shapes, scene_drawing, status_line
from svmdist.workflows.drawing.virtual_marker import marker_shapes, virtual_marker
from svmdist.workflows.replay import Replayed
from svmdist.workflows.setup import Setup

BEND_STEP_PX = 10.0
"""A straight line of an ideal camera is drawn in pieces of this length where the lens bends it."""


def frame_drawing(
    replayed: Replayed, setup: Setup, alarms: Mapping[str, AlarmState] | None = None
) -> FrameDrawing:
    """Draw one image of a replay, with the alarms of its instruments by name; pixels are those of the recorded image.

    An image that could not be read has only lines that say so.
    """
    frames, results = replayed.frames, replayed.results
    lines = tuple(
        status_line(result, setup.method, (alarms or {}).get(result.instrument)) for result in results
    )
    if not frames:
        return FrameDrawing(results[0].stamp_ns, lines=lines)
    lens = frames[0].scene.lens
    shapes = list(_through_lens(_detected(frames, results, setup), lens))
    labels: list[Label] = []
    for result in results:
        shapes += place_shapes(result)
        for drawn in distance_shapes(result, lens):
            if isinstance(drawn, Label):
                # Two instruments share the distance between them: it is written once.
                if all(drawn.text != known.text or drawn.part is not known.part for known in labels):
                    labels.append(drawn)
            else:
                shapes.append(drawn)
    scene = scene_drawing(frames, results)
    return FrameDrawing(results[0].stamp_ns, tuple(shapes), tuple(labels), lines, scene)


def _detected(frames: tuple[Frame, ...], results: tuple[FrameResult, ...], setup: Setup) -> Iterable[Shape]:
    yield from scene_shapes(frames[0])
    for frame, result in zip(frames, results, strict=True):
        yield from tool_shapes(frame, result.instrument)
        if setup.method == "overlay":
            found = virtual_marker(frame, frame.arm.profile)
            if found is not None:
                yield from marker_shapes(found, result.instrument)


def _through_lens(shapes: Iterable[Shape], lens: Camera) -> Iterable[Shape]:
    """The shapes where the lens shows them: detectors looked at an image without distortion."""
    if not lens.has_distortion:
        yield from shapes
        return
    for shape in shapes:
        points_px = shape.points_px
        if shape.form is not Form.POINTS:
            points_px = _in_pieces(points_px, is_closed=shape.form is Form.LOOP)
        yield replace(shape, points_px=seen_through(lens, points_px))


def _in_pieces(points_px: Array, *, is_closed: bool) -> Array:
    """The polyline with points no further apart than a step, shape (m, 2)."""
    starts = points_px if is_closed else points_px[:-1]
    ends = np.roll(points_px, -1, axis=0) if is_closed else points_px[1:]
    pieces = []
    for start, end in zip(starts, ends, strict=True):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / BEND_STEP_PX)))
        pieces.append(start + np.linspace(0.0, 1.0, count, endpoint=False)[:, None] * (end - start))
    if not is_closed:
        pieces.append(points_px[-1:])
    return np.concatenate(pieces)

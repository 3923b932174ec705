"""The drawing of a replayed frame: the one source of pictures, videos, reports and annotations of recordings."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.drawing import Form, FrameDrawing, Label, Part, Segment, Shape, StatusLine
from svmdist.estimation.alarms import AlarmRules
from svmdist.estimation.frame import Frame
from svmdist.estimation.instrument.model import shaft_sections
from svmdist.estimation.instrument.shaft import DistalMarker
from svmdist.estimation.planar import MarkerSearch, search_marker
from svmdist.recording.log import Recording
from svmdist.results import Distance, FrameResult
from svmdist.samples import Image, Status
from svmdist.vision.frame_context import seen_through
from svmdist.vision.regions import Region
from svmdist.vision.silhouette import Silhouette
from svmdist.workflows.replay import Replayed, replay
from svmdist.workflows.request import Setup

ANGLES = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
CIRCLE = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
MIN_CONTOUR_PX = 6  # shorter contours are specks
BEND_STEP_PX = 10.0  # a straight line of an ideal camera is drawn in pieces of this length where the lens bends it


@dataclass(frozen=True)
class DrawnFrame:
    """One image of a log: its number, what a method gave, and the drawing."""

    number: int
    seconds: float
    replayed: Replayed
    drawing: FrameDrawing


def drawn_frames(
    recording: Recording,
    setup: Setup,
    jobs: int | None = None,
    numbers: Collection[int] | None = None,
    alarms: AlarmRules | None = None,
) -> Iterator[DrawnFrame]:
    """Replay and draw every image, or some `numbers` up to the last, which are all that progress counts to."""
    if numbers:
        seen, last = recording.on_progress, max(numbers)
        recording = replace(recording, on_progress=lambda done, _: seen(done, last + 1))
    for (replayed,) in replay(recording, [setup], jobs=jobs, alarms=alarms):
        number, seconds = replayed.results[0].number, replayed.results[0].seconds
        if numbers is None or number in numbers:
            yield DrawnFrame(number, seconds, replayed, frame_drawing(replayed, setup))
        if numbers is not None and number >= max(numbers, default=-1):
            return


class Segmented:
    """Stands in for a method where only the masks are shown: it measures nothing."""

    name = "masks"

    def estimate(self, frame: Frame) -> FrameResult:
        """A result without a distance."""
        return FrameResult(frame.scene.observation.stamp_ns, Status.OK)


def frame_drawing(replayed: Replayed, setup: Setup) -> FrameDrawing:
    """Draw one image of a replay in its recorded pixels; one that could not be read has only lines that say so."""
    frames, results = replayed.frames, replayed.results
    lines = tuple(status_line(result, setup.method) for result in results)
    if not frames:
        return FrameDrawing(results[0].stamp_ns, lines=lines)
    scene = frames[0].scene
    shapes = [_through_lens(shape, scene.lens) for shape in _detected(frames, results, setup)]
    labels: dict[tuple[Part, str], Label] = {}
    bodies = {}
    for frame, result in zip(frames, results, strict=True):
        if result.image.tool_px is not None:
            shapes.append(Shape(Part.TIP, Form.POINTS, np.array([result.image.tool_px]), result.instrument))
        if result.image.tissue_px is not None:
            shapes.append(Shape(Part.TISSUE, Form.POINTS, np.array([result.image.tissue_px])))
        for line, label in distance_shapes(result, scene.lens):
            shapes.append(line)
            labels.setdefault((label.part, label.text), label)  # that between two instruments is written once
        tool, body = result.tool, frame.arm.body
        if tool is None or body is None:
            continue
        capsules = body.posed(tool)
        if result.measured:
            bodies[result.instrument] = capsules
        if (seen := shaft_sections(frame.left.camera, capsules)) is not None:  # of a refuted pose, too: it shows why
            shapes.append(_through_lens(Shape(Part.POSE, Form.LOOP, seen.outline_px, result.instrument), scene.lens))
    tissue, cloud = (vars(scene).get(name) for name in ("tissue", "stereo_surface"))
    surfaces = (of for one in frames if (of := one.left.measured_surface) is not None)
    return FrameDrawing(
        results[0].stamp_ns,
        tuple(shapes),
        tuple(labels.values()),
        lines,
        bodies,
        next(surfaces, tissue.pose.surface if tissue is not None and tissue.pose is not None else None),
        tuple(one for result in results for one in segments(result)),
        None if cloud is None else cloud.points_m,
    )


def _detected(frames: tuple[Frame, ...], results: tuple[FrameResult, ...], setup: Setup) -> Iterator[Shape]:
    """The tissue, and of each instrument contours, distal marker, shaft, tag and virtual marker."""
    if (tissue := vars(frames[0].scene).get("tissue")) is not None:
        yield from _contours(frames[0].scene.left.masks.tissue, tissue.region, Part.TISSUE)
        yield Shape(Part.TISSUE, Form.LOOP, np.asarray(tissue.outline.curve_px, np.float64))
    for frame, name in ((frame, result.instrument) for frame, result in zip(frames, results, strict=True)):
        left, found = frame.left, vars(frame.left)
        organ, instrument = found.get("regions_as_recorded") or (None, None)
        if organ is not None:
            yield from _contours(left.masks_as_recorded.tissue, organ, Part.TISSUE)
            yield Shape(Part.TISSUE, Form.POINTS, np.atleast_2d(organ.centroid_px))
        if instrument is not None:
            yield from _contours(left.masks_as_recorded.instrument, instrument, Part.WRIST, name)
        if (region := found.get("region")) is not None:
            yield from _contours(left.masks.instrument, region, Part.WRIST, name)
        if (distal := found.get("distal_marker")) is not None:
            yield _distal_marker(distal, name)
        if (silhouette := found.get("silhouette")) is not None:
            yield from _shaft(silhouette, name)
        if "tags" in vars(frame.scene.left) and (corners_px := left.tag_corners_px) is not None:
            yield Shape(Part.TAG, Form.LOOP, np.asarray(corners_px, np.float64), name)
        pasted = virtual_marker(frame) if setup.method == "overlay" else None
        if pasted is None:
            continue
        if pasted.corners_px is not None:
            yield Shape(Part.MARKER, Form.LOOP, pasted.corners_px + pasted.origin_px, name)
        for part, chosen in ((Part.MATCH, ~pasted.inliers), (Part.INLIER, pasted.inliers)):
            if chosen.any():
                yield Shape(part, Form.POINTS, pasted.matches.frame_px[chosen] + pasted.origin_px, name)


def _through_lens(shape: Shape, lens: Camera) -> Shape:
    """The shape where the lens shows it, in short pieces: detectors looked at an image without distortion."""
    if not lens.has_distortion:
        return shape
    points_px, is_closed = shape.points_px, shape.form is Form.LOOP
    if shape.form is not Form.POINTS:
        pieces = []
        for start, end in pairwise([*points_px, points_px[0]] if is_closed else points_px):
            count = max(1, int(np.ceil(np.linalg.norm(end - start) / BEND_STEP_PX)))
            pieces.append(np.linspace(start, end, count, endpoint=False))
        points_px = np.concatenate(pieces if is_closed else [*pieces, points_px[-1:]])
    return replace(shape, points_px=seen_through(lens, points_px))


def _contours(mask: Image, region: Region, part: Part, name: str = "") -> Iterator[Shape]:
    """The outer contours of a mask, shape (h, w), inside the hull of a region."""
    x, y, width, height = cv2.boundingRect(region.hull)
    inside = np.zeros((height, width), np.uint8)
    cv2.fillConvexPoly(inside, region.hull - np.array([x, y], np.int32), 255)
    yield from contours_of(mask[y : y + height, x : x + width] & inside, part, name, (x, y))


def contours_of(mask: Image, part: Part, name: str = "", offset: tuple[int, int] = (0, 0)) -> Iterator[Shape]:
    """The outer contours of a mask, shape (h, w), whose first pixel is at an offset (x, y)."""
    for contour in cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE, offset=offset)[0]:
        if cv2.arcLength(contour, closed=True) >= MIN_CONTOUR_PX:
            yield Shape(part, Form.LOOP, contour.reshape(-1, 2).astype(np.float64), name)


def _distal_marker(distal: DistalMarker, name: str) -> Shape:
    """The circle of the marker; its centre where no circle fits."""
    circle = distal if distal.disc is None else distal.disc
    if circle.radius_px is None:
        return Shape(Part.DISTAL_MARKER, Form.POINTS, np.atleast_2d(circle.centre_px), name)
    return Shape(Part.DISTAL_MARKER, Form.LOOP, circle.centre_px + circle.radius_px * CIRCLE, name)


def _shaft(silhouette: Silhouette, name: str) -> Iterator[Shape]:
    """The measured edges, as long as the shaft is visible, and its end across its middle line."""
    for edge in silhouette.edges:
        yield Shape(Part.SHAFT, Form.LINE, np.stack([edge.start_px, edge.end_px]), name)
    if silhouette.rim is not None:
        across = np.array([-silhouette.towards_tip[1], silhouette.towards_tip[0]])
        ends_px = silhouette.rim.pixel + 0.5 * silhouette.width_px * np.array([[-1.0], [1.0]]) * across
        yield Shape(Part.SHAFT, Form.LINE, ends_px, name)


def virtual_marker(frame: Frame) -> MarkerSearch | None:
    """Search for the marker as `overlay` did in this frame; None where it pasted none."""
    tissue, instrument = vars(frame.left).get("regions_as_recorded") or (None, None)
    return None if tissue is None or instrument is None else search_marker(frame, instrument.centroid_px)


def _shown_distance(result: FrameResult) -> tuple[str, Distance] | None:
    """The distance that says most: the clearance, else the spatial, else the planar one; None without any."""
    names = ("clearance", "spatial", "planar") if result.measured else ()
    return next(((name, found) for name in names if (found := getattr(result.distances, name))), None)


def in_words(distance: Distance) -> str:
    """A length and its interval in mm: `4.21 mm [3.40, 5.02]`."""
    bounds_m = distance.interval_m
    interval = f" [{bounds_m[0] * 1e3:z.2f}, {bounds_m[1] * 1e3:z.2f}]" if bounds_m else ""
    return f"{distance.value_m * 1e3:z.2f} mm{interval}"


def status_line(result: FrameResult, method: str) -> StatusLine:
    """One line about one instrument's result."""
    who, shown = f"{result.instrument} {method}".strip(), _shown_distance(result)
    if shown is None:
        detail = f" ({result.detail})" if result.detail else ""
        return StatusLine(f"{who}: not measured: {result.status}{detail}", warns=True)
    warns = bool(result.alarm.is_raised)
    return StatusLine(f"{who}: {shown[0]} {in_words(shown[1])}{'  ALARM' * warns}", warns)


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


def distance_shapes(result: FrameResult, lens: Camera) -> list[tuple[Shape, Label]]:
    """The lines of a result's distances in the recorded image, with their lengths beside them."""
    who, drawn = {Part.DISTANCE: result.instrument, Part.BETWEEN: "between"}, []
    for one in segments(result):
        ends_m = np.stack([one.start_m, one.end_m])
        if ends_m[:, 2].min() > 0.0:
            drawn.append((one.part, lens.project(ends_m), f"{who[one.part]} {one.text}".strip()))
    shown, ends = _shown_distance(result), (result.image.tool_px, result.image.tissue_px)
    if shown and shown[0] != "clearance" and None not in ends:
        drawn.append((Part.DISTANCE, np.array(ends), f"{shown[0]} {in_words(shown[1])}"))
    return [
        (Shape(part, Form.LINE, ends_px, result.instrument), Label(part, ends_px.mean(0), text))
        for part, ends_px, text in drawn
    ]

"""Drawings say what the results say, follow the lens, and are the same in pictures, messages and panels."""

from dataclasses import replace

import numpy as np
import pytest
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from svmdist.camera import Camera
from svmdist.drawing import Form, FrameDrawing, Label, Part, Segment, Shape, StatusLine
from svmdist.estimation.instrument.model import plate_capsules
from svmdist.geometry import Capsules, join
from svmdist.geometry.distance import separation
from svmdist.recording.log import open_recording
from svmdist.recording.writer import scene_update
from svmdist.report.on_image import DARK, draw_on
from svmdist.report.panels import _side_view
from svmdist.results import AlarmState, Distance, Distances, FrameResult, ImageFindings
from svmdist.samples import Status
from svmdist.vision.frame_context import seen_through
from svmdist.workflows.frame_drawing import (
    DrawnFrame,
    _through_lens,
    distance_shapes,
    frame_drawing,
    in_words,
    segments,
    status_line,
    virtual_marker,
)
from svmdist.workflows.replay import Replayed, replay
from svmdist.workflows.request import Setup, prepare
from tests.conftest import REPOSITORY

K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
CAMERA = Camera(640, 480, K, np.zeros(5), frame_id="camera")
CLEARANCE = Distance(0.01, 0.001, (1.0, 0.0, 0.0), (0.0, 0.0, 0.1))
RESULT = FrameResult(
    7,
    Status.OK,
    ImageFindings(tool_px=(320.0, 240.0), tissue_px=(400.0, 240.0)),
    distances=Distances(planar=Distance(0.02), clearance=CLEARANCE),
    instrument="PSM1",
)


def test_words_and_lines_of_a_distance():
    """The clearance goes before the planar distance, and is drawn where the camera sees it, with its alarm."""
    assert (in_words(CLEARANCE), in_words(Distance(0.02))) == ("10.00 mm [8.04, 11.96]", "20.00 mm")
    alarmed = status_line(replace(RESULT, alarm=AlarmState(is_raised=True)), "fused")
    assert (alarmed.text, alarmed.warns) == ("PSM1 fused: clearance 10.00 mm [8.04, 11.96]  ALARM", True)
    ((line, label),) = distance_shapes(RESULT, CAMERA)
    np.testing.assert_allclose(line.points_px, [[320.0, 240.0], [370.0, 240.0]])
    np.testing.assert_allclose(label.place_px, [345.0, 240.0])


@pytest.mark.parametrize(("start_z_m", "end_z_m", "is_drawn"), [(0.1, 0.098, True), (-0.1, -0.102, False)])
def test_a_penetration_runs_back_into_the_instrument(start_z_m, end_z_m, is_drawn):
    """And what is behind the camera is not drawn."""
    clearance = Distance(-0.002, None, (0.0, 0.0, 1.0), (0.0, 0.0, start_z_m))
    deep = FrameResult(0, Status.OK, distances=Distances(clearance=clearance))
    (segment,) = segments(deep)
    assert segment.end_m[2] == pytest.approx(end_z_m)
    assert bool(distance_shapes(deep, CAMERA)) is is_drawn


def test_a_scene_holds_capsules_and_deletes_what_is_gone():
    body = Capsules(np.zeros((1, 3)), np.array([[0.0, 0.03, 0.04]]), np.array([0.002]))
    drawing = FrameDrawing(3, bodies={"PSM1": body})
    message = SceneUpdate.FromString(scene_update(drawing, ["PSM1"], "camera").data)
    (entity,) = message.entities
    (cylinder,) = entity.cylinders
    assert cylinder.size.z == pytest.approx(0.05)
    q = cylinder.pose.orientation
    along = [2 * (q.x * q.z + q.w * q.y), 2 * (q.y * q.z - q.w * q.x), 1 - 2 * (q.x**2 + q.y**2)]
    np.testing.assert_allclose(along, [0.0, 0.6, 0.8], atol=1e-12)  # the cylinder's own z axis
    assert {deletion.id for deletion in message.deletions} == {"tissue", "PSM1 distance", "PSM1 between"}


def test_a_plate_is_whole_from_the_side(duo):
    """It is modelled as rods side by side; what is between them is filled, too."""
    setup, replayed = duo
    plate = plate_capsules(setup.profile.fiducial)
    seen_face_on = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0.1], [0, 0, 0, 1.0]])
    shaft = Capsules(np.array([[0.05, 0.0, 0.1]]), np.array([[0.2, 0.0, 0.1]]), np.array([0.004]))
    low_m, tissue_m = np.array([0.0, 0.0, 0.104]), np.array([0.0, 0.0, 0.11])
    drawing = FrameDrawing(
        0,
        bodies={"PSM1": join(shaft, plate.transformed(seen_face_on))},
        segments=(Segment("PSM1 distance", Part.DISTANCE, low_m, tissue_m, ""),),
    )
    picture, px_per_m = _side_view(DrawnFrame(0, 0.0, replayed, drawing), np.zeros((480, 640, 3), np.uint8))
    aside_px = round(0.36 * 640 + 0.001 * px_per_m)  # beside the line of the clearance
    above_px = np.round(240 - np.linspace(0.0035, 0.0085, 200) * px_per_m).astype(int)
    assert (picture[above_px, aside_px] != DARK).any(1).all()


def first_frames(name: str, method: str, count: int) -> tuple[Setup, list[Replayed]]:
    setup = prepare(method=method)
    recording = open_recording(REPOSITORY / "recordings" / name, setup.profile)
    frames = (replayed for (replayed,) in replay(recording, [setup], jobs=1))
    return setup, [next(frames) for _ in range(count)]


@pytest.fixture(scope="module")
def duo() -> tuple[Setup, Replayed]:
    setup, frames = first_frames("3d/duo.mcap", "fused", 3)
    return setup, frames[-1]


@pytest.fixture(scope="module")
def sweep() -> tuple[Setup, Replayed]:
    setup, frames = first_frames("sweep.mcap", "overlay", 1)
    return setup, frames[0]


def points_of(drawing: FrameDrawing, part: Part, instrument: str) -> np.ndarray:
    return np.concatenate(
        [shape.points_px for shape in drawing.shapes if (shape.part, shape.instrument) == (part, instrument)]
    )


def test_a_clearance_is_a_segment_of_its_length_that_starts_on_the_instrument(duo):
    setup, replayed = duo
    drawing = frame_drawing(replayed, setup)
    each = zip(replayed.frames, replayed.results, drawing.bodies.values(), strict=True)
    for frame, result, body in each:  # each has its own height of the tissue
        name = f"{result.instrument} {Part.DISTANCE}"
        (segment,) = (one for one in drawing.segments if one.name == name)
        clearance = result.distances.clearance
        length_m = np.linalg.norm(segment.end_m - segment.start_m)
        assert length_m == pytest.approx(abs(clearance.value_m), abs=1e-12)
        along = body.end_m - body.start_m
        share = ((segment.start_m - body.start_m) * along).sum(1) / np.maximum((along**2).sum(1), 1e-18)
        nearest = body.start_m + np.clip(share, 0.0, 1.0)[:, None] * along
        off_m = np.abs(np.linalg.norm(nearest - segment.start_m, axis=1) - body.radius_m)
        assert off_m.min() < 1e-9
        end_m = segment.end_m[None]
        on_tissue = separation(Capsules(end_m, end_m, np.zeros(1)), frame.left.measured_surface)
        assert on_tissue.distance_m == pytest.approx(0.0, abs=1e-9)
        assert f"{clearance.value_m * 1e3:.2f} mm" in segment.text
        lens = replayed.frames[0].scene.lens
        line_px = points_of(drawing, Part.DISTANCE, result.instrument)
        expected_px = lens.project(np.stack([segment.start_m, segment.end_m]))
        np.testing.assert_allclose(line_px, expected_px, atol=1e-9)


def test_what_was_found_of_each_instrument_is_drawn_where_it_is(duo):
    setup, replayed = duo
    drawing = frame_drawing(replayed, setup)
    assert [line.text.split(":")[0] for line in drawing.lines] == ["PSM1 fused", "PSM2 fused"]
    edge_count = 0
    for frame, result in zip(replayed.frames, replayed.results, strict=True):
        corners_px = frame.left.tag_corners_px
        assert corners_px is not None
        np.testing.assert_allclose(points_of(drawing, Part.TAG, result.instrument), corners_px)
        region = frame.left.region
        contours_px = points_of(drawing, Part.WRIST, result.instrument)
        low, high = region.hull.reshape(-1, 2).min(0), region.hull.reshape(-1, 2).max(0)
        np.testing.assert_allclose([contours_px.min(0), contours_px.max(0)], [low, high], atol=1.0)
        # The shaft's edges lie in their tangent planes, to a fraction of a pixel.
        edges_px = points_of(drawing, Part.SHAFT, result.instrument).reshape(-1, 2, 2)
        for contour, ends_px in zip(frame.left.shaft.contours, edges_px, strict=False):
            K = frame.left.camera.K
            rays = np.column_stack([ends_px, np.ones(2)]) @ np.linalg.inv(K).T
            np.testing.assert_allclose(K[0, 0] * (rays @ contour.normal), 0.0, atol=0.3)
            edge_count += 1
    assert edge_count >= 1


def test_the_markers_matches_are_those_that_overlay_counted(sweep):
    """And the line of a planar distance runs from tool to tissue."""
    setup, replayed = sweep
    found = virtual_marker(replayed.frames[0])
    image = replayed.results[0].image
    counts = len(found.features), len(found.matches), int(found.inliers.sum())
    assert counts == (image.keypoint_count, image.match_count, image.inlier_count)
    drawing = frame_drawing(replayed, setup)
    assert len(points_of(drawing, Part.INLIER, "PSM1")) == image.inlier_count
    np.testing.assert_allclose(points_of(drawing, Part.DISTANCE, "PSM1"), [image.tool_px, image.tissue_px])


def test_a_rejected_frame_says_why_and_has_no_distance(sweep):
    setup, replayed = sweep
    rejected = FrameResult(5, Status.NO_TISSUE, detail="hidden", instrument="PSM1")
    drawing = frame_drawing(replace(replayed, results=(rejected,)), setup)
    assert drawing.lines[0].text == "PSM1 overlay: not measured: no_tissue (hidden)"
    assert not [shape for shape in drawing.shapes if shape.part is Part.DISTANCE]
    unread = frame_drawing(Replayed((rejected,), (0.0,)), setup)
    assert unread.shapes == ()
    assert unread.lines[0].warns


def test_shapes_follow_the_lens(sweep):
    setup, replayed = sweep
    shapes = [shape for shape in frame_drawing(replayed, setup).shapes if shape.form is Form.LOOP]
    camera = replayed.frames[0].scene.lens
    bent = replace(camera, D=np.array([-0.3, 0.1, 0.0, 0.0, 0.0]))
    for before, after in zip(shapes, [_through_lens(shape, bent) for shape in shapes], strict=True):
        corners_px = seen_through(bent, before.points_px)
        gaps_px = np.linalg.norm(after.points_px[:, None] - corners_px, axis=2).min(0)
        assert gaps_px.max() < 1e-9  # every corner is still one
        steps_px = np.linalg.norm(np.diff(after.points_px, axis=0), axis=1)
        assert steps_px.max() < 20.0  # and what lies between is bent with it


def test_a_picture_changes_where_the_drawing_is_and_nowhere_else(sweep):
    setup, replayed = sweep
    image = replayed.image_bgr
    drawing = frame_drawing(replayed, setup)
    changed = (draw_on(image, drawing, parts=[Part.MARKER], lines=False) != image).any(2)
    (outline,) = (shape for shape in drawing.shapes if shape.part is Part.MARKER)
    low, high = outline.points_px.min(0) - 3, outline.points_px.max(0) + 3
    rows, columns = np.nonzero(changed)
    assert len(rows) > 4 * 40  # four sides of a marker of 64 px or more
    places = np.column_stack([columns, rows])
    assert ((places >= low) & (places <= high)).all()


@pytest.mark.parametrize("size_px", [(320, 240), (640, 480), (1920, 1080)])
def test_no_label_hides_what_was_measured_or_another_label(size_px):
    """Nor does the header: lines and ends are as they are without labels, wherever they lie in an image of any size."""
    rng, ground = np.random.default_rng(1), np.full((*size_px[::-1], 3), 90, np.uint8)
    for _ in range(20):
        ends_px = [rng.uniform(0.05, 0.95, (2, 2)) * size_px for _ in range(2)]
        shapes = tuple(Shape(Part.DISTANCE, Form.LINE, ends) for ends in ends_px)
        labels = tuple(Label(Part.DISTANCE, ends.mean(0), "PSM1 12.34 mm [10.00, 14.00]") for ends in ends_px)
        bare = draw_on(ground, FrameDrawing(0, shapes))
        lines = (StatusLine("PSM1 fused: clearance 12.34 mm"),)
        drawn = draw_on(ground, FrameDrawing(0, shapes, labels, lines))
        x, y = np.rint(np.concatenate([np.linspace(*ends, 50) for ends in ends_px])).astype(int).T
        assert (drawn[y, x] == bare[y, x]).all()


@pytest.mark.parametrize("half_px", [20, 40])
def test_labels_leave_instruments_free(half_px):
    """Only their lines run over the shaft that they name, of labels that are not next to it already."""
    ground, low, high = np.full((480, 640, 3), 90, np.uint8), 200 - half_px, 200 + half_px
    shaft = Shape(Part.SHAFT, Form.LOOP, np.array([[0, low], [300, low], [300, high], [0, high]], float))
    labels = tuple(Label(Part.TIP, np.array([x, 200.0]), "a long name of an arm") for x in (150.0, 170.0))
    bare, drawn = (draw_on(ground, FrameDrawing(0, (shaft,), shown)) for shown in ((), labels))
    changed = (drawn != bare).any(2)[low : high + 1, :301]
    assert (changed.sum() > 0) == (half_px == 40)
    assert changed.sum() < 4 * half_px

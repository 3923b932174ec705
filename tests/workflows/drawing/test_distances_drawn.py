"""Words and lines of distances, and the messages made of drawings."""

from __future__ import annotations

import numpy as np
import pytest
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from svmdist.camera import Camera
from svmdist.drawing import Body, Form, FrameDrawing, Label, Part, SceneDrawing, Shape, StatusLine
from svmdist.estimation.alarms import AlarmState
from svmdist.recording.viewer_messages import image_annotations, scene_update
from svmdist.results import Distance, Distances, FrameResult, ImageFindings
from svmdist.samples import Status
from svmdist.workflows.frame_drawing import (
    distance_shapes,
    in_words,
    place_shapes,
    segments,
    shown_distance,
    status_line,
)

CAMERA = Camera(
    640,
    480,
    np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]),
    np.zeros(5),
    frame_id="camera",
)
CLEARANCE = Distance(0.01, 0.001, (1.0, 0.0, 0.0), (0.0, 0.0, 0.1))
RESULT = FrameResult(
    7,
    Status.OK,
    ImageFindings(tool_px=(320.0, 240.0), tissue_px=(400.0, 240.0)),
    distances=Distances(planar=Distance(0.02), clearance=CLEARANCE),
    instrument="PSM1",
)


def test_the_clearance_goes_before_other_distances() -> None:
    assert shown_distance(RESULT) == ("clearance", CLEARANCE)
    assert shown_distance(RESULT.rejected(Status.NO_TISSUE)) is None
    assert in_words(CLEARANCE) == "10.00 mm [8.04, 11.96]"
    assert in_words(Distance(0.02)) == "20.00 mm"


def test_a_status_line_has_the_alarm() -> None:
    line = status_line(RESULT, "fused", AlarmState(alarm=True))
    assert line.text == "PSM1 fused: clearance 10.00 mm [8.04, 11.96]  ALARM"
    assert line.alarm
    assert not status_line(RESULT, "fused").alarm


def test_the_line_of_a_clearance_is_where_the_camera_sees_it() -> None:
    line, label = distance_shapes(RESULT, CAMERA)
    assert isinstance(line, Shape)
    assert isinstance(label, Label)
    np.testing.assert_allclose(line.points_px, [[320.0, 240.0], [370.0, 240.0]])
    np.testing.assert_allclose(label.place_px, [345.0, 240.0])


def test_a_penetration_runs_back_into_the_instrument() -> None:
    deep = FrameResult(
        0, Status.OK, distances=Distances(clearance=Distance(-0.002, None, (0.0, 0.0, 1.0), (0.0, 0.0, 0.1)))
    )
    (segment,) = segments(deep)
    assert segment.end_m[2] == pytest.approx(0.098)


def test_what_is_behind_the_camera_is_not_drawn() -> None:
    behind = FrameResult(
        0, Status.OK, distances=Distances(clearance=Distance(0.01, None, (0.0, 0.0, 1.0), (0.0, 0.0, -0.1)))
    )
    assert list(distance_shapes(behind, CAMERA)) == []


def test_places_are_points() -> None:
    tip, tissue = place_shapes(RESULT)
    assert (tip.part, tip.form, tip.instrument) == (Part.TIP, Form.POINTS, "PSM1")
    np.testing.assert_allclose(tissue.points_px, [[400.0, 240.0]])


def test_annotations_keep_forms_texts_and_stamps() -> None:
    drawing = FrameDrawing(
        1_500_000_000,
        (Shape(Part.TAG, Form.LOOP, np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])),),
        (Label(Part.DISTANCE, np.array([9.0, 8.0]), "10 mm"),),
        (StatusLine("PSM1: ok", True),),
    )
    message = ImageAnnotations.FromString(image_annotations(drawing).data)
    (shape,) = message.points
    assert shape.type == PointsAnnotation.LINE_LOOP
    assert [(point.x, point.y) for point in shape.points] == [(1.0, 2.0), (3.0, 4.0), (5.0, 6.0)]
    assert [text.text for text in message.texts] == ["10 mm", "PSM1: ok"]
    assert (message.timestamp.seconds, message.timestamp.nanos) == (1, 500_000_000)


def test_a_scene_holds_capsules_and_deletes_what_is_gone() -> None:
    body = Body("PSM1", np.zeros((1, 3)), np.array([[0.0, 0.03, 0.04]]), np.array([0.002]))
    message = SceneUpdate.FromString(scene_update(SceneDrawing((body,)), ["PSM1"], "camera", 3).data)
    (entity,) = message.entities
    (cylinder,) = entity.cylinders
    assert cylinder.size.z == pytest.approx(0.05)
    q = cylinder.pose.orientation
    along = [2 * (q.x * q.z + q.w * q.y), 2 * (q.y * q.z - q.w * q.x), 1 - 2 * (q.x**2 + q.y**2)]
    np.testing.assert_allclose(along, [0.0, 0.6, 0.8], atol=1e-12)  # the cylinder's own z axis
    assert {deletion.id for deletion in message.deletions} == {"tissue", "PSM1 distance", "PSM1 between"}

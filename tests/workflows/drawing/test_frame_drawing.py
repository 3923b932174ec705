"""Drawings say what the results say: lengths, places, counts; and they follow the lens."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.drawing import Form, FrameDrawing, Part
from svmdist.recording.log import open_recording
from svmdist.report.panels import draw_on
from svmdist.results import FrameResult
from svmdist.samples import Status
from svmdist.vision.frame_context import seen_through
from svmdist.workflows.frame_drawing import _through_lens, frame_drawing, virtual_marker
from svmdist.workflows.replay import Replayed, replay
from svmdist.workflows.request import Setup, prepare

REPOSITORY = Path(__file__).resolve().parents[3]


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


def test_a_clearance_is_a_segment_of_its_length_that_starts_on_the_instrument(
    duo: tuple[Setup, Replayed],
) -> None:
    setup, replayed = duo
    drawing = frame_drawing(replayed, setup)
    for result, body in zip(replayed.results, drawing.scene.bodies, strict=True):
        (segment,) = (
            one for one in drawing.scene.segments if one.name == f"{result.instrument} {Part.DISTANCE}"
        )
        clearance = result.distances.clearance
        assert clearance is not None
        assert np.linalg.norm(segment.end_m - segment.start_m) == pytest.approx(
            abs(clearance.value_m), abs=1e-12
        )
        along = body.end_m - body.start_m
        share = ((segment.start_m - body.start_m) * along).sum(1) / np.maximum((along**2).sum(1), 1e-18)
        nearest = body.start_m + np.clip(share, 0.0, 1.0)[:, None] * along
        off_m = np.abs(np.linalg.norm(nearest - segment.start_m, axis=1) - body.radius_m)
        assert off_m.min() < 1e-9
        assert f"{clearance.value_m * 1e3:.2f} mm" in segment.text
        lens = replayed.frames[0].scene.lens
        line = next(
            shape
            for shape in drawing.shapes
            if shape.part is Part.DISTANCE and shape.instrument == result.instrument
        )
        expected_px = lens.project(np.stack([segment.start_m, segment.end_m]))
        np.testing.assert_allclose(line.points_px, expected_px, atol=1e-9)


def test_what_was_found_of_each_instrument_is_drawn_where_it_is(duo: tuple[Setup, Replayed]) -> None:
    setup, replayed = duo
    drawing = frame_drawing(replayed, setup)
    assert [line.text.split(":")[0] for line in drawing.lines] == ["PSM1 fused", "PSM2 fused"]
    for frame, result in zip(replayed.frames, replayed.results, strict=True):
        corners_px = frame.left.tag_corners_px
        assert corners_px is not None
        np.testing.assert_allclose(points_of(drawing, Part.TAG, result.instrument), corners_px)
        region = frame.left.region
        assert region is not None
        contours_px = points_of(drawing, Part.INSTRUMENT, result.instrument)
        low, high = region.hull.reshape(-1, 2).min(0), region.hull.reshape(-1, 2).max(0)
        np.testing.assert_allclose([contours_px.min(0), contours_px.max(0)], [low, high], atol=1.0)


def test_edges_of_the_shaft_lie_in_their_tangent_planes(duo: tuple[Setup, Replayed]) -> None:
    setup, replayed = duo
    drawing = frame_drawing(replayed, setup)
    checked = 0
    for frame, result in zip(replayed.frames, replayed.results, strict=True):
        lines = [
            shape.points_px
            for shape in drawing.shapes
            if (shape.part, shape.instrument) == (Part.SHAFT, result.instrument)
        ]
        for contour, ends_px in zip(frame.left.shaft.contours, lines, strict=False):
            rays = np.column_stack([ends_px, np.ones(2)]) @ np.linalg.inv(frame.left.camera.K).T
            np.testing.assert_allclose(rays @ contour.plane.normal, 0.0, atol=1e-9)
            checked += 1
    assert checked >= 1


def test_the_markers_matches_are_those_that_overlay_counted(sweep: tuple[Setup, Replayed]) -> None:
    setup, replayed = sweep
    found = virtual_marker(replayed.frames[0], setup.profile)
    image = replayed.results[0].image
    assert found is not None
    assert (len(found.keypoints_px), len(found.matched_px), int(found.inliers.sum())) == (
        image.keypoint_count,
        image.match_count,
        image.inlier_count,
    )
    inliers_px = points_of(frame_drawing(replayed, setup), Part.INLIER, "PSM1")
    assert len(inliers_px) == image.inlier_count


def test_the_line_of_a_planar_method_runs_from_tool_to_tissue(sweep: tuple[Setup, Replayed]) -> None:
    setup, replayed = sweep
    (line,) = (shape for shape in frame_drawing(replayed, setup).shapes if shape.part is Part.DISTANCE)
    np.testing.assert_allclose(
        line.points_px, [replayed.results[0].image.tool_px, replayed.results[0].image.tissue_px]
    )


def test_a_rejected_frame_says_why_and_has_no_distance(sweep: tuple[Setup, Replayed]) -> None:
    setup, replayed = sweep
    rejected = FrameResult(5, Status.NO_TISSUE, detail="hidden", instrument="PSM1")
    drawing = frame_drawing(replace(replayed, results=(rejected,)), setup)
    assert drawing.lines[0].text == "PSM1 overlay: not measured: no_tissue (hidden)"
    assert not [shape for shape in drawing.shapes if shape.part is Part.DISTANCE]
    unread = frame_drawing(Replayed((rejected,), (0.0,)), setup)
    assert unread.shapes == ()
    assert not unread.lines[0].measured


def test_shapes_follow_the_lens(sweep: tuple[Setup, Replayed]) -> None:
    setup, replayed = sweep
    shapes = [shape for shape in frame_drawing(replayed, setup).shapes if shape.form is Form.LOOP]
    camera = replayed.frames[0].scene.lens
    bent = replace(camera, D=np.array([-0.3, 0.1, 0.0, 0.0, 0.0]))
    assert isinstance(bent, Camera)
    for before, after in zip(shapes, _through_lens(shapes, bent), strict=True):
        corners_px = seen_through(bent, before.points_px)
        gaps_px = np.linalg.norm(after.points_px[:, None] - corners_px, axis=2).min(0)
        assert gaps_px.max() < 1e-9  # every corner is still one
        steps_px = np.linalg.norm(np.diff(after.points_px, axis=0), axis=1)
        assert steps_px.max() < 20.0  # and what lies between is bent with it


def test_a_picture_changes_where_the_drawing_is_and_nowhere_else(sweep: tuple[Setup, Replayed]) -> None:
    setup, replayed = sweep
    image = replayed.image_bgr
    assert image is not None
    drawing = frame_drawing(replayed, setup)
    changed = (draw_on(image, drawing, parts=[Part.MARKER], lines=False) != image).any(2)
    (outline,) = (shape for shape in drawing.shapes if shape.part is Part.MARKER)
    low, high = outline.points_px.min(0) - 3, outline.points_px.max(0) + 3
    rows, columns = np.nonzero(changed)
    assert len(rows) > 4 * 40  # four sides of a marker of 64 px or more
    assert (columns >= low[0]).all()
    assert (columns <= high[0]).all()
    assert (rows >= low[1]).all()
    assert (rows <= high[1]).all()

"""One instrument's detections in a drawn frame: where they were drawn, and none where nothing was."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svmdist.estimation.frame import Frame
from svmdist.estimation.scene import Arm, Scene
from svmdist.profile import AutoSegmentation
from svmdist.recording.log import open_recording
from svmdist.results import Failure
from svmdist.samples import Image, Observation, RightView
from svmdist.transforms import inverse, make_transform
from svmdist.vision.segmentation import make_segmenter
from svmdist.workflows.estimate import estimate
from svmdist.workflows.request import prepare
from tests.shipped import PROFILE
from tests.synthetic import START_NS, make_scene

SCENE = make_scene()
TOOL_PX = SCENE.camera.project(SCENE.T_camera_tool_at(0.3)[:3, 3])[0]
T_LEFT_RIGHT = make_transform(np.eye(3), [0.005, 0.0, 0.0])
RIGHT_SCENE = replace(SCENE, T_camera_base=inverse(T_LEFT_RIGHT) @ SCENE.T_camera_base)
NO_ROBOT = Failure("no joints near the image")


def detections(image: Image, right: bool = False, others: Image | None = None) -> Frame:
    beside = RightView(RIGHT_SCENE.frame_at(0.3), SCENE.camera, T_LEFT_RIGHT) if right else None
    observation = Observation(START_NS, image, SCENE.camera, None, beside)
    scene = Scene(observation, PROFILE, make_segmenter(PROFILE.segmentation))
    return Frame.of(scene, Arm(PROFILE), observation, NO_ROBOT, (others, None))


def test_the_marker_is_where_it_was_drawn() -> None:
    """To half a pixel, in both views; the disc's 9 px to 1 px, since the whole sphere is taken as 3 % larger."""
    tool = detections(SCENE.frame_at(0.3), right=True)
    assert tool.right is not None
    left, right = tool.left.distal_marker, tool.right.distal_marker
    assert left is not None
    assert right is not None
    np.testing.assert_allclose(left.centre_px, TOOL_PX, atol=0.5)
    place_m = RIGHT_SCENE.T_camera_tool_at(0.3)[:3, 3]
    np.testing.assert_allclose(right.centre_px, SCENE.camera.project(place_m)[0], atol=0.5)
    assert left.radius_px == pytest.approx(9.0, abs=1.0)


def test_what_is_not_there_is_none() -> None:
    """Of a grey image, and of the right view of a log that has none."""
    tool = detections(np.full((480, 640, 3), 120, np.uint8))
    assert tool.left.region is None
    assert tool.left.distal_marker is None
    assert tool.left.tag_corners_px is None
    assert tool.tag is None
    assert tool.tag_near(np.eye(3)) is None
    assert tool.left.shaft_region is None
    assert tool.left.shaft.contours == ()
    assert isinstance(tool.shaft_fit, Failure)
    assert tool.left.regions_as_recorded == (None, None)
    assert tool.right is None


def test_another_instrument_s_pixels_are_none_of_its_own() -> None:
    """Marked as another's, the marker is gone; the tissue, which all share, stays."""
    others = np.full((480, 640), 255, np.uint8)
    tool = detections(SCENE.frame_at(0.3), others=others)
    assert tool.left.region is None
    assert tool.left.distal_marker is None
    tissue, instrument = tool.left.regions_as_recorded
    assert tissue is not None
    assert instrument is None


DUO = Path(__file__).parents[2] / "recordings" / "3d" / "duo.mcap"


def test_both_instruments_of_a_log_are_measured() -> None:
    profile = PROFILE.model_copy(update={"segmentation": AutoSegmentation(method="auto")})
    setup = prepare(profile, "shaft")
    rows = estimate(open_recording(DUO, setup.profile), setup)
    measured = Counter(row.instrument for row in rows if row.measured)
    assert set(measured) == {"PSM1", "PSM2"}

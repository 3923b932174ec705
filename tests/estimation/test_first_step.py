"""The first step of every method: the tissue of this frame, or of the frames before."""

from __future__ import annotations

import numpy as np

from svmdist.estimation.distances import tracked_tissue, with_tissue
from svmdist.estimation.frame import Frame, frame_of
from svmdist.estimation.scene import Arm
from svmdist.estimation.tissue_tracking import TissueTracker
from svmdist.samples import Image, Observation, Status
from svmdist.vision.segmentation import make_segmenter
from tests.shipped import PROFILE
from tests.synthetic import START_NS, make_scene

SCENE = make_scene()
SEGMENTER = make_segmenter(PROFILE.segmentation)


def frame(image: Image) -> Frame:
    return frame_of(Observation(START_NS, image, SCENE.camera), Arm(PROFILE), SEGMENTER)


def grey() -> Image:
    return np.full((480, 640, 3), 120, np.uint8)


def test_a_visible_tissue_is_in_the_result() -> None:
    """Status, place and area are those of the scene's detection."""
    seen = frame(SCENE.frame_at(0.3))
    result, tissue = with_tissue(seen), seen.scene.tissue
    assert tissue is not None
    assert result.status is Status.OK
    assert result.image.tissue_px == tuple(tissue.outline.centroid_px)
    assert result.image.tissue_area_px == tissue.region.area_px
    assert (result.tool, result.detail, result.stamp_ns) == (None, "", START_NS)


def test_no_tissue_is_the_status() -> None:
    result = with_tissue(frame(grey()))
    assert result.status is Status.NO_TISSUE
    assert result.image.tissue_px is None


def test_the_first_pose_is_the_frame_s_own_and_outlives_it() -> None:
    """With nothing before, to rounding; after it, a frame that hides the tissue changes nothing."""
    tracker, seen = TissueTracker(PROFILE.settings.tissue), frame(SCENE.frame_at(0.3))
    assert tracked_tissue(frame(grey()), tracker) is None
    first = tracked_tissue(seen, tracker)
    tissue = seen.scene.tissue
    assert first is not None
    assert tissue is not None
    assert tissue.pose is not None
    np.testing.assert_allclose(first.position_m, tissue.pose.position_m, atol=1e-12)
    hidden = tracked_tissue(frame(grey()), tracker)
    assert hidden is not None
    np.testing.assert_allclose(hidden.position_m, first.position_m, atol=1e-12)

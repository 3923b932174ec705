"""The steps that the paper's estimators share, and that both are these steps about different places."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.estimation.frame import Frame, frame_of
from svmdist.estimation.planar import CentroidEstimator, OverlayEstimator, in_plane, locate
from svmdist.estimation.plane_mapping import PlaneMapping, Quadratic
from svmdist.estimation.scene import Arm
from svmdist.results import FrameResult, ImageFindings
from svmdist.samples import Image, Observation, Status
from svmdist.vision.segmentation import make_segmenter
from tests.shipped import PROFILE
from tests.synthetic import START_NS, TISSUE_M, make_scene

SCENE = make_scene()
SEGMENTER = make_segmenter(PROFILE.segmentation)
MAPPING = PlaneMapping("corrected", Quadratic(0.0, 1.0, 3.0), Quadratic(0.0, 1.0, -2.0))
"""Straight lines: 0.0254 cm a pixel along both axes, whatever their origins."""
M_PER_PX = 0.0254e-2
RESULT = FrameResult(3, Status.OK, ImageFindings(tissue_area_px=5))


def frame(image: Image) -> Frame:
    return frame_of(Observation(START_NS, image, SCENE.camera), Arm(PROFILE), SEGMENTER)


def without(colour: tuple[int, int, int]) -> Image:
    """The scene with one of its parts painted over."""
    image = SCENE.frame_at(0.3)
    image[np.all(image == colour, axis=2)] = 120
    return image


def test_both_are_where_they_were_drawn() -> None:
    """The tool to half a pixel; the tissue, of which the tool's disc hides a part, to 3 px."""
    result, tissue, instrument = locate(frame(SCENE.frame_at(0.3)))
    assert result.status is Status.OK
    assert tissue is not None
    assert instrument is not None
    tool_px = SCENE.camera.project(SCENE.T_camera_tool_at(0.3)[:3, 3])[0]
    np.testing.assert_allclose(instrument.centroid_px, tool_px, atol=0.5)
    np.testing.assert_allclose(tissue.centroid_px, SCENE.camera.project(TISSUE_M)[0], atol=3.0)
    assert result.image.tool_px == tuple(instrument.centroid_px)
    assert result.image.tissue_area_px == tissue.area_px


@pytest.mark.parametrize(
    ("colours", "status"),
    [
        (((60, 50, 200),), Status.NO_TISSUE),
        (((180, 180, 20),), Status.NO_INSTRUMENT),
        (((60, 50, 200), (180, 180, 20)), Status.NO_TISSUE),
    ],
)
def test_what_is_missing_is_the_status(colours: tuple[tuple[int, int, int], ...], status: Status) -> None:
    """The tissue's loop comes first in the paper; what is there is still told."""
    image = SCENE.frame_at(0.3)
    for colour in colours:
        image[np.any(without(colour) != SCENE.frame_at(0.3), axis=2)] = 120
    result, tissue, instrument = locate(frame(image))
    assert result.status is status
    assert (result.image.tissue_px is None) == (tissue is None)
    assert (result.image.tool_px is None) == (instrument is None)
    for estimator in (CentroidEstimator(Arm(PROFILE), MAPPING), OverlayEstimator(Arm(PROFILE), MAPPING)):
        assert estimator.estimate(frame(image)).status is status


def test_a_distance_in_the_plane_is_that_of_the_pixels() -> None:
    """By straight lines 30 and 40 px are 50 px; swapped places are as far apart: rounding only."""
    a, b = np.array([100.0, 200.0]), np.array([130.0, 240.0])
    for tool_px, tissue_px in ((a, b), (b, a)):
        result = in_plane(RESULT, tool_px, tissue_px, MAPPING)
        assert result.distances.planar is not None
        assert result.distances.planar.value_m == pytest.approx(50.0 * M_PER_PX, rel=1e-12)
        assert result.image.tool_px == tuple(tool_px)
        assert result.image.tissue_area_px == 5
        assert result.distances.spatial is None


def test_a_distance_that_is_no_number_rejects_the_frame() -> None:
    result = in_plane(RESULT, np.array([np.nan, 0.0]), np.array([0.0, 0.0]), MAPPING)
    assert result.status is Status.NOT_FINITE
    assert result.distances.planar is None


def test_the_overlay_finds_the_marker_where_the_centroid_is() -> None:
    """The marker is pasted on the centroid, so both methods differ by what finding it again errs: under 1 px."""
    seen = frame(SCENE.frame_at(0.3))
    plain = CentroidEstimator(Arm(PROFILE), MAPPING).estimate(seen)
    marked = OverlayEstimator(Arm(PROFILE), MAPPING).estimate(seen)
    assert plain.distances.planar is not None
    assert marked.distances.planar is not None
    assert abs(plain.distances.planar.value_m - marked.distances.planar.value_m) < M_PER_PX
    assert plain.image.inlier_count is None
    assert marked.image.inlier_count is not None

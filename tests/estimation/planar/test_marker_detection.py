"""Detection of the pasted marker: it is found wherever it is pasted, and nothing else is taken for it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.estimation.planar import (
    detect_marker,
    draw_outline,
    mark,
    template_features,
    third_contour,
)
from svmdist.profile import load_profile
from svmdist.samples import Status
from svmdist.vision.marker import square_corners

PROFILE = load_profile()
SIZE_PX = PROFILE.marker.size_px
TEMPLATE = template_features(PROFILE.marker, PROFILE.features)


def textured(height: int = 480, width: int = 640, seed: int = 1) -> np.ndarray:
    """A BGR image of smooth random blotches, which have ORB corners of their own."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(40, 160, (height // 8, width // 8, 3)).astype(np.uint8)
    return np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), np.uint8)


def test_the_templates_features_lie_on_the_marker():
    """Template features are in px of the marker itself: none lies outside it by more than a pixel."""
    assert TEMPLATE.points_px.min() >= -1.0
    assert TEMPLATE.points_px.max() <= SIZE_PX


@pytest.mark.parametrize("x", [0.0, 13.4, 319.5, 600.0, 639.0])
@pytest.mark.parametrize("y", [0.0, 240.2, 479.0])
def test_the_marker_is_found_everywhere_even_in_corners(x, y):
    """At corners, borders and the middle it is found with 40 inliers or more, its centre within 1 px."""
    centre_px = np.array([x, y])
    marked = mark(textured(), centre_px, PROFILE.marker)
    found = detect_marker(marked, TEMPLATE, PROFILE.marker, PROFILE.features)
    assert found.status is Status.OK
    assert found.inlier_count is not None
    assert found.inlier_count >= 40
    assert found.centroid_px is not None
    assert found.corners_px is not None
    pasted_px = np.array(marked.origin_px) + (marked.window_bgr.shape[0] - 1) / 2
    assert np.linalg.norm(found.centroid_px - centre_px) < 1.0
    assert np.linalg.norm(found.centroid_px - pasted_px) < 0.5
    assert np.abs(found.corners_px.mean(0) - pasted_px).max() < 0.5


def test_the_image_far_from_the_marker_changes_nothing():
    """Only the window about the marker is looked at: what is elsewhere in the image does not count."""
    image, centre_px = textured(), np.array([200.3, 150.6])
    other = image.copy()
    other[:, 300:] = 0
    found = [
        detect_marker(mark(each, centre_px, PROFILE.marker), TEMPLATE, PROFILE.marker, PROFILE.features)
        for each in (image, other)
    ]
    assert found[0].keypoint_count == found[1].keypoint_count
    np.testing.assert_array_equal(found[0].corners_px, found[1].corners_px)


def test_a_window_without_features_says_so_and_claims_nothing():
    """In a window without the marker, what was not reached is None: no count, no place."""
    marked = mark(np.full((200, 200, 3), 90, np.uint8), np.array([100.0, 100.0]), PROFILE.marker)
    marked.window_bgr[:] = 90
    found = detect_marker(marked, TEMPLATE, PROFILE.marker, PROFILE.features)
    assert found.status is Status.NO_FEATURES
    assert found.keypoint_count == 0
    assert (found.match_count, found.inlier_count, found.corners_px, found.centroid_px) == (None,) * 4


@pytest.mark.parametrize("seed", range(2, 10))
def test_a_window_without_the_marker_is_not_mistaken_for_it(seed):
    """Texture alone, with features of its own, gives too few matches or no homography, and no inliers."""
    marked = mark(textured(), np.array([320.0, 240.0]), PROFILE.marker)
    side = marked.window_bgr.shape[0]
    marked.window_bgr[:] = textured(seed=seed)[100 : 100 + side, 100 : 100 + side]
    found = detect_marker(marked, TEMPLATE, PROFILE.marker, PROFILE.features)
    assert found.keypoint_count > 2
    assert found.status in {Status.TOO_FEW_MATCHES, Status.NO_HOMOGRAPHY}
    assert found.match_count is not None
    assert found.inlier_count is None
    assert found.centroid_px is None


def test_the_third_contour_is_the_outline_that_was_drawn():
    """Its centroid is the middle of the square within 0.1 px, and the window itself is not drawn on."""
    window = textured(200, 220)
    before = window.copy()
    corners_px = square_corners(SIZE_PX) + np.array([60.0, 50.0])
    region = third_contour(window, corners_px, PROFILE.marker)
    assert region is not None
    np.testing.assert_allclose(region.centroid_px, corners_px.mean(0), atol=0.1)
    np.testing.assert_array_equal(window, before)
    drawn = window.copy()
    draw_outline(drawn, corners_px, PROFILE.marker)
    assert region.area_px == np.count_nonzero((drawn == PROFILE.marker.outline_bgr).all(-1))


@pytest.mark.parametrize("shift_px", [(-500.0, 0.0), (900.0, 900.0)])
def test_an_outline_outside_the_window_is_not_found(shift_px):
    """A homography that leads out of the window draws nothing there, and nothing is found."""
    corners_px = square_corners(SIZE_PX) + np.array(shift_px)
    assert third_contour(textured(200, 220), corners_px, PROFILE.marker) is None

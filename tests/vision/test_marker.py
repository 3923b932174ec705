"""The virtual marker: what its comment promises about its bits, and that it is found wherever it is pasted."""

from __future__ import annotations

from itertools import combinations, groupby

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.estimation.planar.outline import find_marker, template_features
from svmdist.profile import load_profile
from svmdist.samples import Status
from svmdist.vision.marker.features import EDGE_MARGIN_PX, detect_orb
from svmdist.vision.marker.pattern import DATA_ROWS, marker_pattern, padded_template, paste_marker

PROFILE = load_profile()
SIZE_PX = PROFILE.marker.size_px
TEMPLATE = template_features(PROFILE.marker, PROFILE.features)
BITS = np.array([[row >> (7 - column) & 1 for column in range(8)] for row in DATA_ROWS])


def textured(height: int = 480, width: int = 640, seed: int = 1) -> np.ndarray:
    """A BGR image of smooth random blotches, which have ORB corners of their own."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(40, 160, (height // 8, width // 8, 3)).astype(np.uint8)
    return np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), np.uint8)


def test_half_of_the_cells_are_white():
    """32 of the 64 data cells are white, so that the marker's brightness is in the middle."""
    assert BITS.sum() == 32


def test_no_run_of_equal_cells_is_longer_than_three():
    """Along every row and column, at most three neighbours are equal: corners are everywhere."""
    for line in [*BITS, *BITS.T]:
        assert max(len(list(run)) for _, run in groupby(line)) <= 3


def test_each_quarter_turn_changes_half_of_the_cells():
    """Turned by 90, 180 and 270 degrees, the pattern differs from itself in 32 cells."""
    for turns in (1, 2, 3):
        assert np.count_nonzero(np.rot90(BITS, turns) != BITS) == 32


def test_no_two_windows_look_alike_under_any_quarter_turn():
    """All 25 windows of 4 x 4 cells differ from one another in every orientation."""
    windows = [BITS[row : row + 4, column : column + 4] for row in range(5) for column in range(5)]
    for one, other in combinations(windows, 2):
        assert all(not np.array_equal(one, np.rot90(other, turns)) for turns in range(4))


@pytest.mark.parametrize("size_px", [48, 95, 96, 97, 256])
def test_the_pattern_is_bordered_white_then_black(size_px):
    """At every size the outermost cells are white and the next ones black, and nobody can write to it."""
    pattern = marker_pattern(size_px)
    assert pattern.shape == (size_px, size_px)
    cell = size_px / 12
    edge, frame = int(cell / 2), int(cell * 1.5)
    assert pattern[edge, size_px // 2] > 200
    assert pattern[frame, size_px // 2] < 60
    assert pattern[size_px // 2, size_px - 1 - edge] > 200
    with pytest.raises(ValueError, match="read-only"):
        pattern[0, 0] = 1


def test_the_template_is_rich_in_features_down_to_full_resolution():
    """The template has at least 200 ORB features, and some at the pyramid's finest level.

    Without softened edges the finest level had none: equal FAST scores suppress one another.
    """
    assert len(TEMPLATE) >= 200
    orb = cv2.ORB_create(nfeatures=1500, edgeThreshold=EDGE_MARGIN_PX, patchSize=EDGE_MARGIN_PX)
    levels = [keypoint.octave for keypoint in orb.detect(padded_template(SIZE_PX, EDGE_MARGIN_PX), None)]
    assert levels.count(0) >= 20


def test_the_templates_features_lie_on_the_marker():
    """Template features are in px of the marker itself: none lies outside it by more than a pixel."""
    assert TEMPLATE.points_px.min() >= -1.0
    assert TEMPLATE.points_px.max() <= SIZE_PX


@settings(deadline=None, max_examples=60)
@given(st.floats(-5, 165), st.floats(-5, 125), st.sampled_from([48, 49, 96]))
def test_pasting_puts_the_middle_within_half_a_pixel(x, y, size_px):
    """The marker's middle lies within half a pixel of the asked place, inside the image; nothing else changes."""
    image = textured(120, 160)
    marked = paste_marker(image, np.array([x, y]), size_px, 20)
    (ox, oy), (px, py) = marked.origin_px, marked.paste_px
    middle = np.array([px - ox, py - oy]) + (size_px - 1) / 2
    # Places outside the image, which no centroid has, are brought back to its border.
    wanted = np.clip([x, y], [-0.5, -0.5], [159.5, 119.5])
    assert np.all(np.abs(middle - wanted) <= 0.5 + 1e-9 + (np.array([x, y]) != wanted))
    pasted = marked.canvas_bgr[py : py + size_px, px : px + size_px]
    np.testing.assert_array_equal(pasted, np.repeat(marker_pattern(size_px)[..., None], 3, 2))
    rest = np.ones(marked.canvas_bgr.shape[:2], bool)
    rest[py : py + size_px, px : px + size_px] = False
    inside = rest[oy : oy + 120, ox : ox + 160]
    np.testing.assert_array_equal(marked.canvas_bgr[oy : oy + 120, ox : ox + 160][inside], image[inside])


def test_pasting_leaves_the_image_alone():
    """The caller's image is not written to."""
    image = textured(120, 160)
    before = image.copy()
    paste_marker(image, np.array([80.0, 60.0]), 48, 31)
    np.testing.assert_array_equal(image, before)


@pytest.mark.parametrize("x", [0.0, 13.4, 319.5, 600.0, 639.0])
@pytest.mark.parametrize("y", [0.0, 240.2, 479.0])
def test_the_marker_is_found_everywhere_even_in_corners(x, y):
    """At corners, borders and the middle it is found with 40 inliers or more, its centre within 1 px."""
    centre_px = np.array([x, y])
    marked = paste_marker(textured(), centre_px, SIZE_PX, EDGE_MARGIN_PX)
    found = find_marker(marked, TEMPLATE, PROFILE.marker, PROFILE.features)
    assert found.status is Status.OK
    assert found.inlier_count is not None
    assert found.inlier_count >= 40
    assert found.centroid_px is not None
    assert found.corners_px is not None
    pasted_px = np.array(marked.paste_px) - marked.origin_px + (SIZE_PX - 1) / 2
    assert np.linalg.norm(found.centroid_px - centre_px) < 1.0
    assert np.linalg.norm(found.centroid_px - pasted_px) < 0.5
    assert np.abs(found.corners_px.mean(0) - pasted_px).max() < 0.5


def test_a_canvas_without_features_says_so_and_claims_nothing():
    """On a canvas without the marker, what was not reached is None: no count, no place."""
    marked = paste_marker(
        np.full((200, 200, 3), 90, np.uint8), np.array([100.0, 100.0]), SIZE_PX, EDGE_MARGIN_PX
    )
    marked.canvas_bgr[:] = 90
    found = find_marker(marked, TEMPLATE, PROFILE.marker, PROFILE.features)
    assert found.status is Status.NO_FEATURES
    assert found.keypoint_count == 0
    assert (found.match_count, found.inlier_count, found.corners_px, found.centroid_px) == (None,) * 4


def test_a_canvas_without_the_marker_is_not_mistaken_for_it():
    """Texture alone, with hundreds of features, gives too few matches or no homography, and no inliers."""
    marked = paste_marker(textured(), np.array([320.0, 240.0]), SIZE_PX, EDGE_MARGIN_PX)
    height, width = marked.canvas_bgr.shape[:2]
    marked.canvas_bgr[:] = textured(height + 8, width + 8, seed=2)[:height, :width]
    found = find_marker(marked, TEMPLATE, PROFILE.marker, PROFILE.features)
    assert found.status in {Status.TOO_FEW_MATCHES, Status.NO_HOMOGRAPHY}
    assert found.match_count is not None
    assert found.inlier_count is None
    assert found.centroid_px is None


def test_detection_does_not_depend_on_what_ran_before():
    """Two detections on the same canvas are equal bit for bit."""
    grey = cv2.cvtColor(textured(), cv2.COLOR_BGR2GRAY)
    first, second = detect_orb(grey, 500), detect_orb(grey, 500)
    np.testing.assert_array_equal(first.points_px, second.points_px)
    np.testing.assert_array_equal(first.descriptors, second.descriptors)

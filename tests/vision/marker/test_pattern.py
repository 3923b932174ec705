"""The virtual marker: what its comment promises about its bits, and where it is pasted."""

from __future__ import annotations

from itertools import combinations, groupby

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.vision.marker import (
    DATA_ROWS,
    EDGE_MARGIN_PX,
    detect_orb,
    marker_pattern,
    padded_template,
    paste_marker,
)

SIZE_PX = 96
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
    assert len(detect_orb(padded_template(SIZE_PX, EDGE_MARGIN_PX), 1500)) >= 200
    orb = cv2.ORB_create(nfeatures=1500, edgeThreshold=EDGE_MARGIN_PX, patchSize=EDGE_MARGIN_PX)
    levels = [keypoint.octave for keypoint in orb.detect(padded_template(SIZE_PX, EDGE_MARGIN_PX), None)]
    assert levels.count(0) >= 20


@settings(deadline=None, max_examples=60)
@given(st.floats(-5, 165), st.floats(-5, 125), st.sampled_from([48, 49, 96]), st.sampled_from([20, 31]))
def test_pasting_puts_the_middle_within_half_a_pixel(x, y, size_px, margin_px):
    """The marker's middle lies within half a pixel of the asked place, inside the image."""
    marked = paste_marker(textured(120, 160), np.array([x, y]), size_px, margin_px)
    middle = np.array(marked.origin_px) + margin_px + (size_px - 1) / 2
    # Places outside the image, which no centroid has, are brought back to its border.
    wanted = np.clip([x, y], [-0.5, -0.5], [159.5, 119.5])
    assert np.all(np.abs(middle - wanted) <= 0.5 + 1e-9 + (np.array([x, y]) != wanted))


@settings(deadline=None, max_examples=60)
@given(st.floats(-5, 165), st.floats(-5, 125), st.sampled_from([48, 49, 96]), st.sampled_from([20, 31]))
def test_the_window_is_the_image_about_the_marker(x, y, size_px, margin_px):
    """Around the marker are the image's own pixels, continued by its edge where the window reaches over it."""
    image = textured(120, 160)
    marked = paste_marker(image, np.array([x, y]), size_px, margin_px)
    x0, y0 = marked.origin_px
    side = size_px + 2 * margin_px
    beyond = 300
    padded = np.pad(image, ((beyond, beyond), (beyond, beyond), (0, 0)), mode="edge")
    expected = padded[y0 + beyond : y0 + beyond + side, x0 + beyond : x0 + beyond + side].copy()
    expected[margin_px:-margin_px, margin_px:-margin_px] = marker_pattern(size_px)[..., None]
    np.testing.assert_array_equal(marked.window_bgr, expected)


def test_pasting_leaves_the_image_alone():
    """The caller's image is not written to."""
    image = textured(120, 160)
    before = image.copy()
    paste_marker(image, np.array([80.0, 60.0]), 48, 31)
    np.testing.assert_array_equal(image, before)


def test_detection_does_not_depend_on_what_ran_before():
    """Two detections on the same canvas are equal bit for bit."""
    grey = cv2.cvtColor(textured(), cv2.COLOR_BGR2GRAY)
    first, second = detect_orb(grey, 500), detect_orb(grey, 500)
    np.testing.assert_array_equal(first.points_px, second.points_px)
    np.testing.assert_array_equal(first.descriptors, second.descriptors)

"""The paper's marker: where it is pasted, and the homography that its matches give."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.profile.settings import MarkerSettings
from svmdist.vision import marker


@settings(max_examples=60)
@given(st.floats(-5, 165), st.floats(-5, 125), st.sampled_from([48, 49, 96]), st.sampled_from([20, 31]))
def test_pasting_puts_the_middle_within_half_a_pixel(x, y, size_px, margin_px):
    """The marker's middle lies within half a pixel of the asked place, inside the image."""
    image = np.full((120, 160, 3), 90, np.uint8)
    _, origin_px = marker.paste_marker(image, np.array([x, y]), size_px, margin_px)
    middle = np.array(origin_px) + margin_px + (size_px - 1) / 2
    # Places outside the image, which no centroid has, are brought back to its border.
    wanted = np.clip([x, y], [-0.5, -0.5], [159.5, 119.5])
    assert np.all(np.abs(middle - wanted) <= 0.5 + 1e-9 + (np.array([x, y]) != wanted))


SIZE_PX = 96
PERSPECTIVE = np.array([[0.9, 0.15, 210.0], [-0.1, 1.05, 130.0], [4e-4, -3e-4, 1.0]])
SHIFT = np.array([[1.0, 0.0, 210.0], [0.0, 1.0, 130.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("H", [PERSPECTIVE, SHIFT])
@pytest.mark.parametrize(("outliers", "tolerance_px"), [(0, 1e-3), (32, 1e-2)])
def test_a_known_homography_is_recovered(H, outliers, tolerance_px):
    """Without noise the corners come back within 1e-3 px, and within 1e-2 px with 40 % outliers.

    MAGSAC gives near outliers a small weight rather than none, hence the second tolerance.
    """
    rng = np.random.default_rng(1)
    template_px = rng.uniform(0, SIZE_PX, (80, 2))
    frame_px = marker.transfer(H, template_px)
    frame_px[:outliers] = rng.uniform(0, 480, (outliers, 2))
    found = marker.fit_homography(marker.Matches(template_px, frame_px), 3.0)
    fitted, inliers = found
    found_px, true_px = (marker.marker_corners(one, SIZE_PX, MarkerSettings()) for one in (fitted, H))
    np.testing.assert_allclose(found_px, true_px, atol=tolerance_px)
    assert fitted[2, 2] == 1.0
    assert np.all(inliers[outliers:])
    assert np.count_nonzero(inliers[:outliers]) <= 1


IMPLAUSIBLE = {
    "mirrored": np.diag([-1, 1, 1.0]),
    "flipped": np.diag([1, -1, 1.0]),
    "too small": np.diag([0.4, 0.4, 1.0]),
    "too large": np.diag([2.1, 2.1, 1.0]),
    "flat": np.diag([0, 1, 1.0]),
    "folded": np.array([[1, 0, 0], [0, 1, 0], [-0.02, 0, 1.0]]),
    "at infinity": np.array([[1, 0, 0], [0, 1, 0], [-1 / 95, 0, 1.0]]),
}


@pytest.mark.parametrize("name", IMPLAUSIBLE)
def test_flips_folds_and_other_sizes_are_refused(name):
    """A pasted marker can be neither mirrored nor folded nor far from its own size."""
    assert marker.marker_corners(IMPLAUSIBLE[name], SIZE_PX, MarkerSettings()) is None

"""The paper's marker: its pattern, ORB features and matching, the homography, and both readings of the equations."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.vision.marker import (
    Matches,
    fit_homography,
    is_plausible,
    paste_marker,
    square_corners,
    transfer,
    transfer_error,
)


def textured(height: int = 480, width: int = 640, seed: int = 1) -> np.ndarray:
    """A BGR image of smooth random blotches, which have ORB corners of their own."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(40, 160, (height // 8, width // 8, 3)).astype(np.uint8)
    return np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), np.uint8)


@settings(deadline=None, max_examples=60)
@given(st.floats(-5, 165), st.floats(-5, 125), st.sampled_from([48, 49, 96]), st.sampled_from([20, 31]))
def test_pasting_puts_the_middle_within_half_a_pixel(x, y, size_px, margin_px):
    """The marker's middle lies within half a pixel of the asked place, inside the image."""
    marked = paste_marker(textured(120, 160), np.array([x, y]), size_px, margin_px)
    middle = np.array(marked.origin_px) + margin_px + (size_px - 1) / 2
    # Places outside the image, which no centroid has, are brought back to its border.
    wanted = np.clip([x, y], [-0.5, -0.5], [159.5, 119.5])
    assert np.all(np.abs(middle - wanted) <= 0.5 + 1e-9 + (np.array([x, y]) != wanted))


SIZE_PX = 96
PERSPECTIVE = np.array([[0.9, 0.15, 210.0], [-0.1, 1.05, 130.0], [4e-4, -3e-4, 1.0]])
SHIFT = np.array([[1.0, 0.0, 210.0], [0.0, 1.0, 130.0], [0.0, 0.0, 1.0]])


def transfer_as_published(H: np.ndarray, points_px: np.ndarray) -> np.ndarray:
    """eq. (17) as published: no division by the scale, right only while the third row is 0 0 1."""
    return points_px @ H[:2, :2].T + H[:2, 2]


def inliers_as_published(error_px: np.ndarray, threshold_px: float) -> np.ndarray:
    """eq. (18) as published: a match is an inlier if Δd > threshold. It keeps the outliers."""
    return error_px > threshold_px


def matches_under(
    H: np.ndarray, count: int = 80, outliers: int = 0, noise_px: float = 0.0, seed: int = 1
) -> Matches:
    """Random template points and where H puts them; the first `outliers` of them anywhere in the image."""
    rng = np.random.default_rng(seed)
    template_px = rng.uniform(0, SIZE_PX, (count, 2))
    frame_px = transfer(H, template_px) + rng.normal(scale=noise_px, size=(count, 2))
    frame_px[:outliers] = rng.uniform(0, 480, (outliers, 2))
    return Matches(template_px, frame_px)


@pytest.mark.parametrize("H", [PERSPECTIVE, SHIFT])
@pytest.mark.parametrize(("outliers", "tolerance_px"), [(0, 1e-3), (32, 1e-2)])
def test_a_known_homography_is_recovered(H, outliers, tolerance_px):
    """Without noise the corners come back within 1e-3 px, and within 1e-2 px with 40 % outliers.

    MAGSAC gives near outliers a small weight rather than none, hence the second tolerance.
    """
    found = fit_homography(matches_under(H, outliers=outliers), 3.0)
    assert found is not None
    corners = square_corners(SIZE_PX)
    np.testing.assert_allclose(transfer(found.H, corners), transfer(H, corners), atol=tolerance_px)
    assert found.H[2, 2] == 1.0
    assert np.all(found.inliers[outliers:])
    assert np.count_nonzero(found.inliers[:outliers]) <= 1


def test_eq_18_corrected_keeps_inliers_and_the_published_one_outliers():
    """With ">" as published the inlier set is the complement: exactly what does not fit."""
    matches = matches_under(SHIFT, outliers=20)
    found = fit_homography(matches, 3.0)
    assert found is not None
    published = inliers_as_published(transfer_error(found.H, matches.template_px, matches.frame_px), 3.0)
    np.testing.assert_array_equal(published, ~found.inliers)
    assert np.count_nonzero(published[20:]) == 0


def test_the_published_eq_17_is_wrong_under_perspective():
    """With a third row that is not 0 0 1 the published reading misses by pixels, and by λ exactly."""
    corners = square_corners(SIZE_PX)
    scale = np.column_stack([corners, np.ones(4)]) @ PERSPECTIVE[2]
    np.testing.assert_allclose(
        transfer_as_published(PERSPECTIVE, corners),
        transfer(PERSPECTIVE, corners) * scale[:, None],
        rtol=1e-12,
    )
    off_px = np.linalg.norm(
        transfer_as_published(PERSPECTIVE, corners) - transfer(PERSPECTIVE, corners), axis=1
    )
    assert off_px[1:].max() > 3.0


def scaled(x: float, y: float) -> np.ndarray:
    """A homography that scales the axes."""
    return np.diag([x, y, 1.0])


@pytest.mark.parametrize(
    "H",
    [
        scaled(-1, 1),
        scaled(1, -1),
        scaled(0.4, 0.4),
        scaled(2.1, 2.1),
        scaled(0, 1),
        np.array([[1, 0, 0], [0, 1, 0], [-0.02, 0, 1.0]]),
        np.array([[1, 0, 0], [0, 1, 0], [-1 / 95, 0, 1.0]]),
    ],
    ids=["mirrored", "flipped", "too small", "too large", "flat", "folded", "at infinity"],
)
def test_flips_folds_and_other_sizes_are_refused(H):
    """A pasted marker can be neither mirrored nor folded nor far from its own size."""
    assert not is_plausible(H, SIZE_PX)

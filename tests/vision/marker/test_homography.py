"""The homography: recovery, robustness, determinism, and both readings of eqs. (17) and (18)."""

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
    least_squares_homography,
    square_corners,
    transfer,
    transfer_error,
)

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


@pytest.mark.parametrize("seed", range(5))
def test_noise_and_outliers_together_are_borne(seed):
    """With 0.3 px of noise and 40 % outliers the square's middle is found within 0.3 px."""
    found = fit_homography(matches_under(SHIFT, outliers=32, noise_px=0.3, seed=seed), 3.0)
    assert found is not None
    middle = np.array([[47.5, 47.5]])
    assert np.linalg.norm(transfer(found.H, middle) - transfer(SHIFT, middle)) < 0.3


def test_two_calls_give_the_same_bits():
    """The sampler has its own seed: equal matches give an equal homography, bit for bit."""
    matches = matches_under(PERSPECTIVE, outliers=30, noise_px=0.5)
    first, second = fit_homography(matches, 3.0), fit_homography(matches, 3.0)
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(first.H, second.H)
    np.testing.assert_array_equal(first.inliers, second.inliers)


def degenerate(kind: str) -> Matches:
    """Matches that carry no homography, by what is wrong with them."""
    rng = np.random.default_rng(1)
    t = np.linspace(0, 90, 30)
    scattered = rng.uniform(0, 90, (30, 2))
    return {
        "none": Matches(np.zeros((0, 2)), np.zeros((0, 2))),
        "three": Matches(scattered[:3], scattered[:3]),
        "all alike": Matches(np.full((30, 2), 5.0), np.full((30, 2), 7.0)),
        "to one point": Matches(scattered, np.full((30, 2), 7.0)),
        "on one line": Matches(np.stack([t, 2 * t], 1), np.stack([t, 2 * t + 3], 1)),
    }[kind]


@pytest.mark.parametrize("kind", ["none", "three", "all alike", "on one line"])
def test_degenerate_points_give_no_homography(kind):
    """Too few points, equal points and points on one line give None, not an exception."""
    assert fit_homography(degenerate(kind), 3.0) is None


def test_a_collapse_to_one_point_is_no_plausible_homography():
    """Where all matches end in one point, there is no homography, or one that no marker can have."""
    found = fit_homography(degenerate("to one point"), 3.0)
    assert found is None or not is_plausible(found.H, SIZE_PX)


def test_eq_18_corrected_keeps_inliers_and_the_published_one_outliers():
    """With ">" as published the inlier set is the complement: exactly what does not fit."""
    matches = matches_under(SHIFT, outliers=20)
    found = fit_homography(matches, 3.0)
    assert found is not None
    published = inliers_as_published(transfer_error(found.H, matches.template_px, matches.frame_px), 3.0)
    np.testing.assert_array_equal(published, ~found.inliers)
    assert np.count_nonzero(published[20:]) == 0


def test_eq_18_counts_a_match_at_the_threshold():
    """Δd = 3 px exactly is an inlier of the corrected reading and not of the published one."""
    error_px = transfer_error(np.eye(3), np.array([[0.0, 0.0]]), np.array([[3.0, 0.0]]))
    assert error_px.tolist() == [3.0]
    assert inliers_as_published(error_px, 3.0).tolist() == [False]


def test_the_transfer_error_is_a_distance_in_pixels():
    """A match 3 px and 4 px off has Δd = 5 px; a point at infinity has Δd = ∞, never NaN."""
    assert transfer_error(np.eye(3), np.array([[1.0, 2.0]]), np.array([[4.0, 6.0]])).tolist() == [5.0]
    H = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    assert transfer_error(H, np.array([[0.0, 0.0]]), np.array([[0.0, 0.0]])).tolist() == [np.inf]


@settings(deadline=None, max_examples=50)
@given(st.lists(st.floats(-2, 2), min_size=6, max_size=6), st.floats(0.1, 10.0))
def test_both_readings_of_eq_17_agree_on_affine_maps(entries, scale):
    """While the third row is 0 0 1 the published eq. (17) is right; any other scale of H needs the division."""
    H = np.vstack([np.reshape(entries, (2, 3)), [0.0, 0.0, 1.0]])
    corners = square_corners(SIZE_PX)
    np.testing.assert_allclose(transfer_as_published(H, corners), transfer(H, corners), atol=1e-12)
    np.testing.assert_allclose(transfer(scale * H, corners), transfer(H, corners), atol=1e-9)


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
    "H", [np.eye(3), PERSPECTIVE, SHIFT, scaled(0.6, 0.6), scaled(1.9, 1.9), scaled(-1, -1)]
)
def test_similar_convex_shapes_are_plausible(H):
    """Shifts, turns, mild perspective and up to twice the size are what a marker may look like."""
    assert is_plausible(H, SIZE_PX)


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


def test_the_corners_of_a_square_are_pixel_centres():
    """A square of n pixels spans n - 1, clockwise from the top left."""
    np.testing.assert_array_equal(square_corners(4), [[0, 0], [3, 0], [3, 3], [0, 3]])


@pytest.mark.parametrize("H", [PERSPECTIVE, SHIFT])
def test_the_refit_is_the_least_squares_fit_of_opencv(H):
    """With 0.3 px of noise the corners agree within 1e-4 px; OpenCV's own iteration ends at about that."""
    matches = matches_under(H, noise_px=0.3)
    found = least_squares_homography(H, matches.template_px, matches.frame_px)
    expected, _ = cv2.findHomography(matches.template_px, matches.frame_px, 0)
    assert found is not None
    corners = square_corners(SIZE_PX)
    np.testing.assert_allclose(transfer(found, corners), transfer(expected, corners), atol=1e-4)


def test_the_refit_is_at_its_minimum():
    """A step of 1e-3 px of any corner of the square, up to the homography of four points, raises the squared error."""
    matches = matches_under(PERSPECTIVE, noise_px=0.3)

    def squared_error(H: np.ndarray) -> float:
        return float(np.square(transfer_error(H, matches.template_px, matches.frame_px)).sum())

    found = least_squares_homography(PERSPECTIVE, matches.template_px, matches.frame_px)
    assert found is not None
    corners = square_corners(SIZE_PX)
    for step in np.eye(8).reshape(8, 4, 2) * 1e-3:
        for sign in (-1, 1):
            moved = (transfer(found, corners) + sign * step).astype(np.float32)
            other = cv2.getPerspectiveTransform(corners.astype(np.float32), moved)
            assert squared_error(other) > squared_error(found)


@pytest.mark.parametrize("kind", ["all alike", "to one point"])
def test_a_refit_of_points_that_are_all_alike_is_refused(kind):
    """Points that are all alike have no size to be normalised by."""
    matches = degenerate(kind)
    assert least_squares_homography(SHIFT, matches.template_px, matches.frame_px) is None

"""The centroid of a polygon: laws of areas, and OpenCV's moments as a second opinion."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.transforms import polygon_centroid

TRIANGLE = np.array([[1.0, 2.0], [7.0, 3.0], [4.0, 10.0]])


def convex(seed: int, size: float = 1.0) -> np.ndarray:
    """A random convex polygon about (300, 200) times the size."""
    points = np.random.default_rng(seed).uniform(200, 400, (12, 2)).astype(np.float32)
    return np.asarray(cv2.convexHull(points)[:, 0] * size, np.float64)


def test_a_triangles_centroid_is_the_mean_of_its_corners() -> None:
    """Of a triangle alone, to rounding."""
    np.testing.assert_allclose(polygon_centroid(TRIANGLE), TRIANGLE.mean(0), rtol=1e-14)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 10_000), st.integers(0, 11))
def test_neither_first_corner_nor_sense_of_rotation_matters(seed: int, first: int) -> None:
    """The same polygon from another corner on, or the other way round, to rounding."""
    corners = convex(seed)
    expected = polygon_centroid(corners)
    np.testing.assert_allclose(polygon_centroid(np.roll(corners, first, axis=0)), expected, rtol=1e-11)
    np.testing.assert_allclose(polygon_centroid(corners[::-1]), expected, rtol=1e-11)


@pytest.mark.parametrize("size", [1e-4, 1.0, 10.0])
def test_it_agrees_with_opencvs_moments(size: float) -> None:
    """OpenCV takes single precision, hence 1e-4 of the size; in metres as in pixels the unit is the polygon's."""
    for seed in range(20):
        moments = cv2.moments(convex(seed).astype(np.float32))
        expected = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
        np.testing.assert_allclose(polygon_centroid(convex(seed, size)), size * expected, rtol=1e-6)


def test_contours_of_opencv_are_polygons() -> None:
    """The shape (n, 1, 2) and whole numbers are taken as they come."""
    corners = np.round(TRIANGLE).astype(np.int32)
    np.testing.assert_array_equal(polygon_centroid(corners[:, None]), polygon_centroid(corners))


@pytest.mark.parametrize("corners", [[[3, 4]], [[0, 0], [4, 2]], [[1, 1], [2, 2], [6, 6]], [[5, 5]] * 4])
def test_without_area_it_is_the_mean_of_the_corners(corners: list[list[int]]) -> None:
    """A point, a segment and points on one line have no area to divide by."""
    np.testing.assert_allclose(polygon_centroid(np.array(corners)), np.mean(corners, axis=0))

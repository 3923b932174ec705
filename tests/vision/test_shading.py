"""What shading draws an edge aside by: found again from drawings of which the place is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.vision.edges import edge_points, shading_shift_px

OUTWARD = np.array([1.0, 0.0])


def _edge(inside: float, outside: float, sigma_px: float, box_px: int) -> np.ndarray:
    """A dark half up to x = 79.5 whose shades change by so many levels a px, blurred, with noise of 2 levels."""
    x = np.arange(160) - 79.5
    profile = np.where(x < 0.0, 40.0 + inside * x, 140.0 + outside * x)
    image = np.tile(profile, (80, 1))
    image = cv2.GaussianBlur(image, (0, 0), sigma_px) if sigma_px else image
    image = cv2.blur(image, (box_px, 1)) if box_px else image
    image = image + np.random.default_rng(8).normal(0.0, 2.0, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("sigma_px", "box_px", "blur_px"), [(0.8, 0, 0.8), (2.0, 0, 2.0), (0.6, 9, 3.8)])
@pytest.mark.parametrize(("inside", "outside"), [(0.0, 0.0), (-1.0, 0.0), (0.8, -0.4), (-0.5, 0.5)])
def test_the_shift_is_that_of_the_points(
    sigma_px: float, box_px: int, blur_px: float, inside: float, outside: float
) -> None:
    """Steepest points lie aside by up to 0.1 px; without the shift they are right within 0.03 px."""
    image = _edge(inside, outside, sigma_px, box_px)
    start_px, end_px = np.array([79.0, 8.0]), np.array([80.2, 72.0])
    points_px = edge_points(image, start_px, end_px, OUTWARD, 8.0, blur_px=blur_px)
    off_px = float(np.median(points_px[:, 0])) - 79.5
    shift_px = shading_shift_px(image, points_px, OUTWARD, blur_px=blur_px)
    assert abs(off_px - shift_px) < 0.03
    if outside - inside >= 1.0 and blur_px >= 2.0:
        assert off_px > 0.035  # there is something to be taken off


def test_no_edge_has_no_shift() -> None:
    flat = np.full((50, 50), 90, np.uint8)
    assert shading_shift_px(flat, np.array([[25.0, 25.0], [25.0, 26.0]]), OUTWARD) == 0.0
    assert shading_shift_px(flat, np.array([[2.0, 25.0]]), OUTWARD) == 0.0  # beside the border

"""The search for a tag near a predicted place against the search of the whole image."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.settings.tag import TagSettings
from svmdist.transforms import Array
from svmdist.vision.tag.detection import DICTIONARIES, TagFinder, tag_plate

FINDER = TagFinder("36h11", 0)


def scene(seed: int, side_px: float, tag_id: int = 0) -> tuple[np.ndarray, Array]:
    """An image of a turned tag of about this side on a plate, and its corners."""
    rng = np.random.default_rng(seed)
    cells = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(DICTIONARIES["36h11"]), tag_id, 8)
    texture = np.kron(np.pad(cells, 1, constant_values=230), np.ones((12, 12), np.uint8))
    angle, middle = rng.uniform(0, 2 * np.pi), rng.uniform([150, 150], [490, 330])
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    to_image = np.column_stack([R * side_px / 96, middle - R @ [59.5, 59.5] * side_px / 96])
    image = np.full((480, 640), 100, np.uint8)
    cv2.warpAffine(texture, to_image, (640, 480), image, cv2.INTER_AREA, cv2.BORDER_TRANSPARENT)
    image = cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(0, 2, image.shape)
    return np.clip(image, 0, 255).astype(np.uint8), middle + side_px * square @ R.T


@pytest.mark.parametrize("side_px", [30.0, 45.0, 60.0])
def test_the_corners_near_a_place_are_those_of_the_whole_image(side_px: float) -> None:
    """Within 1e-4 px: what is refined are the same pixels, rounded as float32. The place is off by a quarter."""
    for seed in range(5):
        image, truth = scene(seed, side_px)
        whole = FINDER.corners_px(image)
        assert whole is not None
        np.testing.assert_allclose(whole, truth, atol=1.5)
        off = 0.25 * side_px * np.random.default_rng(seed).uniform(-1, 1, 2)
        near = FINDER.corners_px(image, (*(truth.min(0) + off), *(truth.max(0) + off)))
        assert near is not None
        np.testing.assert_allclose(near, whole, atol=1e-4)


@pytest.mark.parametrize(
    "near", [(0.0, 0.0, 20.0, 20.0), (-900.0, -900.0, -800.0, -800.0), (700.0, 0.0, 740.0, 40.0)]
)
def test_a_tag_that_is_elsewhere_is_found_all_the_same(near: tuple[float, float, float, float]) -> None:
    image, _ = scene(1, 45.0)
    whole, found = FINDER.corners_px(image), FINDER.corners_px(image, near)
    assert whole is not None
    assert found is not None
    np.testing.assert_array_equal(found, whole)


def test_a_tag_of_another_number_or_too_small_is_not_taken() -> None:
    assert FINDER.corners_px(scene(2, 45.0, tag_id=7)[0]) is None
    demanding = TagFinder("36h11", 0, TagSettings(min_side_px=80.0))
    assert demanding.corners_px(scene(2, 45.0)[0]) is None


def test_the_plate_is_the_square_grown_about_its_middle() -> None:
    """Its area is the square of the ratio, within the rim's pixels."""
    corners = np.array([[100.0, 100.0], [140.0, 100.0], [140.0, 140.0], [100.0, 140.0]])
    area_px = np.count_nonzero(tag_plate(corners, (240, 240), TagSettings(plate_ratio=1.5)))
    assert area_px == pytest.approx(61**2, rel=0.02)

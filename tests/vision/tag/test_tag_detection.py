"""Tags are found by their corners, in any thread, and their plate is the square around them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from svmdist.settings.tag import TagSettings
from svmdist.transforms import Array
from svmdist.vision.tag.detection import DICTIONARIES, find_tags, tag_plate


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
def test_corners_are_those_of_the_tag(side_px: float) -> None:
    """Within 1.5 px of the truth, in the order in which one reads the tag; their pose is refined on all pixels."""
    for seed in range(5):
        image, truth = scene(seed, side_px)
        np.testing.assert_allclose(find_tags(image, "36h11")[0], truth, atol=1.5)


def test_threads_find_the_same_corners() -> None:
    """Each thread has a detector of its own: many at once find what one after the other finds."""
    images = [scene(seed, 45.0)[0] for seed in range(12)]
    alone = [find_tags(image, "36h11")[0] for image in images]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda image: find_tags(image, "36h11")[0], images))
    np.testing.assert_array_equal(together, alone)


def test_a_tag_has_its_number_and_one_too_small_is_not_taken() -> None:
    assert set(find_tags(scene(2, 45.0, tag_id=7)[0], "36h11")) == {7}
    assert not find_tags(scene(2, 45.0)[0], "36h11", TagSettings(min_side_px=80.0))


def test_the_plate_is_the_square_grown_about_its_middle() -> None:
    """Its area is the square of the ratio, within the rim's pixels."""
    corners = np.array([[100.0, 100.0], [140.0, 100.0], [140.0, 140.0], [100.0, 140.0]])
    area_px = np.count_nonzero(tag_plate(corners, (240, 240), TagSettings(plate_ratio=1.5)))
    assert area_px == pytest.approx(61**2, rel=0.02)

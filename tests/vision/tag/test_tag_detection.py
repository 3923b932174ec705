"""Tags are found by their corners, in any thread, and their plate is the square around them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from svmdist.profile.settings import TagSettings
from svmdist.transforms import Array
from svmdist.vision.tags import DICTIONARIES, find_every_tag, find_tags, refine_corners, tag_plate


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


def photographed(seed: int, side_px: float, ground: float = 110.0) -> tuple[np.ndarray, Array]:
    """An image of 160x120 whose pixels integrate over their area, of a turned and slanting tag 0, and its corners."""
    rng = np.random.default_rng(seed)
    cells = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(DICTIONARIES["36h11"]), 0, 8)
    plate = 20.0 + 0.8 * np.pad(cells, 1, constant_values=255)
    angle = rng.uniform(0, 2 * np.pi)
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    corners = (
        side_px / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ R.T * [rng.uniform(0.7, 1.0), 1.0]
    )
    corners = corners * (1.0 + rng.uniform(-0.05, 0.05, (4, 1))) + [80.0, 60.0] + rng.uniform(-3, 3, 2)
    on_plate = np.array([[1, 1], [9, 1], [9, 9], [1, 9]], np.float32)
    H = np.linalg.inv(cv2.getPerspectiveTransform(on_plate, corners.astype(np.float32)))
    parts = 6
    y, x = (np.mgrid[0 : 120 * parts, 0 : 160 * parts] + 0.5) / parts - 0.5
    foot = H @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    column, row = np.floor(foot[:2] / foot[2]).astype(int)
    inside = (np.minimum(column, row) >= 0) & (np.maximum(column, row) < 10)
    fine = np.full(x.size, ground)
    fine[inside] = plate[row[inside], column[inside]]
    image = fine.reshape(120, parts, 160, parts).mean((1, 3))
    image = cv2.GaussianBlur(image, (0, 0), 0.7) + rng.normal(0, 2, image.shape)
    return np.clip(image, 0, 255).astype(np.uint8), corners


@pytest.mark.parametrize(("side_px", "std_px"), [(18.0, 0.2), (24.0, 0.12), (34.0, 0.05), (50.0, 0.04)])
def test_corners_are_those_of_the_tag(side_px: float, std_px: float) -> None:
    """In the order in which one reads the tag, and without a bias: a pixel's middle is a whole number."""
    errors = []
    for seed in range(12):
        image, truth = photographed(seed, side_px)
        errors += [tag.corners_px - truth for tag in find_every_tag(image, "36h11")]
    assert len(errors) >= 11
    assert np.sqrt(np.mean(np.square(errors))) < std_px
    assert np.abs(np.mean(errors, (0, 1))).max() < 0.05


def test_rough_corners_are_drawn_to_the_edges() -> None:
    """From a pixel and a half beside them; and corners of nothing stay where they are."""
    image, truth = photographed(3, 40.0)
    rough = truth + np.array([[1.5, 0.0], [-1.0, 1.0], [0.0, -1.5], [1.0, 1.0]])
    np.testing.assert_allclose(refine_corners(image, rough, 8), truth, atol=0.2)
    plain = np.full_like(image, 90)
    np.testing.assert_array_equal(refine_corners(plain, rough, 8), rough)


def test_tags_of_one_number_are_all_found() -> None:
    """And the largest of them is the one that the number stands for."""
    large, small = photographed(1, 45.0)[0], photographed(2, 28.0)[0]
    both = np.hstack([small, large])
    assert [tag.number for tag in find_every_tag(both, "36h11")] == [0, 0]
    assert find_tags(both, "36h11")[0].mean(0)[0] > 160.0


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

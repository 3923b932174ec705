"""Tags: found by their corners."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.transforms import Array
from svmdist.vision.tags import DICTIONARIES, find_every_tag


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

"""Benchmarks of the tag: run with `--benchmark-enable --benchmark-group-by=group`.

On one core of 2026: the search of a whole image of 640x480 1.4 to 2 ms; the pose of a
tag of 40 px with a predicted rotation 3 ms, from both candidates 5 ms.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from svmdist.camera import Camera
from svmdist.estimation.detection.tag import find_tag_pose
from svmdist.transforms import Array, make_transform, rotation_x
from svmdist.vision.tag.detection import DICTIONARIES, find_tags, square_corners_m
from svmdist.vision.tag.pattern import TagPattern
from tests.rotations import rotation_y

SIZE_M = 0.007
CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
T = make_transform(rotation_x(np.pi - 0.3) @ rotation_y(0.4), [0.01, -0.005, 0.09])
PATTERN = TagPattern("36h11", 0, SIZE_M)


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    """A tag 40 px wide on a grey ground, blurred and noisy."""
    cells = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(DICTIONARIES["36h11"]), 0, 8)
    texture = np.kron(np.pad(cells, 1, constant_values=230), np.ones((16, 16), np.uint8))
    corners_px = CAMERA.project(square_corners_m(SIZE_M * 1.25) @ T[:3, :3].T + T[:3, 3])
    square = np.array([[-0.5, -0.5], [159.5, -0.5], [159.5, 159.5], [-0.5, 159.5]], np.float32)
    H = cv2.getPerspectiveTransform(square, corners_px.astype(np.float32))
    ground = np.full((480, 640), 110, np.uint8)
    cv2.warpPerspective(texture, H, (640, 480), ground, cv2.INTER_AREA, cv2.BORDER_TRANSPARENT)
    noisy = cv2.GaussianBlur(ground, (0, 0), 0.8) + np.random.default_rng(0).normal(0.0, 2.0, ground.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


@pytest.mark.benchmark(group="search for tags in 640x480")
def test_search(benchmark: BenchmarkFixture, image: np.ndarray) -> None:
    """Corners from the whole image."""
    assert 0 in benchmark(find_tags, image, "36h11")


@pytest.mark.benchmark(group="pose of a tag of 40 px")
@pytest.mark.parametrize("predicted", [None, T[:3, :3]], ids=["both candidates", "predicted"])
def test_pose(benchmark: BenchmarkFixture, image: np.ndarray, predicted: Array | None) -> None:
    """The refined pose, with and without a predicted rotation that is sure."""
    corners_px = find_tags(image, "36h11")[0]
    found = benchmark(find_tag_pose, image, corners_px, CAMERA, PATTERN, predicted, 0.01)
    assert np.abs(found.T_camera_tag - T).max() < 0.02

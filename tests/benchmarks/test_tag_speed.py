"""Benchmarks of the tag: run with `--benchmark-enable --benchmark-group-by=group`.

On one core of 2026: the search of a whole image of 640x480 1.4 to 2 ms, near a predicted place 0.2 to 1 ms; the pose
of a tag of 40 px with a predicted rotation 3 ms, from both candidates 5 ms.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from svmdist.camera import Camera
from svmdist.estimation.detection.tag import TagDetector
from svmdist.profile import Fiducial
from svmdist.transforms import Array, make_transform, rotation_x, rotation_y
from svmdist.vision.tag.detection import DICTIONARIES, square_corners_m

SIZE_M = 0.007
CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
T = make_transform(rotation_x(np.pi - 0.3) @ rotation_y(0.4), [0.01, -0.005, 0.09])
DETECTOR = TagDetector(Fiducial(family="36h11", id=0, size_m=SIZE_M, link="roll", position_m=(0.0, 0.0, 0.0)))


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


@pytest.mark.benchmark(group="search for a tag in 640x480")
@pytest.mark.parametrize("where", ["whole", "near"])
def test_search(benchmark: BenchmarkFixture, image: np.ndarray, where: str) -> None:
    """Corners from the whole image, and from where the tag is predicted."""
    x, y = CAMERA.project(T[:3, 3])[0]
    near = (x - 25.0, y - 25.0, x + 25.0, y + 25.0) if where == "near" else None
    assert benchmark(lambda: DETECTOR.detect(image, CAMERA, near)) is not None


@pytest.mark.benchmark(group="pose of a tag of 40 px")
@pytest.mark.parametrize("predicted", [None, T[:3, :3]], ids=["both candidates", "predicted"])
def test_pose(benchmark: BenchmarkFixture, image: np.ndarray, predicted: Array | None) -> None:
    """The refined pose, with and without a predicted rotation that is sure."""
    detection = DETECTOR.detect(image, CAMERA)
    assert detection is not None
    found = benchmark(lambda: DETECTOR.pose(image, detection, CAMERA, predicted, 0.01))
    assert np.abs(found.T_camera_tag - T).max() < 0.02

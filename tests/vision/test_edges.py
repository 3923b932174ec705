"""Sub-pixel edges: known places are found again, through blur and noise."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.profile.settings import ShaftSettings
from svmdist.transforms import Array
from svmdist.vision.edges import edge_blur_px, edge_points
from svmdist.vision.lines import fit_line, undistorted

FAINT = ShaftSettings(min_contrast_levels=15.0)


def half_plane(angle_rad: float, offset_px: float, blur_px: float, noise: float) -> Array:
    """A dark half plane, drawn in 8 x 8 parts of each pixel; dark where normal · (p - (60, 50)) < offset."""
    part = (np.arange(8) + 0.5) / 8 - 0.5
    x = (np.arange(120)[:, None] + part).ravel() - 60.0
    y = (np.arange(100)[:, None] + part).ravel() - 50.0
    bright = np.cos(angle_rad) * x[None, :] + np.sin(angle_rad) * y[:, None] > offset_px
    image = (30.0 + 140.0 * bright).reshape(100, 8, 120, 8).mean((1, 3))
    image = cv2.GaussianBlur(image, (0, 0), blur_px) if blur_px else image
    image = image + np.random.default_rng(3).normal(0.0, noise, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("blur_px", "noise", "tolerance_px"),
    [(0.8, 0.0, 0.02), (0.8, 4.0, 0.05), (3.0, 2.0, 0.08), (0.0, 2.0, 0.06)],
)
@pytest.mark.parametrize("angle_rad", [0.0, 0.4, 1.2, 2.0, 3.3, 5.1])
def test_line_is_found_where_it_was_drawn(
    blur_px: float, noise: float, tolerance_px: float, angle_rad: float
):
    normal = np.array([np.cos(angle_rad), np.sin(angle_rad)])
    along, at = np.array([-normal[1], normal[0]]), np.array([60.0, 50.0]) + 0.37 * normal
    image = half_plane(angle_rad, 0.37, blur_px, noise)
    rough = at + 1.7 * normal
    points = edge_points(image, rough - 35 * along, rough + 35 * along, normal, 5.0, FAINT)
    line = fit_line(points, 1.0)
    assert line is not None
    assert abs(line.normal @ (at - line.centre)) < tolerance_px
    assert abs(line.direction @ normal) < 0.003 + noise * 1e-3


def test_outliers_do_not_move_the_line():
    rng = np.random.default_rng(4)
    x = np.arange(100.0)
    y = 0.1 * x + rng.normal(0.0, 0.05, 100)
    y[20:50] += rng.uniform(3.0, 9.0, 30)
    line = fit_line(np.column_stack([x, y]), 1.0)
    assert line is not None
    assert abs(line.direction[1] / line.direction[0]) == pytest.approx(0.1, abs=1e-3)


def test_no_edge_gives_no_points_and_no_line():
    flat = np.full((50, 50), 90, np.uint8)
    points = edge_points(
        flat, np.array([10.0, 25.0]), np.array([40.0, 25.0]), np.array([0.0, 1.0]), 5.0, FAINT
    )
    assert len(points) == 0
    assert fit_line(points, 1.0) is None


def test_straightening_undoes_the_distortion():
    ideal = Camera.from_horizontal_fov(640, 480, 1.0)
    camera = Camera(640, 480, ideal.K, np.array([-0.12, 0.03, 1e-3, -5e-4, 0.0]))
    p = np.array([[0.2, -0.15, 1.0], [-0.3, 0.2, 1.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(undistorted(camera, camera.project(p)), p[:, :2], atol=1e-8)


@pytest.mark.parametrize("length_px", [0, 7, 13])
def test_a_moved_edge_is_found_in_its_middle_and_its_blur_measured(length_px: int) -> None:
    """Motion makes a ramp of a step: its middle is the edge, within 0.1 px, and it is as wide as it is long."""
    image = np.full((80, 160), 30.0)
    image[:, 80:] = 140.0
    if length_px:
        image = cv2.blur(image, (length_px, 1))
    image = np.clip(np.rint(image + np.random.default_rng(4).normal(0, 3, image.shape)), 0, 255)
    start, end, outward = np.array([81.0, 5.0]), np.array([78.5, 75.0]), np.array([1.0, 0.0])
    brightness = image.astype(np.uint8)
    blur_px = edge_blur_px(brightness, start, end, outward, 14.0)
    assert np.sqrt(8.0 * np.log(2.0)) * blur_px == pytest.approx(length_px, abs=2.0)
    points = edge_points(brightness, start, end, outward, 5.0 + 2.0 * blur_px, blur_px=blur_px)
    assert len(points) > 60
    assert abs(float(np.median(points[:, 0])) - 79.5) < 0.1

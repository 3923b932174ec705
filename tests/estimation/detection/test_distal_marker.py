"""The distal marker's middle through blur, beside steel and on red, and a sphere's perspective."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.instrument.shaft_detection import marker_centre, marker_disc
from svmdist.profile import load_profile
from svmdist.vision.colour import colour_mask
from svmdist.vision.frame_context import to_hsv
from svmdist.vision.lines import without_perspective
from svmdist.vision.regions import find_region

CAMERA = Camera.from_horizontal_fov(128, 96, 0.2)
CENTRE_PX = np.array([63.5, 47.5])
"""The image's own middle, where perspective does nothing."""


def _marker(blur_px: float) -> np.ndarray:
    """A cyan disc, its upper half on red tissue, its lower half on pale steel, which mix with it differently."""
    big = np.full((96 * 8, 128 * 8, 3), (60, 60, 190), np.float32)
    big[384:] = (165.0, 163.0, 160.0)
    cv2.circle(big, (512, 384), 93, (178.0, 158.0, 0.0), -1)
    image = cv2.resize(big, (128, 96), interpolation=cv2.INTER_AREA)
    return np.rint(cv2.GaussianBlur(image, (0, 0), blur_px)).astype(np.uint8)


def test_blur_moves_the_middle_less_than_the_region() -> None:
    """A threshold's region goes 0.3 px and more to one side; the middle stays within a third of that."""
    rule = load_profile().segmentation.instrument
    image = _marker(2.5)
    mask = colour_mask(to_hsv(image), rule)
    region = find_region(mask, rule)
    assert region is not None
    disc = marker_disc(to_hsv(image), mask, region)
    middle_px, blur_px = marker_centre(region, disc, CAMERA, 0.09, 0.00175)
    off_px = np.linalg.norm(region.centroid_px - CENTRE_PX)
    assert off_px > 0.3
    assert np.linalg.norm(middle_px - CENTRE_PX) < off_px / 3.0
    assert blur_px == pytest.approx(2.5, abs=0.8)
    np.testing.assert_array_equal(marker_centre(region, disc, CAMERA, 0.09, 0.0)[0], region.centroid_px)


def test_the_middle_of_a_sphere_is_between_its_tangents() -> None:
    """Rays that touch a sphere in the plane through the axis meet the image about another point than its centre."""
    radius_m, depth_m, aside_m = 0.005, 0.06, 0.03
    angle, half = np.arctan2(aside_m, depth_m), np.arcsin(radius_m / np.hypot(aside_m, depth_m))
    f, c = CAMERA.K[0, 0], CAMERA.K[:2, 2]
    middle_px = c + np.array([f * 0.5 * (np.tan(angle + half) + np.tan(angle - half)), 0.0])
    found_px = without_perspective(middle_px, CAMERA, depth_m, radius_m)
    assert abs(middle_px[0] - c[0] - f * aside_m / depth_m) > 0.1
    assert found_px[0] - c[0] == pytest.approx(f * aside_m / depth_m, rel=1e-4)
    np.testing.assert_array_equal(without_perspective(middle_px, CAMERA, 0.0, radius_m), middle_px)

"""The image of a sphere, against its tangent cone."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.transforms import Array
from svmdist.vision.lines import apparent_radius_px, without_perspective

CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)


def outline_px(centre_m: Array, radius_m: float) -> Array:
    """Pixels, shape (n, 2), where rays touch a sphere."""
    distance_m = float(np.linalg.norm(centre_m))
    sine = radius_m / distance_m
    towards = centre_m / distance_m
    side = np.cross(towards, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    up = np.cross(side, towards)
    angle = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)[:, None]
    circle = np.cos(angle) * side + np.sin(angle) * up
    return CAMERA.project(np.sqrt(1.0 - sine**2) * towards + sine * circle)


@pytest.mark.parametrize("centre_m", [(0.0, 0.0, 0.09), (0.03, -0.02, 0.08), (-0.04, 0.03, 0.12)])
def test_radius_is_that_of_the_outlines_area(centre_m: tuple[float, float, float]) -> None:
    """The disc of the outline's area has this radius, to the 0.1 % by which a sphere of 2 mm is not small."""
    outline = outline_px(np.array(centre_m), 0.002)
    x, y = outline.T
    area_px2 = 0.5 * abs(x @ np.roll(y, 1) - y @ np.roll(x, 1))
    radius_px = float(apparent_radius_px(np.array(centre_m), 0.002, CAMERA))
    assert radius_px == pytest.approx(np.sqrt(area_px2 / np.pi), rel=1e-3)


def test_the_middle_of_the_outline_is_not_the_centre() -> None:
    """Taking perspective off the outline's middle gives the centre's pixel, to 2 % of what it was off."""
    centre_m = np.array([0.03, -0.02, 0.06])
    middle_px = np.mean([outline_px(centre_m, 0.005).min(0), outline_px(centre_m, 0.005).max(0)], axis=0)
    true_px = CAMERA.project(centre_m)[0]
    found_px = without_perspective(middle_px, CAMERA, 0.06, 0.005)
    assert np.linalg.norm(found_px - true_px) < 0.02 * np.linalg.norm(middle_px - true_px)

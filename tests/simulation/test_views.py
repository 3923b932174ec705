"""OpenGL's matrices put a point where `Camera.project` does."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.simulation.effects import projection_matrix, view_matrix
from svmdist.transforms import inverse, make_transform, rotation_x, rotation_z, transform_points


@pytest.mark.parametrize("shift_px", [(0.0, 0.0), (-0.5, 0.5)])
def test_clip_coordinates_are_pixels(shift_px: tuple[float, float]) -> None:
    """From -1 to 1 across the image, whose borders lie half a pixel outside of the outer pixels' centres."""
    camera = Camera.from_horizontal_fov(640, 480, 1.1, "camera")
    T_world_camera = make_transform(rotation_x(np.pi - 0.1) @ rotation_z(0.3), [0.01, 0.02, 0.1])
    points_m = np.random.default_rng(0).uniform([-0.03, -0.02, 0.0], [0.03, 0.02, 0.03], (50, 3))
    view = np.reshape(view_matrix(T_world_camera), (4, 4)).T
    projection = np.reshape(projection_matrix(camera, shift_px), (4, 4)).T
    clip = np.column_stack([points_m, np.ones(50)]) @ (projection @ view).T
    x, y = (clip[:, :2] / clip[:, 3:]).T
    drawn_px = np.stack([(x + 1.0) * 320.0 - 0.5, (1.0 - y) * 240.0 - 0.5], -1)
    expected_px = camera.project(transform_points(inverse(T_world_camera), points_m)) + shift_px
    np.testing.assert_allclose(drawn_px, expected_px, atol=1e-9)  # rounding of some hundred pixels

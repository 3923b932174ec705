"""The world that is drawn: pictures by turns, and bodies where they are placed."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.simulation.scene import Scene
from svmdist.simulation.effects import PIXEL_SHIFT, projection_matrix, view_matrix

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.render import DrawnWorld


def test_a_turn_settles_the_picture(scene: Scene) -> None:
    """Even and odd turns may differ by a level, as TinyRenderer has it; nothing else before a picture matters."""
    view, projection = view_matrix(scene.T_world_camera), projection_matrix(scene.camera, PIXEL_SHIFT["tiny"])
    with DrawnWorld(scene, still=True, moving=False) as world:
        even, odd = (world.picture(view, projection, turn).image_bgr for turn in (0, 1))
        assert np.abs(even.astype(int) - odd.astype(int)).max() <= 1
        for turn in (1, 1, 6, 2, 3):  # with turns left out between
            image = world.picture(view, projection, turn).image_bgr
            np.testing.assert_array_equal(image, odd if turn % 2 else even)


def test_still_and_moving_bodies_are_apart(scene: Scene) -> None:
    """Floor and tissue fill the image; the robot alone leaves most of it empty, and farther than it is nothing."""
    view, projection = view_matrix(scene.T_world_camera), projection_matrix(scene.camera, PIXEL_SHIFT["tiny"])
    with DrawnWorld(scene, still=True, moving=False) as world:
        still = world.picture(view, projection, 0)
    with DrawnWorld(scene, still=False, moving=True) as world:
        world.pose(scene.posture, None, ())
        moving = world.picture(view, projection, 0)
    assert still.drawn.all()
    assert 0.01 < moving.drawn.mean() < 0.2
    assert moving.depth[moving.drawn].max() < moving.depth[~moving.drawn].min()

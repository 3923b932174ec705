"""Light from the endoscope's tip: fall-off, shadows and highlights, against what geometry says."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.perturbations.chosen import parse_perturbations
from svmdist.profile import Profile
from svmdist.simulation.scene import Extras
from svmdist.simulation.effects import Room
from svmdist.simulation.effects import FULL_LIGHT_M, GAMMA, LAMP_M, Lamp, Shader, shadow
from svmdist.simulation.effects import NO_PART, Surfaces, metric_depth_m
from svmdist.simulation.scene import make_scene
from svmdist.simulation.effects import FAR_M, NEAR_M
from svmdist.transforms import Array, make_transform

CAMERA = Camera.from_horizontal_fov(320, 240, np.pi / 3)
SHAPE = (240, 320)
FLOOR_M = 0.112
T_CAMERA_TISSUE = make_transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, FLOOR_M])


def floor(depth_m: float = FLOOR_M) -> Surfaces:
    """A floor across the camera's axis, and nothing before it."""
    depths = np.full(SHAPE, depth_m, np.float32)
    return Surfaces(CAMERA, depths, depths, np.ones(SHAPE, bool), np.full(SHAPE, NO_PART, np.int16), ())


def shaded(room: Room, surfaces: Surfaces, lamp_depth_m: Array | None = None, level: int = 100) -> Array:
    image = np.full((*SHAPE, 3), level, np.uint8)
    lamp = Lamp(LAMP_M, lamp_depth_m)
    return np.asarray(Shader(room, 1).shaded(image, surfaces, lamp, T_CAMERA_TISSUE)[..., 0], np.float64)


def test_depth_buffers_are_metric() -> None:
    """0 and 1 are the near and the far plane, and between them 1 / depth is a straight line."""
    buffer = np.array([[0.0, 0.25, 0.5, 1.0]], np.float32)
    depth_m = metric_depth_m(buffer)
    assert depth_m[0, [0, -1]] == pytest.approx([NEAR_M, FAR_M])
    np.testing.assert_allclose(1 / depth_m[0], 1 / NEAR_M + buffer[0] * (1 / FAR_M - 1 / NEAR_M), rtol=1e-6)


@pytest.mark.parametrize("depth_m", [0.06, 0.1, 0.112])
def test_light_falls_off_with_the_distance_squared(depth_m: float) -> None:
    """In light, not in levels: those are light to the power of 1 / 2.2."""
    seen = shaded(Room(light=1.0), floor(depth_m))
    for row, column in ((120, 160), (10, 10), (200, 300)):
        p_m = depth_m * np.array(
            [*((np.array([column, row]) - CAMERA.K[:2, 2]) / np.diag(CAMERA.K)[:2]), 1.0]
        )
        light = (FULL_LIGHT_M / np.linalg.norm(p_m - LAMP_M)) ** 2
        assert seen[row, column] == pytest.approx(100.0 * light ** (1 / GAMMA), abs=0.6)
    np.testing.assert_array_equal(shaded(Room(), floor()), 100.0)


def test_a_shadow_lies_where_the_lamp_throws_it() -> None:
    """A square at 80 mm from the lamp, drawn by hand: its shadow's middle is 1.4 times as far aside on the floor."""
    half_m, at_m = 0.008, np.array([0.01, 0.004, 0.080])
    column, row = np.meshgrid(np.arange(SHAPE[1]), np.arange(SHAPE[0]))
    x_m = (column - CAMERA.K[0, 2]) / CAMERA.K[0, 0] * at_m[2]
    y_m = (row - CAMERA.K[1, 2]) / CAMERA.K[1, 1] * at_m[2]
    is_there = (abs(x_m - at_m[0]) < half_m) & (abs(y_m - at_m[1]) < half_m)
    lamp_depth_m = np.where(is_there, at_m[2], FAR_M).astype(np.float32)
    hidden = shadow(CAMERA, floor().points_m(floor().depth_m), Lamp(LAMP_M, lamp_depth_m))
    rows, columns = np.nonzero(hidden > 0.5)
    expected_m = LAMP_M + at_m / at_m[2] * FLOOR_M
    np.testing.assert_allclose([columns.mean(), rows.mean()], CAMERA.project(expected_m[None])[0], atol=0.6)
    side_px = CAMERA.K[0, 0] * 2 * half_m / at_m[2]
    assert len(rows) == pytest.approx(side_px**2, rel=0.08)
    dark = shaded(Room(shadow=1.0), floor(), lamp_depth_m)
    assert dark[hidden > 0.999].max() == pytest.approx(100.0 * 0.25 ** (1 / GAMMA), abs=1.0)
    assert (dark[hidden == 0.0] == 100.0).all()


@pytest.mark.parametrize("eye_m", [0.0, 0.005])
def test_a_highlight_is_where_a_mirror_shows_the_lamp(eye_m: float) -> None:
    """On a plane across the axis, half way between eye and lamp; it goes with the eye, the tissue's pixels do not."""
    shader = Shader(Room(wet=1.0), 1)
    shader._slopes[:] = 0.0  # a film without bumps
    lamp = Lamp(LAMP_M - [eye_m, 0.0, 0.0], None)
    image = shader.shaded(np.zeros((*SHAPE, 3), np.uint8), floor(), lamp, T_CAMERA_TISSUE)[..., 0].astype(
        float
    )
    rows, columns = np.nonzero(image > 0.5 * image.max())
    mirror_m = np.array([*0.5 * lamp.place_m[:2], FLOOR_M])
    np.testing.assert_allclose([columns.mean(), rows.mean()], CAMERA.project(mirror_m[None])[0], atol=0.7)


def test_highlights_saturate_and_differ_between_the_eyes(profile: Profile) -> None:
    pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
    from svmdist.simulation.render import Renderer

    scene = make_scene(profile, 1, Extras(perturbations=parse_perturbations("wet=1,light=1,shadow=1")))
    away = scene.posture.copy()
    away[scene.chain.joint_names.index("insertion")] = 0.05
    with Renderer(scene, seed=1) as renderer:
        left, right = renderer.frame_of(away), renderer.right_frame()
    white = [(image.min(axis=2) > 200) for image in (left, right)]
    assert all(0.0005 < its.mean() < 0.02 for its in white)
    # The disparity of the organ's surface aside, they are other places of it.
    best = max((white[0] & np.roll(white[1], shift, axis=1)).sum() for shift in range(15, 40))
    assert best < 0.9 * white[0].sum()

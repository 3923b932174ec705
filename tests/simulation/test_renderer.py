"""What the renderer draws lies where the camera model says, in colours that HSV can tell apart."""

from __future__ import annotations

import subprocess
import sys

import cv2
import numpy as np
import pytest

from svmdist.errors import SimulationError
from svmdist.kinematics.inverse import solve_position
from svmdist.profile import ColourRegion, Profile
from svmdist.simulation.meshes import sphere
from svmdist.simulation.scene import Extras
from svmdist.simulation.scenarios import Scenario
from svmdist.simulation.scene import Scene, make_scene
from svmdist.transforms import inverse, make_transform, transform_points

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation import render as renderer_module
from svmdist.simulation.motion import make_trajectory
from svmdist.simulation.render import Renderer


def colour_mask(image_bgr: np.ndarray, region: ColourRegion) -> np.ndarray:
    hue, saturation, value = np.moveaxis(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2HSV), -1, 0)
    first, last = region.hue
    in_hue = (hue >= first) & (hue <= last) if first <= last else (hue >= first) | (hue <= last)
    (s0, s1), (v0, v1) = region.saturation, region.value
    return in_hue & (saturation >= s0) & (saturation <= s1) & (value >= v0) & (value <= v1)


def silhouette_centre_px(scene: Scene, centre_world_m: np.ndarray, radius_m: float) -> np.ndarray:
    """Centroid of a sphere's image: that of its contour, the circle where rays touch it."""
    c = transform_points(inverse(scene.T_world_camera), centre_world_m[None])[0]
    squared = c @ c
    normal = c / np.sqrt(squared)
    u = np.cross(normal, [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    angle = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)[:, None]
    circle = np.cos(angle) * u + np.sin(angle) * np.cross(normal, u)
    shrink = 1.0 - radius_m**2 / squared
    return scene.camera.project(c * shrink + radius_m * np.sqrt(shrink) * circle).mean(axis=0)


def test_projection_agrees_with_the_camera(scene: Scene) -> None:
    """Silhouettes of a sphere at 60 places: no offset above 0.05 px, no scatter above that of pixels."""
    radius_m, rng, errors = 0.00175, np.random.default_rng(0), []
    away = scene.posture.copy()
    away[scene.chain.joint_names.index("insertion")] = 0.02
    with Renderer(scene) as renderer:
        world = renderer.world
        ball = world.add_body(sphere(radius_m), "ball")
        renderer.frame_of(away)
        for _ in range(60):
            centre_m = rng.uniform([-0.045, -0.033, 0.02], [0.03, 0.033, 0.03])
            world.place(ball, make_transform(np.eye(3), centre_m))
            picture = world.client.call(
                "getCameraImage", 640, 480, renderer.view, renderer.projection, renderer=world.kind
            )
            rows, columns = np.nonzero(np.asarray(picture[4]).reshape(480, 640) == ball)
            errors.append([columns.mean(), rows.mean()] - silhouette_centre_px(scene, centre_m, radius_m))
    assert np.abs(np.mean(errors, axis=0)).max() < 0.05
    assert np.std(errors, axis=0).max() < 0.1


def test_colours_separate(scene: Scene, profile: Profile) -> None:
    """Tissue and distal marker are found whole and where they are; nothing is near the outline's green."""
    with Renderer(scene) as renderer:
        for p_world_m in ([0.04, 0.0, 0.0245], [0.03, -0.03, 0.02], [0.012, 0.0, 0.0245]):
            target_m = transform_points(inverse(scene.T_world_base), np.array([p_world_m]))
            q = solve_position(scene.chain, scene.posture[None], target_m, ("yaw", "pitch", "insertion"))[0]
            image = renderer.frame_of(q)
            marker = colour_mask(image, profile.segmentation.instrument)
            tissue = colour_mask(image, profile.segmentation.tissue)
            assert 280 < marker.sum() < 520
            rows, columns = np.nonzero(marker)
            expected_px = scene.camera.project(
                transform_points(inverse(scene.T_world_camera), np.array([p_world_m]))
            )[0]
            np.testing.assert_allclose([columns.mean(), rows.mean()], expected_px, atol=1.2)
            assert 38000 < tissue.sum() < 53000
            assert not colour_mask(
                image, ColourRegion(hue=(50, 70), saturation=(120, 255), min_area_px=1)
            ).any()


def test_tissue_centroid_is_the_projection_of_its_origin(scene: Scene, profile: Profile) -> None:
    """To 0.5 px where nothing hides it."""
    away = scene.posture.copy()
    away[scene.chain.joint_names.index("insertion")] = 0.02
    with Renderer(scene) as renderer:
        rows, columns = np.nonzero(colour_mask(renderer.frame_of(away), profile.segmentation.tissue))
    expected_px = scene.camera.project(scene.T_camera_tissue[:3, 3][None])[0]
    np.testing.assert_allclose([columns.mean(), rows.mean()], expected_px, atol=0.5)


def test_an_unknown_renderer_is_an_error_with_the_choices(scene: Scene) -> None:
    with pytest.raises(SimulationError, match="did you mean tiny"):
        Renderer(scene, "tinny")


def test_pybullet_leaves_standard_output_alone() -> None:
    """Its C code prints when it is imported, through a buffer that outlives the import."""
    code = "from svmdist.simulation.bullet import BulletClient\nwith BulletClient(): print('data')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "data\n"


def test_missing_pybullet_says_why_and_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    from svmdist.simulation.bullet import load_pybullet

    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(SimulationError, match=r"needs PyBullet: .*svmdist\[sim\]"):
        load_pybullet()


def test_what_is_drawn_apart_is_what_is_drawn_together(
    profile: Profile, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bit by bit: moving bodies before the tissue, against one picture of everything, also where they touch."""
    scene = make_scene(profile, 1, Extras(tag=True))
    trajectory = make_trajectory(scene, Scenario("contact", 1), 0.0245, np.linspace(0.4, 0.6, 3))
    apart, together = [], []
    for images, tie in ((apart, renderer_module.DEPTH_TIE), (together, 1.0)):
        monkeypatch.setattr(renderer_module, "DEPTH_TIE", tie)
        with Renderer(scene) as renderer:
            for q in trajectory.q:
                images += [renderer.frame_of(q), renderer.right_frame()]
            assert (renderer._whole is not None) == (tie == 1.0)
    np.testing.assert_array_equal(apart, together)


def test_images_do_not_depend_on_what_was_drawn_before(profile: Profile) -> None:
    """The same turns backwards, and some left out, with a retractor that comes and goes."""
    scene = make_scene(profile, 1)
    trajectory = make_trajectory(scene, Scenario("occlusion", 1), 0.0245, np.linspace(0.0, 0.2, 4))
    poses = trajectory.T_world_retractor
    assert poses is not None
    with Renderer(scene) as renderer:
        forth = [renderer.frame_of(q, T) for q, T in zip(trajectory.q, poses, strict=True)]
    with Renderer(scene) as renderer:
        for turn in (3, 1, 0, 2, 2):
            image = renderer.frame_of(trajectory.q[turn], poses[turn], turn=turn)
            np.testing.assert_array_equal(image, forth[turn])

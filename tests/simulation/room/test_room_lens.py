"""The lens: images bend as OpenCV's model says, and the calibration tells it, or does not."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.perturbations.chosen import parse_perturbations
from svmdist.profile import Profile
from svmdist.samples import CameraSample, ImageSample
from svmdist.simulation.meshes import sphere
from svmdist.simulation.scene import Extras
from svmdist.simulation.scenarios import Scenario
from svmdist.simulation.effects import Lens, coefficients
from svmdist.simulation.scene import Scene, make_scene
from svmdist.transforms import Array, make_transform, transform_points

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.render import Renderer
from svmdist.simulation.simulate import simulate


def scene_with(profile: Profile, perturbations: str) -> Scene:
    return make_scene(profile, 1, Extras(perturbations=parse_perturbations(perturbations)))


def contour_m(centre_m: Array, radius_m: float) -> Array:
    """Where rays from the camera touch a sphere, shape (720, 3), in the camera's frame."""
    squared = centre_m @ centre_m
    normal = centre_m / np.sqrt(squared)
    u = np.cross(normal, [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    angle = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)[:, None]
    circle = np.cos(angle) * u + np.sin(angle) * np.cross(normal, u)
    shrink = 1.0 - radius_m**2 / squared
    return np.asarray(centre_m * shrink + radius_m * np.sqrt(shrink) * circle)


@pytest.mark.parametrize("camera", [0, 1])
def test_balls_are_seen_where_opencv_projects_them(profile: Profile, camera: int) -> None:
    """All over the image, the corners among them, within 0.2 px of cv2.projectPoints; a pinhole is 25 px off."""
    scene = scene_with(profile, "lens=1")
    away = scene.posture.copy()
    away[scene.chain.joint_names.index("insertion")] = 0.02
    T_world_eye = scene.T_world_camera @ (np.eye(4), scene.T_camera_right)[camera]
    radius_m, K = 0.0014, scene.camera.K
    errors, bends = [], []
    with Renderer(scene) as renderer:
        ball = renderer.world.add_body(sphere(radius_m), "ball", (0.0, 1.0, 0.0, 1.0))
        for x_px, y_px in ((20, 20), (600, 25), (30, 440), (320, 240), (150, 300), (320, 30)):
            ray = [(x_px - K[0, 2]) / K[0, 0], (y_px - K[1, 2]) / K[1, 1], 1.0]
            centre_m = 0.09 * np.array(ray)
            renderer.world.place(
                ball, make_transform(np.eye(3), transform_points(T_world_eye, centre_m[None])[0])
            )
            image = renderer.frame_of(away)
            if camera:
                image = renderer.right_frame()
            blue, green, red = np.moveaxis(image.astype(int), -1, 0)
            rows, columns = np.nonzero((green > 70) & (green > 1.5 * np.maximum(blue, red)))
            points_m = contour_m(centre_m, radius_m)
            outline, pinhole = (
                cv2.projectPoints(points_m, np.zeros(3), np.zeros(3), K, D)[0][:, 0]
                for D in (scene.camera.D, np.zeros(5))
            )
            moments = cv2.moments(outline.astype(np.float32))
            expected = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
            errors.append(np.array([columns.mean(), rows.mean()]) - expected)
            bends.append(np.linalg.norm(pinhole.mean(0) - expected))
    assert np.abs(errors).max() < 0.2
    assert max(bends) > 25.0


def test_the_map_undoes_opencvs_distortion(profile: Profile) -> None:
    """Where a pixel looks in the pinhole image, distorted again, is the pixel: to 0.001 px, also at full strength."""
    camera = scene_with(profile, "lens=0.5").camera
    for strength in (0.3, 1.0, 2.5):
        lens = Lens.of(camera, coefficients(strength))
        seen_px = np.stack([lens.column_px, lens.row_px], -1)[::60, ::60].reshape(-1, 2).astype(np.float64)
        assert (seen_px >= 0).all()
        assert (seen_px <= [lens.wide.width_px - 1, lens.wide.height_px - 1]).all()
        rays = (seen_px - lens.wide.K[:2, 2]) / np.diag(lens.wide.K)[:2]
        back, _ = cv2.projectPoints(
            np.column_stack([rays, np.ones(len(rays))]),
            np.zeros(3),
            np.zeros(3),
            camera.K,
            coefficients(strength),
        )
        rows, columns = np.mgrid[: camera.height_px : 60, : camera.width_px : 60]
        np.testing.assert_allclose(back[:, 0], np.stack([columns, rows], -1).reshape(-1, 2), atol=1e-3)


def test_both_cameras_tell_the_lens_or_neither_does(profile: Profile) -> None:
    """Told and untold strengths show the same images; only the first stands in D, as plumb_bob has it."""
    seen = {}
    for told in ("lens=0.8", "lens_untold=0.8", "lens=0.5,lens_untold=0.3"):
        extras = Extras(stereo=True, perturbations=parse_perturbations(told))
        samples = [sample for _, sample in simulate(Scenario("sweep", 1, 0.2, 5.0), profile, extras=extras)]
        D = [sample.camera.D for sample in samples if isinstance(sample, CameraSample)]
        seen[told] = D, [sample.image_bgr for sample in samples if isinstance(sample, ImageSample)]
    (told_D, told), (untold_D, untold), (half_D, half) = seen.values()
    assert len(told_D) == len(told) == 2
    np.testing.assert_allclose(told_D, [[-0.16, 0.04, 0.0, 0.0, 0.0]] * 2)
    np.testing.assert_allclose(half_D, [[-0.1, 0.025, 0.0, 0.0, 0.0]] * 2)
    assert not np.any(untold_D)
    np.testing.assert_array_equal(told, untold)
    np.testing.assert_array_equal(told, half)

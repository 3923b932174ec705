"""Instruments that do not look as the profile says: bare, ringed, bloody, with jaws that open unseen."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.kinematics.inverse import solve_position
from svmdist.perturbations.chosen import parse_perturbations
from svmdist.profile import Profile
from svmdist.samples import Image, JointSample
from svmdist.simulation.extras import Extras
from svmdist.simulation.motion.scenarios import Scenario
from svmdist.simulation.scene import Scene, make_scene
from svmdist.transforms import inverse, transform_points
from svmdist.vision.colour import colour_mask
from svmdist.vision.frame_context import to_hsv

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.plan import make_plan
from svmdist.simulation.renderer import Renderer
from svmdist.simulation.simulate import Simulator

TOOL_WORLD_M = np.array([0.012, 0.0, 0.0245])


def drawn(profile: Profile, perturbations: str) -> tuple[Scene, np.ndarray, Image]:
    """A scene, joints with the tool beside the middle, and the picture of it."""
    scene = make_scene(profile, 1, Extras(perturbations=parse_perturbations(perturbations)))
    target_m = transform_points(inverse(scene.T_world_base), TOOL_WORLD_M[None])
    q = solve_position(scene.chain, scene.posture[None], target_m, ("yaw", "pitch", "insertion"))[0]
    with Renderer(scene, seed=1) as renderer:
        return scene, q, renderer.frame_of(q)


def coloured_px(image: Image) -> np.ndarray:
    """Columns and rows, shape (n, 2), of what is of the marker's colour, more than a fifth saturated."""
    hue, saturation, _ = np.moveaxis(to_hsv(image), -1, 0)
    rows, columns = np.nonzero((hue >= 80) & (hue <= 105) & (saturation > 51))
    return np.column_stack([columns, rows])


def test_a_bare_tip_shows_no_colour(profile: Profile) -> None:
    """Steel is grey, and every other pixel is as before."""
    _, _, ideal = drawn(profile, "tip=0")
    _, _, bare = drawn(profile, "tip=1")
    assert len(coloured_px(ideal)) > 300
    assert len(coloured_px(bare)) == 0
    changed = np.abs(ideal.astype(int) - bare).max(axis=2) > 0
    assert changed.sum() < 1.4 * len(coloured_px(ideal))


def test_a_ring_is_where_it_is_said(profile: Profile) -> None:
    """Its colour's middle is the projection of a point 3 mm behind the tool's origin, on the wrist's axis."""
    scene, q, image = drawn(profile, "ring=3")
    ring = coloured_px(image)
    assert 250 < len(ring) < 650
    T_world_wrist = scene.link_poses(q)["wrist_pitch"]
    middle_m = transform_points(inverse(scene.T_world_camera) @ T_world_wrist, [[-0.003, 0.0, 0.0]])
    np.testing.assert_allclose(ring.mean(axis=0), scene.camera.project(middle_m)[0], atol=1.5)
    origin_px = scene.camera.project(transform_points(inverse(scene.T_world_camera), TOOL_WORLD_M[None]))[0]
    assert np.linalg.norm(ring.mean(axis=0) - origin_px) > 10.0


@pytest.mark.parametrize(("name", "hues"), [("shaft_grey", None), ("shaft_blue", (100, 125))])
def test_shafts_have_their_colour(profile: Profile, name: str, hues: tuple[int, int] | None) -> None:
    scene, q, image = drawn(profile, f"{name}=1")
    on_axis_m = np.column_stack([np.zeros(5), np.linspace(0.012, 0.02, 5), np.zeros(5)])
    T_camera_roll = inverse(scene.T_world_camera) @ scene.link_poses(q)["roll"]
    columns, rows = np.rint(scene.camera.project(transform_points(T_camera_roll, on_axis_m))).astype(int).T
    hue, saturation, value = to_hsv(image)[rows, columns].T
    assert (value > 75).all()  # no longer what a threshold on darkness calls a shaft
    if hues is None:
        assert (saturation < 30).all()
    else:
        assert ((hue >= hues[0]) & (hue <= hues[1]) & (saturation > 100)).all()


def test_blood_covers_its_share_and_stays_on_the_tool(profile: Profile) -> None:
    """A quarter of the shaft's and the wrist's pixels are red; nothing beside the instrument changes."""
    _, _, clean = drawn(profile, "blood=0")
    scene, q, bloody = drawn(profile, "blood=0.25")
    with Renderer(scene) as renderer:
        renderer.world.pose(q, None, ())
        on_tool = renderer.world.picture(renderer.view, renderer.projection, 0).drawn
    changed = np.abs(clean.astype(int) - bloody).max(axis=2) > 25
    assert 0.12 < changed[on_tool].mean() < 0.4
    assert not changed[cv2.dilate(on_tool.view(np.uint8), np.ones((5, 5))) == 0].any()
    hue, saturation, _ = np.moveaxis(to_hsv(bloody), -1, 0)
    red = ((hue < 10) | (hue > 170)) & (saturation > 120)
    inside = cv2.erode(changed.view(np.uint8), np.ones((5, 5))) > 0
    assert inside.sum() > 100
    assert red[inside].mean() > 0.9


def test_jaws_open_and_nobody_tells(profile: Profile) -> None:
    """Joints are reported as without; the picture and the true joint show the opening, at most as large as stated."""
    scenario = Scenario("sweep", 1, 4.0, 1.0)
    plain, untold = (
        make_plan(scenario, profile, extras=Extras(perturbations=parse_perturbations(text)))
        for text in ("jaw=0", "jaw=30")
    )
    opening = untold.arms[0].q - plain.arms[0].q
    assert np.abs(opening[:, :-1]).max() < 1e-9
    assert opening[:, -1].min() >= 0.0
    assert np.deg2rad(25.0) < opening[:, -1].max() <= np.deg2rad(30.0) + 1e-12
    np.testing.assert_allclose(untold.arms[0].reported, plain.arms[0].reported, atol=1e-9)
    with Simulator(untold) as simulator:
        block = untold.blocks[2]
        said = [s for _, s in simulator.samples(block, (None,)) if isinstance(s, JointSample)]
    assert said[0].positions[-1] == pytest.approx(plain.arms[0].reported[block.begin, -1], abs=1e-9)


def test_the_ideal_tool_is_found_by_its_colours(profile: Profile) -> None:
    _, _, image = drawn(profile, "blood=0")
    assert (colour_mask(to_hsv(image), profile.segmentation.instrument) > 0).sum() > 280

"""Instruments that press on soft tissue: the truth of the clearance is that of the surface which images show."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from svmdist.geometry.surfaces import Mesh
from svmdist.perturbations.chosen import UNPERTURBED, parse_perturbations
from svmdist.profile import Profile
from svmdist.simulation.clearance.relief_meter import PartSamples, ReliefMeter
from svmdist.simulation.scene import Extras
from svmdist.simulation.scenarios import Scenario
from svmdist.simulation.effects import metric_depth_m
from svmdist.simulation.scene import Scene, risen
from svmdist.transforms import Array, transform_points

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.plan import Moment, Plan, make_plan
from svmdist.simulation.pressing import Pressing
from svmdist.simulation.render import Renderer
from svmdist.simulation.simulate import Simulator

CONTACT = Scenario("contact", 3, 8.0, 5.0)


def planned(profile: Profile, text: str, arms: int = 1) -> Plan:
    chosen = parse_perturbations(text) if text else UNPERTURBED
    return make_plan(CONTACT, profile, extras=Extras(arms=arms, tag=True, perturbations=chosen))


@pytest.fixture(scope="module")
def pressed(profile: Profile) -> Plan:
    return planned(profile, "dent=3")


def pressing_of(*scenes: Scene) -> Pressing:
    return Pressing([(scene, PartSamples(scene)) for scene in scenes])


def lowered(plan: Plan, q: Array, by_m: float) -> Array:
    """Joints with the instrument so much farther along its shaft."""
    q = q.copy()
    q[list(plan.scene.chain.joint_names).index("insertion")] += by_m
    return q


def independent_clearance_m(scene: Scene, surface: Mesh, q: Array) -> float:
    """The least signed distance of some 20,000 points on each part at the tip, by trimesh, in mm, which suit it."""
    count = len(scene.organ.outline_m)
    rim = len(surface.vertices_m) - count + np.arange(count)
    floor = [[len(surface.vertices_m), int(b), int(a)] for a, b in zip(rim, np.roll(rim, -1), strict=True)]
    vertices_m = transform_points(scene.T_world_tissue, np.vstack([surface.vertices_m, [0.0, 0.0, 0.0]]))
    body = trimesh.Trimesh(vertices_m * 1e3, [*surface.faces, *floor], process=False)
    assert body.is_watertight
    tree, from_above = cKDTree(body.vertices), cKDTree(body.vertices[:, :2])
    poses, found_mm = scene.link_poses(q), []
    for part in scene.parts:
        if part.name not in ("knuckle", "left_tine", "right_tine", "fixed_jaw", "moving_jaw"):
            continue
        mesh = trimesh.Trimesh(part.mesh.vertices_m, part.mesh.faces)
        samples = np.vstack([mesh.vertices, trimesh.sample.sample_surface(mesh, 20_000, seed=0)[0]])
        p_mm = transform_points(poses[part.link], samples) * 1e3
        # The nearest and the lowest by vertices of the mesh: no other point is the deepest.
        to_vertex_mm, _ = tree.query(p_mm)
        over_mm = p_mm[:, 2] - body.vertices[from_above.query(p_mm[:, :2])[1], 2]
        some = p_mm[np.union1d(np.argsort(to_vertex_mm)[:300], np.argsort(over_mm)[:300])]
        found_mm.append(-trimesh.proximity.signed_distance(body, some).max())
    return 1e-3 * min(found_mm)


@pytest.mark.parametrize("text", ["dent=3", "dent=2,tissue_shape=0.2,breathing=2"])
def test_truth_is_the_clearance_to_what_is_drawn(profile: Profile, text: str) -> None:
    """Before, in and after contact, within 0.02 mm of trimesh: to the surface as it is at that moment."""
    plan = planned(profile, text)
    scene, arm = plan.scene, plan.arms[0]
    pressing = pressing_of(scene)
    meter = ReliefMeter(scene)
    kinds = set()
    for index in (int(plan.blocks[frame].begin) for frame in (15, 17, 21, 24, 26)):
        moment = plan.moment(index)
        rise_m = np.array([moment.rise_m])
        at_rest_m = meter.clearances_m(arm.q[index][None], rise_m)
        truth_m = float(pressing.clearances_m([at_rest_m], [arm.q[index][None]], rise_m)[0][0])
        surface = pressing.tissue(moment)
        kinds.add(surface is None)
        mesh = scene.organ.mesh if surface is None else surface
        its = Mesh(transform_points(risen(moment.rise_m), mesh.vertices_m), mesh.faces)
        assert truth_m == pytest.approx(independent_clearance_m(scene, its, arm.q[index]), abs=2e-5)
        assert truth_m == pytest.approx(max(at_rest_m[0], 0.0), abs=1e-12)
    assert kinds == {True, False}


def test_truth_of_a_recording_is_continuous_over_contact(pressed: Plan) -> None:
    """It goes down to 0, stays there, and comes up again; no step is larger than the tool's own."""
    with Simulator(pressed) as simulator:
        q = pressed.arms[0].q
        at_rest_m = np.concatenate([simulator._meters[0].clearances_m(q)])
        truth_m = simulator._clearances_m([q], None).to_tissue_m[0]
    assert at_rest_m.min() == pytest.approx(-0.0032, abs=3e-4)
    touching = truth_m == 0.0
    assert 0.1 < touching.mean() < 0.6
    assert np.count_nonzero(np.diff(touching.astype(int))) == 2
    np.testing.assert_array_equal(truth_m, np.maximum(at_rest_m, 0.0))
    assert np.abs(np.diff(truth_m)).max() <= np.abs(np.diff(at_rest_m)).max()


def test_an_arm_that_does_not_press_is_measured_to_what_the_other_leaves(pressed: Plan) -> None:
    """It hovers over the dent, 0.3 mm above the tissue at rest: farther from what is there, as trimesh has it."""
    scene = pressed.scene
    pressing, meter = pressing_of(scene, scene), ReliefMeter(scene)
    q = pressed.moment(int(pressed.blocks[20].begin)).q[0]
    hovering = q
    for _ in range(6):
        hovering = lowered(pressed, hovering, meter.clearance_m(hovering) - 0.0003)
    at_rest_m = [meter.clearances_m(each[None]) for each in (q, hovering)]
    assert at_rest_m[1][0] == pytest.approx(0.0003, abs=2e-5)
    found = pressing.clearances_m(at_rest_m, [q[None], hovering[None]], None)
    surface = pressing.tissue(Moment((q, hovering), None, 0.0))
    assert surface is not None
    assert found[0][0] == 0.0
    assert found[1][0] > at_rest_m[1][0] + 0.001
    assert found[1][0] == pytest.approx(independent_clearance_m(scene, surface, hovering), abs=2e-5)


def test_where_the_tissue_gives_way_no_further_clearance_is_negative(pressed: Plan) -> None:
    """Farther in than four fifths of the organ's height: by trimesh, too."""
    scene = pressed.scene
    pressing, meter = pressing_of(scene), ReliefMeter(scene)
    q = lowered(pressed, pressed.moment(int(pressed.blocks[20].begin)).q[0], 0.0062)
    at_rest_m = meter.clearances_m(q[None])
    found_m = float(pressing.clearances_m([at_rest_m], [q[None]], None)[0][0])
    surface = pressing.tissue(Moment((q,), None, 0.0))
    assert surface is not None
    assert at_rest_m[0] < found_m < -1e-4
    assert found_m == pytest.approx(independent_clearance_m(scene, surface, q), abs=3e-5)


def test_images_show_the_dent_and_nothing_else(pressed: Plan) -> None:
    """Away from the instrument, what is drawn has the depths of the dented mesh; a mesh as at rest changes no bit."""
    scene, q = pressed.scene, pressed.moment(int(pressed.blocks[20].begin)).q[0]
    dented = pressing_of(scene).tissue(Moment((q,), None, 0.0))
    assert dented is not None
    away = scene.posture
    with Renderer(scene) as renderer:
        images = [
            renderer.frame_of(away, turn=0, tissue=tissue)
            for tissue in (None, dented, scene.organ.mesh, None)
        ]
        depths_m = []
        for tissue in (None, dented):
            renderer.frame_of(away, turn=0, tissue=tissue)
            depths_m.append(metric_depth_m(renderer._background(0, 0).depth))
    np.testing.assert_array_equal(images[0], images[2])
    np.testing.assert_array_equal(images[0], images[3])
    deeper_m = depths_m[1] - depths_m[0]
    down_m = scene.organ.mesh.vertices_m[:, 2] - dented.vertices_m[:, 2]
    assert deeper_m.min() > -1e-6
    assert deeper_m.max() == pytest.approx(down_m.max(), rel=0.03)
    changed = (images[0] != images[1]).any(axis=2)
    assert changed.sum() > 2000
    moved_m = transform_points(scene.T_camera_tissue, scene.organ.mesh.vertices_m[down_m > 0.0])
    rows, columns = np.nonzero(changed)
    to_moved_px = cKDTree(scene.camera.project(moved_m)).query(np.column_stack([columns, rows]))[0]
    assert to_moved_px.max() < 8.0

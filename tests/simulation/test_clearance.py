"""Clearances and paths against independent computations on the same meshes, by trimesh and SciPy."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from svmdist.geometry import Mesh
from svmdist.kinematics import forward_kinematics
from svmdist.perturbations import UNPERTURBED
from svmdist.profile import Profile
from svmdist.simulation.motion import SCENARIOS, Scenario, cubic_spline, plan_motion
from svmdist.simulation.scene import Options, Scene, make_scene, raised
from svmdist.transforms import Array, transform_points
from tests.simulation.conftest import perturbed, posed

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.clearance import InstrumentClearance, TissueClearance
from svmdist.simulation.motion import APART_M, make_other_arms, make_trajectory
from svmdist.simulation.plan import Plan, make_plan

TOLERANCE_M = 2e-5
WORKING_HEIGHT_M = 0.0245
TIP = ("knuckle", "left_tine", "right_tine", "fixed_jaw", "moving_jaw")


@lru_cache(maxsize=2)
def tissue_of(scene: Scene) -> TissueClearance:
    return TissueClearance([scene])


def clearance_m(scene: Scene, q: Array, offset_m: float = 0.0) -> float:
    return tissue_of(scene).clearances_m([q], offset_m)[0]


def independent_clearance_m(scene: Scene, q: Array, surface: Mesh | None = None) -> float:
    """The least signed distance of some 20,000 points on each part at the tip, by trimesh, in mm, which suit it."""
    mesh, count = surface or scene.organ.mesh, len(scene.organ.outline_m)
    rim = len(mesh.vertices_m) - count + np.arange(count)
    floor = [[len(mesh.vertices_m), int(b), int(a)] for a, b in zip(rim, np.roll(rim, -1), strict=True)]
    vertices_m = transform_points(scene.T_world_tissue, np.vstack([mesh.vertices_m, [0.0, 0.0, 0.0]]))
    body = trimesh.Trimesh(vertices_m * 1e3, [*mesh.faces, *floor], process=False)
    assert body.is_watertight
    tree, from_above = cKDTree(body.vertices), cKDTree(body.vertices[:, :2])
    found_mm = []
    for part, T_world_part in zip(scene.parts, scene.part_poses(q), strict=True):
        if part.name in TIP:
            shape = trimesh.Trimesh(part.mesh.vertices_m, part.mesh.faces)
            samples = np.vstack([shape.vertices, trimesh.sample.sample_surface(shape, 20_000, seed=0)[0]])
            p_mm = transform_points(T_world_part, samples) * 1e3
            over_mm = p_mm[:, 2] - body.vertices[from_above.query(p_mm[:, :2])[1], 2]
            nearest, lowest = np.argsort(tree.query(p_mm)[0])[:300], np.argsort(over_mm)[:300]
            some = p_mm[np.union1d(nearest, lowest)]
            found_mm.append(-trimesh.proximity.signed_distance(body, some).max())
    return 1e-3 * min(found_mm)


@pytest.mark.slow
@pytest.mark.parametrize("text", ["", "tissue_shape=0.4", "tissue_ellipsoid=1"])
def test_clearance_is_that_of_the_meshes(profile, text):
    """From 8 mm away to 0.5 mm deep, whatever the organ's shape: within 0.02 mm of trimesh."""
    scene, rng = make_scene(profile, 1, perturbed(text)), np.random.default_rng(2)
    for wanted_m in (0.008, 0.0005, 0.0001, -0.0002, -0.0005):
        wrist_rad, p_m = rng.uniform(-0.15, 0.15, 4), np.array([*rng.uniform(-0.006, 0.006, 2), 0.02])
        for _ in range(3):
            p_m[2] -= clearance_m(scene, posed(scene, p_m, wrist_rad)) - wanted_m
        q = posed(scene, p_m, wrist_rad)
        measured_m = clearance_m(scene, q)
        assert measured_m == pytest.approx(wanted_m, abs=0.0004)
        assert measured_m == pytest.approx(independent_clearance_m(scene, q), abs=TOLERANCE_M)


def test_raised_tissue_is_a_scene_built_there_and_the_plate_counts(profile):
    scene = make_scene(profile, 2)
    for x_m, offset_m in ((0.0, 0.0025), (0.012, -0.003), (0.03, 0.001)):
        q = posed(scene, [x_m, 0.002, 0.024])
        there = replace(scene, T_world_tissue=raised(offset_m) @ scene.T_world_tissue)
        assert clearance_m(scene, q, offset_m) == pytest.approx(clearance_m(there, q), abs=1e-12)
    hanging = profile.fiducial.model_copy(update={"position_m": (0.0, 0.0085, -0.012)})
    plated = make_scene(profile.model_copy(update={"fiducial": hanging}), 2, Options(tag=True))
    q = posed(scene, [-0.015, 0.0, WORKING_HEIGHT_M])
    assert clearance_m(plated, q) < clearance_m(scene, q) - 1e-3


@pytest.fixture(scope="module")
def pressed(profile: Profile) -> Plan:
    return make_plan(Scenario("contact", 3, 8.0, 5.0), profile, options=perturbed("dent=3", tag=True))


@pytest.mark.slow
def test_soft_tissue_touches_what_presses(pressed):
    """Over contact the truth goes down to 0, stays there and comes up again; before and in it, it is trimesh's."""
    scene, q = pressed.scene, pressed.arms[0].q
    rigid_scene = replace(scene, perturbations=UNPERTURBED)
    tissue, rigid = TissueClearance([scene]), TissueClearance([rigid_scene])
    frames = [block.start for block in pressed.blocks]
    truth_m, at_rest_m = (np.array([each.clearances_m([q[at]])[0] for at in frames]) for each in (tissue, rigid))
    assert at_rest_m.min() == pytest.approx(-0.0032, abs=3e-4)
    np.testing.assert_array_equal(truth_m, np.maximum(at_rest_m, 0.0))
    assert np.count_nonzero(np.diff((truth_m == 0.0).astype(int))) == 2
    for frame in (10, 21):
        organ = tissue.indented([q[frames[frame]]])
        assert (organ is None) == (frame == 10)
        expected_m = independent_clearance_m(scene, q[frames[frame]], organ.mesh if organ else None)
        assert truth_m[frame] == pytest.approx(expected_m, abs=TOLERANCE_M)


def test_beside_a_dent_and_too_deep(pressed):
    """An arm that hovers over what another presses in, and one that presses deeper than the tissue gives way."""
    scene, q = pressed.scene, pressed.state(pressed.blocks[20].start).q[0]
    insertion = list(scene.chain.joint_names).index("insertion")
    rigid, hovering = replace(scene, perturbations=UNPERTURBED), q.copy()
    for _ in range(6):
        hovering[insertion] += clearance_m(rigid, hovering) - 0.0003
    assert clearance_m(rigid, hovering) == pytest.approx(0.0003, abs=TOLERANCE_M)
    both = TissueClearance([scene, scene])
    organ, found_m = both.indented([q, hovering]), both.clearances_m([q, hovering])
    assert found_m[0] == 0.0
    assert found_m[1] > 0.0013
    assert found_m[1] == pytest.approx(independent_clearance_m(scene, hovering, organ.mesh), abs=TOLERANCE_M)
    deep = q.copy()
    deep[insertion] += 0.0062
    organ = TissueClearance([scene]).indented([deep])
    assert clearance_m(rigid, deep) < clearance_m(scene, deep) < -1e-4
    expected_m = independent_clearance_m(scene, deep, organ.mesh)
    assert clearance_m(scene, deep) == pytest.approx(expected_m, abs=3e-5)


@pytest.mark.parametrize("seed", range(3))
def test_scenarios_keep_their_clearances(seed, profile):
    """approach ends 2 mm from the tissue, contact touches by at most 0.5 mm, all others stay clear."""
    scene, progress = make_scene(profile, seed), np.linspace(0.0, 1.0, 61)
    for name in SCENARIOS:
        q, _ = make_trajectory(scene, Scenario(name, seed), progress)
        found_m = [clearance_m(scene, each) for each in q[::3]]
        beside = {3 * at + step for at in np.argsort(found_m)[:5] for step in (-1, 1)} & {*range(len(q))}
        smallest_m = min(*found_m, *(clearance_m(scene, q[at]) for at in beside))
        if name == "approach":
            assert smallest_m == pytest.approx(0.002, abs=1e-4)
        else:
            assert (-0.0005 < smallest_m <= 0.0) if name == "contact" else smallest_m > 0.0005, name


def test_contact_moves_with_the_tissue(profile):
    plan = make_plan(Scenario("contact", 1, 8.0, 1.0), profile, options=perturbed("breathing=3"))
    states = [plan.state(index) for index in range(0, len(plan.stamps_ns), 10)]
    assert -0.0005 < min(clearance_m(plan.scene, each.q[0], each.offset_m) for each in states) < 0.0


@pytest.mark.parametrize("name", SCENARIOS)
def test_motions_stay_in_their_boxes_and_are_smooth(name, profile):
    s, scene = np.linspace(0.0, 1.0, 1601), make_scene(profile, 1)
    boxes = {"sweep": [0.034, 0.024], "calibration": [0.0455, 0.0335]}
    for seed in range(6):
        p_m = plan_motion(Scenario(name, seed), s, scene).p_world_tool_m
        if name in boxes:
            assert np.abs(p_m[:, 2] - WORKING_HEIGHT_M).max() <= 0.002
            assert np.abs(p_m[:, :2]).max(axis=0) == pytest.approx(boxes[name], abs=2e-4)
        if name == "random":
            assert np.ptp(p_m, axis=0) == pytest.approx([0.040, 0.030, 0.020], abs=5e-4)
        # Half the step halves the change of velocity: the velocity is continuous.
        assert np.abs(np.diff(p_m, 2, axis=0)).max() < 0.6 * np.abs(np.diff(p_m[::2], 2, axis=0)).max()
    knots = np.random.default_rng(0).uniform(-1, 1, (7, 3))
    np.testing.assert_allclose(cubic_spline(knots, np.linspace(0, 1, 7)), knots, atol=1e-12)


@pytest.mark.parametrize("name", ["sweep", "contact", "random"])
def test_pictures_cross_and_bodies_keep_apart(name, profile):
    """The distal markers come within their own diameter in the image, the surfaces never touch, as trimesh has it."""
    seed = 7 + len(name)
    scene, progress = make_scene(profile, seed), np.linspace(0.0, 1.0, 61)
    q, _ = make_trajectory(scene, Scenario(name, seed), progress)
    ((_, other, q_other),) = make_other_arms(profile, scene, Options(arms=2), q, progress, 8.0)
    pixels = [
        view.camera.project((view.T_camera_base @ forward_kinematics(view.chain, at))[:, :3, 3])
        for view, at in ((scene, q), (other, q_other))
    ]
    assert np.linalg.norm(pixels[0] - pixels[1], axis=1).min() < 22.0
    assert np.all((pixels[1] > 0.0) & (pixels[1] < [640.0, 480.0]))
    with InstrumentClearance(scene, other) as between:
        found_m = [between.clearance_m(q[index], q_other[index]) for index in range(0, len(q), 4)]
    assert min(found_m) >= 0.9 * APART_M
    assert found_m[5] == pytest.approx(independent_between_m(scene, q[20], other, q_other[20]), abs=5e-5)


def independent_between_m(first: Scene, q_first: Array, second: Scene, q_second: Array) -> float:
    """The nearest pairs of parts by samples of both, then the nearest samples to the other's triangles."""

    def meshes_of(scene: Scene, q: Array) -> list[trimesh.Trimesh]:
        return [
            trimesh.Trimesh(transform_points(T, part.mesh.vertices_m), part.mesh.faces, process=False)
            for part, T in zip(scene.parts, scene.part_poses(q), strict=True)
        ]

    meshes = [meshes_of(first, q_first), meshes_of(second, q_second)]
    clouds = [
        [np.vstack([mesh.vertices, trimesh.sample.sample_surface(mesh, 4000, seed=0)[0]]) for mesh in each]
        for each in meshes
    ]
    trees = [cKDTree(cloud) for cloud in clouds[1]]
    pairs = [(i, j) for i in range(len(clouds[0])) for j in range(len(trees))]
    smallest = np.inf
    for i, j in sorted(pairs, key=lambda pair: trees[pair[1]].query(clouds[0][pair[0]][::9])[0].min())[:3]:
        near = clouds[0][i][np.argsort(trees[j].query(clouds[0][i])[0])[:100]]
        smallest = min(smallest, trimesh.proximity.closest_point(meshes[1][j], near)[1].min())
    return float(smallest)

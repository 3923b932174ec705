"""Tissue that moves, and tissue of other shapes: what is drawn, and a truth that is that of the built world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull, cKDTree

from svmdist.kinematics.inverse import solve_position
from svmdist.perturbations.chosen import parse_perturbations
from svmdist.profile import Profile
from svmdist.samples import DistanceSample, TransformsSample
from svmdist.simulation.extras import Extras
from svmdist.simulation.motion.scenarios import Scenario
from svmdist.simulation.scene import Scene, make_scene, risen
from svmdist.transforms import Array, inverse, polygon_centroid, transform_points
from svmdist.vision.colour import colour_mask
from svmdist.vision.frame_context import to_hsv

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.clearance.meters import ClearanceMeter
from svmdist.simulation.clearance.relief_meter import ReliefMeter
from svmdist.simulation.plan import Plan, make_plan
from svmdist.simulation.renderer import Renderer
from svmdist.simulation.simulate import simulate


def with_perturbations(text: str) -> Extras:
    return Extras(perturbations=parse_perturbations(text))


def joints_at(scene: Scene, wrist_rad: Array, p_world_m: Array) -> Array:
    q = scene.posture.copy()
    q[-4:] += wrist_rad
    target_m = transform_points(inverse(scene.T_world_base), p_world_m[None])
    return solve_position(scene.chain, q[None], target_m, ("yaw", "pitch", "insertion"))[0]


@pytest.fixture(scope="module")
def breathing(profile: Profile) -> list:
    extras = with_perturbations("breathing=2,pulse=0.3")
    return [sample for _, sample in simulate(Scenario("sweep", 1, 8.0, 0.5), profile, extras=extras)]


def test_the_truth_breathes_as_a_sine(breathing: list, profile: Profile) -> None:
    """2 mm at 0.25 Hz and 0.3 mm at 1.2 Hz along the camera's axis, no more, and nothing aside."""
    tissue = [
        (sample.stamp_ns, item.T_parent_child)
        for sample in breathing
        if isinstance(sample, TransformsSample)
        for item in sample.transforms
        if item.child == profile.frames.tissue
    ]
    t_s = np.array([stamp - tissue[0][0] for stamp, _ in tissue]) * 1e-9
    T = np.array([T for _, T in tissue])
    waves = [wave(2 * np.pi * hz * t_s) for hz in (0.25, 1.2) for wave in (np.sin, np.cos)]
    basis = np.column_stack([*waves, np.ones_like(t_s)])
    fitted = np.linalg.lstsq(basis, T[:, 2, 3], rcond=None)[0]
    assert np.abs(basis @ fitted - T[:, 2, 3]).max() < 1e-12
    assert np.hypot(*fitted[:2]) == pytest.approx(0.002, rel=1e-9)
    assert np.hypot(*fitted[2:4]) == pytest.approx(0.0003, rel=1e-9)
    assert fitted[4] == pytest.approx(0.112, abs=1e-12)
    assert np.ptp(T[:, :2, 3], axis=0).max() == 0.0
    assert np.ptp(T[:, :3, :3], axis=0).max() == 0.0


def test_distances_follow_the_moving_tissue(breathing: list, profile: Profile) -> None:
    transforms = {
        s.stamp_ns: {item.child: item.T_parent_child for item in s.transforms}
        for s in breathing
        if isinstance(s, TransformsSample) and profile.frames.tissue in {i.child for i in s.transforms}
    }
    distances = [sample for sample in breathing if isinstance(sample, DistanceSample)]
    assert len(distances) > 800
    for sample in distances:
        its = transforms[sample.stamp_ns]
        between_m = its[profile.frames.tool][:3, 3] - its[profile.frames.tissue][:3, 3]
        assert sample.spatial_m == pytest.approx(np.linalg.norm(between_m), abs=1e-15)


@pytest.mark.parametrize("shape", ["", ",tissue_shape=0.3"])
def test_clearance_to_risen_tissue_is_that_of_a_scene_built_there(profile: Profile, shape: str) -> None:
    """By Bullet for the convex organ, by the meshes' samples for the other."""
    scene = make_scene(profile, 2, with_perturbations("breathing=3" + shape))
    q = np.array([joints_at(scene, np.zeros(4), np.array([x, 0.002, 0.024])) for x in (0.0, 0.012, 0.03)])
    rise_m = np.array([0.0025, -0.003, 0.001])
    with ClearanceMeter(scene) as meter:
        moved = meter.clearances_m(q, rise_m)
    for joints, by_m, measured in zip(q, rise_m, moved, strict=True):
        there = replace(scene, T_world_tissue=risen(float(by_m)) @ scene.T_world_tissue)
        with ClearanceMeter(there) as meter:
            assert measured == pytest.approx(meter.clearance_m(joints), abs=2e-6)


def test_images_show_the_rise(profile: Profile) -> None:
    """The outline's area grows with the square of 1 / depth, and the next frame at rest is as before."""
    scene = make_scene(profile, 1, with_perturbations("breathing=5"))
    away = scene.posture.copy()
    away[scene.chain.joint_names.index("insertion")] = 0.02
    with Renderer(scene) as renderer:
        rest, up, again = (renderer.frame_of(away, rise_m=rise_m, turn=0) for rise_m in (0.0, 0.005, 0.0))
    np.testing.assert_array_equal(rest, again)
    areas = [(colour_mask(to_hsv(image), profile.segmentation.tissue) > 0).sum() for image in (rest, up)]
    assert areas[1] / areas[0] == pytest.approx((0.112 / 0.107) ** 2, rel=0.01)


def test_contact_goes_with_the_tissue(profile: Profile) -> None:
    """The touch is as deep as on tissue at rest, within what the shaft's turn about the trocar adds."""
    plan = make_plan(Scenario("contact", 1, 8.0, 1.0), profile, extras=with_perturbations("breathing=3"))
    lowest = lowest_clearance_m(plan)
    assert -0.0005 < lowest < 0.0


def lowest_clearance_m(plan: Plan) -> float:
    assert plan.tissue_rise_m is not None
    with ClearanceMeter(plan.scene) as meter:
        return float(meter.clearances_m(plan.arms[0].q[::10], plan.tissue_rise_m[::10]).min())


@pytest.fixture(scope="module")
def lobed(profile: Profile) -> Scene:
    return make_scene(profile, 1, with_perturbations("tissue_shape=0.4"))


@pytest.fixture(scope="module")
def body(lobed: Scene) -> trimesh.Trimesh:
    """The organ with a floor, so that it has an inside; in the world, in mm, which trimesh's tolerances suit."""
    mesh, count = lobed.organ.mesh, len(lobed.organ.outline_m)
    rim = len(mesh.vertices_m) - count + np.arange(count)
    floor = [[len(mesh.vertices_m), int(b), int(a)] for a, b in zip(rim, np.roll(rim, -1), strict=True)]
    vertices_m = transform_points(lobed.T_world_tissue, np.vstack([mesh.vertices_m, [0.0, 0.0, 0.0]]))
    closed = trimesh.Trimesh(vertices_m * 1e3, [*mesh.faces, *floor], process=False)
    assert closed.is_watertight
    return closed


@pytest.mark.parametrize("wanted_m", [0.004, 0.0002, -0.0002])
def test_clearance_to_lobes_is_that_of_the_meshes(
    lobed: Scene, body: trimesh.Trimesh, wanted_m: float
) -> None:
    """The least signed distance of 20,000 points on each of the nearest parts, by trimesh and SciPy: to 0.02 mm."""
    rng = np.random.default_rng(abs(round(wanted_m * 1e6)))
    wrist_rad, p_m = rng.uniform(-0.15, 0.15, 4), np.array([*rng.uniform(-0.01, 0.01, 2), 0.02])
    meter = ReliefMeter(lobed)
    for _ in range(4):
        p_m[2] -= meter.clearance_m(joints_at(lobed, wrist_rad, p_m)) - wanted_m
    q = joints_at(lobed, wrist_rad, p_m)
    with ClearanceMeter(lobed) as its_meter:
        measured_m = its_meter.clearance_m(q)
    assert measured_m == pytest.approx(wanted_m, abs=1e-4)
    tree, from_above = cKDTree(body.vertices), cKDTree(body.vertices[:, :2])
    poses, nearest = lobed.link_poses(q), []
    for part in lobed.parts:
        if part.name not in ("knuckle", "fixed_jaw", "moving_jaw"):
            continue
        mesh = trimesh.Trimesh(part.mesh.vertices_m, part.mesh.faces)
        samples = np.vstack([mesh.vertices, trimesh.sample.sample_surface(mesh, 20_000, seed=0)[0]])
        p_mm = transform_points(poses[part.link], samples) * 1e3
        height_mm = p_mm[:, 2] - body.vertices[from_above.query(p_mm[:, :2])[1], 2]
        some = p_mm[np.union1d(np.argsort(tree.query(p_mm)[0])[:100], np.argsort(height_mm)[:100])]
        nearest.append(-trimesh.proximity.signed_distance(body, some).max() * 1e-3)
    assert measured_m == pytest.approx(min(nearest), abs=2e-5)


@pytest.mark.parametrize("seed", range(4))
def test_lobes_change_outline_and_height_by_the_strength(profile: Profile, seed: int) -> None:
    """The origin stays the outline's centroid, the height a height, and nothing is higher than the dome."""
    dome = make_scene(profile, seed).organ
    organ = make_scene(profile, seed, with_perturbations("tissue_shape=0.4")).organ
    assert not organ.is_convex
    np.testing.assert_allclose(polygon_centroid(organ.outline_m), 0.0, atol=1e-12)
    assert organ.mesh.vertices_m[:, 2].max() == pytest.approx(dome.height_m, rel=1e-12)
    assert organ.mesh.vertices_m[:, 2].min() == pytest.approx(0.0, abs=1e-12)
    # Star-shaped about the apex: every face looks up, so that a place has one height.
    corners_m = organ.mesh.vertices_m[organ.mesh.faces][..., :2]
    (ax, ay), (bx, by) = (np.moveaxis(corners_m[:, k] - corners_m[:, 0], -1, 0) for k in (1, 2))
    assert (ax * by - ay * bx).min() > 0.0
    hull = ConvexHull(organ.mesh.vertices_m)
    depth_m = -np.array(
        [(hull.equations[:, :3] @ v + hull.equations[:, 3]).max() for v in organ.mesh.vertices_m]
    )
    assert 0.0005 < depth_m.max() < 0.005


def test_an_ellipsoid_is_one_and_stays_convex(profile: Profile) -> None:
    """Height over the plane is sqrt(1 - r²) of the apex's; Bullet and the meshes' samples agree on it."""
    scene = make_scene(profile, 1, with_perturbations("tissue_ellipsoid=1"))
    organ = scene.organ
    assert organ.is_convex
    rings = organ.mesh.vertices_m[1:].reshape(-1, len(organ.outline_m), 3)
    apex_m = organ.mesh.vertices_m[0]
    radius = np.linalg.norm(rings[..., :2] - apex_m[:2], axis=-1) / np.linalg.norm(
        rings[-1, :, :2] - apex_m[:2], axis=-1
    )
    np.testing.assert_allclose((rings[..., 2] / apex_m[2]) ** 2 + radius**2, 1.0, atol=1e-9)
    q = joints_at(scene, np.zeros(4), np.array([0.012, 0.002, 0.016]))
    with ClearanceMeter(scene) as meter:
        assert meter.clearance_m(q) == pytest.approx(ReliefMeter(scene).clearance_m(q), abs=1e-5)

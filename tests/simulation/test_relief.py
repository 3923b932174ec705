"""Tissue with relief: the surface, its picture, and the clearance to it against trimesh and Bullet."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from svmdist.errors import UsageError
from svmdist.kinematics.inverse import solve_position
from svmdist.profile import Profile
from svmdist.simulation.clearance.surface_tree import SurfaceTree
from svmdist.simulation.extras import Extras
from svmdist.simulation.scene import Scene, make_scene
from svmdist.transforms import Array, inverse, transform_points
from svmdist.vision.colour import colour_mask
from svmdist.vision.frame_context import to_hsv

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.clearance.meters import ClearanceMeter
from svmdist.simulation.clearance.relief_meter import OrganSurface, ReliefMeter
from svmdist.simulation.renderer import Renderer

RELIEF = Extras(relief_m=0.0005)


@pytest.fixture(scope="module")
def bumpy(profile: Profile) -> Scene:
    return make_scene(profile, 1, RELIEF)


@pytest.fixture(scope="module")
def meter(bumpy: Scene) -> ReliefMeter:
    return ReliefMeter(bumpy)


def joints_at(scene: Scene, wrist_rad: Array, p_world_m: Array) -> Array:
    q = scene.posture.copy()
    q[-4:] += wrist_rad
    target_m = transform_points(inverse(scene.T_world_base), p_world_m[None])
    return solve_position(scene.chain, q[None], target_m, ("yaw", "pitch", "insertion"))[0]


def lowered_to(
    scene: Scene, meter: ReliefMeter, wanted_m: float, xy_m: Array, wrist_rad: Array
) -> tuple[Array, Array]:
    """The tool's place in the world at which the clearance is about that, and the joints there."""
    p_m = np.array([*xy_m, 0.02])
    for _ in range(4):
        p_m[2] -= meter.clearance_m(joints_at(scene, wrist_rad, p_m)) - wanted_m
    return p_m, joints_at(scene, wrist_rad, p_m)


@pytest.fixture(scope="module")
def body(bumpy: Scene) -> trimesh.Trimesh:
    """The organ with a floor, so that it has an inside; in the world, in mm, which trimesh's tolerances suit."""
    mesh, count = bumpy.organ.mesh, len(bumpy.organ.outline_m)
    rim = len(mesh.vertices_m) - count + np.arange(count)
    floor = [[len(mesh.vertices_m), int(b), int(a)] for a, b in zip(rim, np.roll(rim, -1), strict=True)]
    vertices_m = transform_points(bumpy.T_world_tissue, np.vstack([mesh.vertices_m, [0.0, 0.0, 0.0]]))
    closed = trimesh.Trimesh(vertices_m * 1e3, [*mesh.faces, *floor], process=False)
    assert closed.is_watertight
    return closed


def independent_clearance_m(scene: Scene, body: trimesh.Trimesh, q: Array) -> float:
    """The least signed distance of some 20,000 points on each of the nearest parts, by trimesh and SciPy alone."""
    tree, from_above = cKDTree(body.vertices), cKDTree(body.vertices[:, :2])
    poses, nearest = scene.link_poses(q), []
    for part in scene.parts:
        if part.name not in ("knuckle", "fixed_jaw", "moving_jaw"):
            continue
        mesh = trimesh.Trimesh(part.mesh.vertices_m, part.mesh.faces)
        samples = np.vstack([mesh.vertices, trimesh.sample.sample_surface(mesh, 20_000, seed=0)[0]])
        p_mm = transform_points(poses[part.link], samples) * 1e3
        height_mm = p_mm[:, 2] - body.vertices[from_above.query(p_mm[:, :2])[1], 2]
        some = p_mm[np.union1d(np.argsort(tree.query(p_mm)[0])[:100], np.argsort(height_mm)[:100])]
        nearest.append(-trimesh.proximity.signed_distance(body, some).max() * 1e-3)
    return float(min(nearest))


@pytest.mark.parametrize("wanted_m", [0.003, 0.0001, -0.0002])
def test_clearance_to_relief_is_that_of_the_meshes(
    bumpy: Scene, meter: ReliefMeter, body: trimesh.Trimesh, wanted_m: float
) -> None:
    """From 3 mm away to 0.2 mm deep: within 0.02 mm of trimesh."""
    rng = np.random.default_rng(abs(round(wanted_m * 1e6)))
    _, q = lowered_to(bumpy, meter, wanted_m, rng.uniform(-0.012, 0.012, 2), rng.uniform(-0.15, 0.15, 4))
    measured_m = meter.clearance_m(q)
    assert measured_m == pytest.approx(wanted_m, abs=5e-5)
    assert measured_m == pytest.approx(independent_clearance_m(bumpy, body, q), abs=2e-5)


def test_clearance_goes_through_zero_without_a_jump(bumpy: Scene, meter: ReliefMeter) -> None:
    """In steps of 5 µm no clearance changes by more than the step; 3 % is for the tool, which turns a little."""
    wrist_rad = np.array([0.1, -0.05, 0.0, 0.1])
    p_m, _ = lowered_to(bumpy, meter, 6e-5, np.array([0.004, -0.003]), wrist_rad)
    clearances_m = np.array(
        [
            meter.clearance_m(joints_at(bumpy, wrist_rad, p_m - [0.0, 0.0, below_m]))
            for below_m in np.arange(0.0, 0.00013, 5e-6)
        ]
    )
    assert clearances_m[0] > 0.0 > clearances_m[-1]
    steps_m = -np.diff(clearances_m)
    assert steps_m.min() > 0.0
    assert steps_m.max() < 5.2e-6


def test_without_relief_it_agrees_with_bullet(scene: Scene) -> None:
    """On the convex organ both measure the same, from 10 mm away to 0.3 mm deep, to 0.01 mm."""
    own, rng = ReliefMeter(scene), np.random.default_rng(7)
    with ClearanceMeter(scene) as bullet:
        for wanted_m in (0.01, 0.001, -0.0003):
            xy_m, wrist_rad = rng.uniform(-0.012, 0.012, 2), rng.uniform(-0.15, 0.15, 4)
            _, q = lowered_to(scene, own, wanted_m, xy_m, wrist_rad)
            assert own.clearance_m(q) == pytest.approx(bullet.clearance_m(q), abs=1e-5)


def test_the_pose_before_is_but_a_hint(bumpy: Scene, meter: ReliefMeter) -> None:
    """A fresh meter and one that was elsewhere give the same number."""
    q = joints_at(bumpy, np.zeros(4), np.array([0.02, 0.0, 0.024]))
    fresh = ReliefMeter(bumpy).clearance_m(q)
    meter.clearance_m(joints_at(bumpy, np.zeros(4), np.array([-0.02, 0.01, 0.03])))
    assert meter.clearance_m(q) == pytest.approx(fresh, abs=1e-15)


def test_point_distances_are_those_of_trimesh(bumpy: Scene, body: trimesh.Trimesh) -> None:
    """On both sides of the surface, signs included."""
    rng = np.random.default_rng(3)
    at = bumpy.organ.mesh.vertices_m[rng.integers(0, 10_000, 150)]
    points_m = at + rng.normal(0.0, 0.001, at.shape)
    points_m[:, 2] = np.maximum(points_m[:, 2], 0.004)
    world_mm = transform_points(bumpy.T_world_tissue, points_m) * 1e3
    expected_m = -trimesh.proximity.signed_distance(body, world_mm) * 1e-3
    measured_m = OrganSurface(bumpy.organ.mesh).signed_distances_m(points_m)
    np.testing.assert_allclose(measured_m, expected_m, atol=1e-9)


def test_nodes_bound_what_lies_below(rng_items: Array) -> None:
    """Ball and disc hold every item, and no bound exceeds a distance."""
    tree = SurfaceTree(rng_items)
    points_m = np.random.default_rng(1).normal(0.0, 0.02, (20, 3))
    for level in tree.levels:
        below = tree.items_m.reshape(len(level.radii_m), -1, 3)
        for node in range(len(level.radii_m)):
            to_corner = np.linalg.norm(below[node][None] - points_m[:, None], axis=2).min(axis=1)
            least = level.least_m(points_m, np.full(len(points_m), node))
            assert (least <= to_corner + 1e-12).all()
            ball = np.linalg.norm(below[node] - level.points_m[node], axis=1).max()
            assert ball <= level.radii_m[node] + 1e-15
    for item in rng_items:
        assert (tree.items_m == item).all(axis=(1, 2)).any()


@pytest.fixture
def rng_items() -> Array:
    rng = np.random.default_rng(0)
    return rng.normal(0.0, 0.01, (70, 1, 3)) + rng.normal(0.0, 0.001, (70, 3, 3))


@pytest.mark.parametrize("seed", range(2))
def test_relief_keeps_the_outline_and_its_amplitude(profile: Profile, seed: int) -> None:
    """The largest height is the amplitude asked for, the outline is the smooth organ's, and all is seeded."""
    smooth, rough, again = (make_scene(profile, seed, extras).organ for extras in (Extras(), RELIEF, RELIEF))
    np.testing.assert_array_equal(rough.mesh.vertices_m, again.mesh.vertices_m)
    rim_m = rough.mesh.vertices_m[-len(rough.outline_m) :]
    np.testing.assert_allclose(rim_m[:, 2], 0.0, atol=1e-15)
    to_outline = cKDTree(smooth.outline_m).query(rim_m[:, :2])[0]
    assert to_outline.max() < 0.6e-3  # between corners of the smooth organ's outline
    assert np.linalg.norm(rough.mesh.vertices_m[0, :2] - smooth.mesh.vertices_m[0, :2]) < 1e-4
    # Straight above each other: the smooth height below every vertex, from the smooth mesh.
    dome = trimesh.Trimesh(smooth.mesh.vertices_m * 1e3, smooth.mesh.faces, process=False)
    inner = rough.mesh.vertices_m[: len(rough.mesh.vertices_m) * 3 // 4 : 25] * 1e3
    starts = np.column_stack([inner[:, :2], np.full(len(inner), 50.0)])
    hits, index, _ = dome.ray.intersects_location(starts, np.tile([0.0, 0.0, -1.0], (len(starts), 1)))
    bumps_mm = inner[index, 2] - hits[:, 2]
    assert 0.35 < np.abs(bumps_mm).max() < 0.52
    assert 0.1 < bumps_mm.std() < 0.3


def test_the_tissue_stays_within_its_colours(bumpy: Scene, scene: Scene, profile: Profile) -> None:
    """With relief, the mask of the profile is as whole as without, and there is more to see in it."""
    away = bumpy.posture
    masks, greys = [], []
    for each in (scene, bumpy):
        with Renderer(each) as renderer:
            image = renderer.frame_of(away)
        masks.append(colour_mask(to_hsv(image), profile.segmentation.tissue) > 0)
        greys.append(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float64))
    assert (masks[0] & ~masks[1]).sum() < 0.002 * masks[0].sum()
    inner = cv2.erode(masks[0].astype(np.uint8), np.ones((31, 31))) > 0
    details = [(grey - cv2.GaussianBlur(grey, (0, 0), 6.0))[inner].std() for grey in greys]
    assert details[1] > 2.0 * details[0]


def test_a_relief_out_of_range_is_told() -> None:
    with pytest.raises(UsageError, match=r"from 0 to 1\.5 mm, found 2 mm"):
        Extras(relief_m=0.002)
    assert Extras(relief_m=0.0005).metadata() == {"relief_m": "0.0005"}

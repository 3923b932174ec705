"""Clearance against an independent computation on the same meshes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull, cKDTree

from svmdist.kinematics.inverse import solve_position
from svmdist.profile import Profile
from svmdist.simulation.scene import Scene, make_scene
from svmdist.transforms import inverse, transform_points

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.clearance import ClearanceMeter

TOLERANCE_M = 2e-5


def outside_m(p_m: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """How far points, shape (n, 3), are outside of a hull's planes, shape (k, 4): the largest distance, shape (n,).

    Some points at a time: all of an organ's with all of its planes fill a gigabyte.
    """
    blocks = np.array_split(p_m, len(p_m) // 16 + 1)
    return np.concatenate([(block @ planes[:, :3].T + planes[:, 3]).max(axis=1) for block in blocks])


def independent_clearance_m(scene: Scene, q: np.ndarray) -> float:
    """Clearance from the parts' vertices and dense samples, part by part, without Bullet.

    Outside, trimesh finds the triangle of the organ that is closest to the most promising points. Inside,
    the depth is the shortest translation along a normal of the organ's hull that frees the whole part.
    """
    organ_m = transform_points(scene.T_world_tissue, scene.organ.mesh.vertices_m)
    organ = trimesh.Trimesh(organ_m, scene.organ.mesh.faces, process=False)
    planes = ConvexHull(organ_m).equations
    poses = scene.link_poses(q)
    nearest = []
    for part in scene.parts:
        mesh = trimesh.Trimesh(part.mesh.vertices_m, part.mesh.faces)
        samples = np.vstack([mesh.vertices, trimesh.sample.sample_surface(mesh, 4000, seed=0)[0]])
        p = transform_points(poses[part.link], samples)
        p = p[np.argsort(cKDTree(organ_m).query(p)[0])[:1000]]
        far_m = outside_m(p, planes)
        if far_m.min() < 0.0:
            p = transform_points(poses[part.link], mesh.vertices)
            blocks = np.array_split(planes, len(planes) // 16 + 1)
            nearest.append(max((p @ block[:, :3].T + block[:, 3]).min(axis=0).max() for block in blocks))
        else:
            p = p[np.argsort(far_m)[:40]]
            nearest.append(trimesh.proximity.closest_point(organ, p)[1].min())
    return float(min(nearest))


def test_organ_and_parts_are_convex(scene: Scene) -> None:
    """Bullet measures convex hulls: every vertex lies on its hull to 5 µm, the bridge's to 0.1 mm."""
    meshes = {part.name: part.mesh for part in scene.parts} | {"organ": scene.organ.mesh}
    for name, mesh in meshes.items():
        hull = ConvexHull(mesh.vertices_m)
        depth = -outside_m(mesh.vertices_m, hull.equations)
        assert depth.max() < (1e-4 if name == "bridge" else 5e-6), name


def joints_at(scene: Scene, wrist_rad: np.ndarray, p_world_m: np.ndarray) -> np.ndarray:
    q = scene.posture.copy()
    q[-4:] += wrist_rad
    target_m = transform_points(inverse(scene.T_world_base), p_world_m[None])
    return solve_position(scene.chain, q[None], target_m, ("yaw", "pitch", "insertion"))[0]


def test_clearance_is_that_of_the_meshes(scene: Scene) -> None:
    """From 8 mm away to 0.5 mm deep: within 0.02 mm of the independent computation."""
    rng = np.random.default_rng(2)
    with ClearanceMeter(scene) as meter:
        for wanted_m in (0.008, 0.002, 0.0005, 0.0001, -0.0002, -0.0005):
            wrist_rad = rng.uniform(-0.15, 0.15, 4)
            p_m = np.array([*rng.uniform(-0.006, 0.006, 2), 0.02])
            p_m[2] -= meter.clearance_m(joints_at(scene, wrist_rad, p_m)) - wanted_m
            q = joints_at(scene, wrist_rad, p_m)
            measured_m = meter.clearance_m(q)
            assert measured_m == pytest.approx(wanted_m, abs=0.0004)
            assert measured_m == pytest.approx(independent_clearance_m(scene, q), abs=TOLERANCE_M)


@pytest.mark.parametrize("seed", range(8))
def test_every_seed_makes_a_convex_organ(seed: int, profile: Profile) -> None:
    mesh = make_scene(profile, seed).organ.mesh
    hull = ConvexHull(mesh.vertices_m)
    depth = -outside_m(mesh.vertices_m, hull.equations)
    assert depth.max() < 5e-6

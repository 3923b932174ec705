"""Bounds of clearances are never above them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from svmdist.profile import Profile
from svmdist.simulation.bodies.meshes import bar, sphere
from svmdist.simulation.clearance.bounds import HalfSpaces, PartBounds
from svmdist.simulation.scene import Scene, make_scene
from svmdist.transforms import Array, make_transform, rotation_x, rotation_z, transform_points


def poses(count: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    R = np.stack([rotation_x(a) @ rotation_z(b) for a, b in rng.uniform(-3.0, 3.0, (count, 2))])
    return make_transform(R, rng.uniform(-0.03, 0.03, (count, 3)))


def test_no_vertex_is_lower_than_the_bound_says() -> None:
    """Along some direction all vertices stand off the half-spaces; the bound is the greatest such height or less."""
    body = HalfSpaces.about(sphere(0.02).vertices_m)
    mesh = bar((-0.005, 0.02), 0.002, 0.001)
    bounds = PartBounds.of([("link", mesh)])
    for T in poses(50, 1):
        least_m = bounds.least_m(T[None, None], body)[0, 0]
        heights_m = transform_points(T, mesh.vertices_m) @ body.normals.T - body.offsets_m
        assert least_m <= heights_m.min(0).max() + 1e-15
        # No two points are nearer: the sphere is what the half-spaces hold, and 0.2 mm less at most.
        assert least_m <= (np.linalg.norm(transform_points(T, mesh.vertices_m), axis=1) - 0.02).min() + 1e-15


def test_capsules_about_parts_hold_their_vertices() -> None:
    """Two parts' bound is at most the distance of their surfaces' samples, and within their thickness of it."""
    first, other = bar((-0.005, 0.02), 0.002, 0.001), sphere(0.003)
    bounds = PartBounds.of([("a", first), ("b", other)])
    samples = [
        trimesh.sample.sample_surface(trimesh.Trimesh(mesh.vertices_m, mesh.faces), 1500, seed=0)[0]
        for mesh in (first, other)
    ]
    for T, T_other in zip(poses(40, 2), poses(40, 3), strict=True):
        both, both_other = np.stack([T, T])[None], np.stack([T_other, T_other])[None]
        least_m = bounds.least_between_m(both, bounds, both_other)[0, 0, 1]
        points, others = transform_points(T, samples[0]), transform_points(T_other, samples[1])
        apart_m = np.linalg.norm(points[:, None] - others[None, ::4], axis=-1).min()
        assert least_m <= apart_m
        assert apart_m - least_m < 0.004


def test_one_pose_and_many_have_the_same_clearances(scene: Scene, profile: Profile) -> None:
    """The nearest part is found with bounds of one pose as with those of many: bit by bit."""
    pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
    from svmdist.simulation.clearance.meters import BetweenMeter, ClearanceMeter

    q = scene.posture + np.random.default_rng(5).uniform(-0.02, 0.02, (12, len(scene.posture)))
    with ClearanceMeter(scene) as meter:
        assert meter.clearances_m(q).tolist() == [meter.clearance_m(each) for each in q]
    with BetweenMeter(scene, make_scene(profile, 4)) as between:
        together = between.clearances_m(q, q[::-1])
        assert together.tolist() == [between.clearance_m(a, b) for a, b in zip(q, q[::-1], strict=True)]

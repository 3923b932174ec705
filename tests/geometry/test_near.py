"""Pruning leaves little, and always what is nearest."""

from __future__ import annotations

import numpy as np
import trimesh

from svmdist.geometry.closest import (
    point_to_segment,
    point_to_triangle,
    segment_to_segment,
    segment_to_triangle,
)
from svmdist.geometry.near import ROUGH_M, distances_to_axes, near_faces, near_pairs, nearest_on_mesh
from svmdist.geometry.surfaces import Capsules, Mesh

RNG = np.random.default_rng(21)


def capsules_at(height_m: float, count: int = 24) -> Capsules:
    start = RNG.normal([0.0, 0.0, height_m], 0.004, (count, 3))
    return Capsules(start, start + RNG.normal(0.0, 0.01, (count, 3)), RNG.uniform(0.0003, 0.004, count))


def dome() -> Mesh:
    """5,120 faces, 60 mm across, 10 mm high."""
    solid = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    solid.apply_scale([0.03, 0.03, 0.01])
    return Mesh(np.asarray(solid.vertices, np.float64), np.asarray(solid.faces, np.int64))


def test_rough_distances_are_right_within_what_they_say() -> None:
    for scale in (0.01, 1.0):
        capsules, points = capsules_at(0.0), scale * RNG.normal(size=(500, 3))
        exact = point_to_segment(points[None], capsules.start_m[:, None], capsules.end_m[:, None]).distance
        np.testing.assert_allclose(distances_to_axes(points, capsules), exact, atol=ROUGH_M, rtol=0)


def test_few_faces_are_left_and_the_nearest_is_one_of_them() -> None:
    """Of 24 x 5,120 pairs less than one in 500 is left, from 2 to 60 mm away."""
    mesh = dome()
    for height_m in (0.032, 0.05, 0.09):
        capsules = capsules_at(height_m)
        every = segment_to_triangle(
            capsules.start_m[:, None], capsules.end_m[:, None], mesh.triangles_m[None]
        ).distance
        expected = (every - capsules.radius_m[:, None]).min()
        capsule, corners = near_faces(capsules, mesh)
        left = segment_to_triangle(capsules.start_m[capsule], capsules.end_m[capsule], corners).distance
        assert (left - capsules.radius_m[capsule]).min() == expected
        assert len(capsule) < every.size / 500


def test_pierced_faces_are_left_of_every_capsule() -> None:
    """A capsule that goes through the surface far from the nearest place may be the deepest: its faces stay."""
    mesh = dome()
    ends = np.array([[0.0, 0.0, 0.02], [0.02, 0.0, 0.02], [-0.02, 0.001, 0.02]])
    capsules = Capsules(ends, ends * [1.0, 1.0, -1.0], np.array([0.004, 0.0003, 0.0003]))
    capsule, corners = near_faces(capsules, mesh)
    pierced = segment_to_triangle(capsules.start_m[capsule], capsules.end_m[capsule], corners).distance == 0.0
    assert np.bincount(capsule[pierced], minlength=3).min() >= 2


def test_few_pairs_of_capsules_are_left_and_the_nearest_is_one_of_them() -> None:
    first, other = capsules_at(0.0), capsules_at(0.05)
    every = segment_to_segment(
        first.start_m[:, None], first.end_m[:, None], other.start_m[None], other.end_m[None]
    ).distance
    gap = every - first.radius_m[:, None] - other.radius_m[None]
    i, j = near_pairs(first, other)
    assert gap[i, j].min() == gap.min()
    assert len(i) < gap.size / 3


def test_nearest_points_are_those_of_all_triangles() -> None:
    mesh = dome()
    points = RNG.normal([0.01, 0.0, 0.006], 0.002, (20, 3))
    every = point_to_triangle(points[:, None], mesh.triangles_m[None]).distance
    nearest, distance = nearest_on_mesh(points, mesh)
    np.testing.assert_array_equal(distance, every.min(1))
    np.testing.assert_allclose(np.linalg.norm(nearest - points, axis=1), distance, atol=1e-15)

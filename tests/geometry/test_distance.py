"""Separations against SciPy, trimesh and every pair in turn; inside and outside of meshes."""

import numpy as np
import pytest
import trimesh
from scipy.optimize import minimize

from svmdist.geometry import Capsules, Cloud, Mesh, Plane, join
from svmdist.geometry.distance import (
    Separation,
    capsule_separation,
    point_to_triangle,
    segment_to_segment,
    segment_to_triangle,
    separation,
    signed_distances,
)
from svmdist.transforms import Array

EXACT = 1e-9


def capsule(start: list[float], end: list[float], radius: float) -> Capsules:
    return Capsules(np.array([start]), np.array([end]), np.array([radius]))


def random_capsules(rng: np.random.Generator, count: int) -> Capsules:
    return Capsules(rng.normal(0, 1, (count, 3)), rng.normal(0, 1, (count, 3)), rng.uniform(0.01, 0.2, count))


def mesh_of(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(solid.vertices, np.float64), np.asarray(solid.faces, np.int64))


def icosphere(radius: float = 1.0) -> Mesh:
    return mesh_of(trimesh.creation.icosphere(subdivisions=3, radius=radius))


def box(size: list[float]) -> Mesh:
    return mesh_of(trimesh.creation.box(size))


def assert_consistent(found: Separation) -> None:
    assert np.linalg.norm(found.direction) == pytest.approx(1.0, abs=EXACT)
    np.testing.assert_allclose(
        found.on_tissue_m, found.on_instrument_m + found.distance_m * found.direction, atol=EXACT
    )


def test_segments_agree_with_constrained_minimisation():
    rng = np.random.default_rng(1)
    for _ in range(40):
        a0, a1, b0, b1 = rng.normal(0, 1, (4, 3))

        def distance2(x: Array, a0: Array = a0, a1: Array = a1, b0: Array = b0, b1: Array = b1) -> float:
            return float(np.sum((a0 + x[0] * (a1 - a0) - b0 - x[1] * (b1 - b0)) ** 2))

        best = min(
            minimize(distance2, [s, t], bounds=[(0, 1), (0, 1)], tol=1e-16).fun
            for s in (0, 0.5, 1)
            for t in (0, 0.5, 1)
        )
        assert float(segment_to_segment(a0, a1, b0, b1).distance) == pytest.approx(np.sqrt(best), abs=1e-6)


def test_parallel_crossing_and_pointlike_segments_are_exact():
    x, y, z = np.eye(3)
    assert segment_to_segment(0 * x, x, y, x + y).distance == pytest.approx(1.0, abs=EXACT)
    assert segment_to_segment(0 * x, x, 2 * x + y, 3 * x + y).distance == pytest.approx(np.sqrt(2), abs=EXACT)
    assert segment_to_segment(-x, x, -y, y).distance == pytest.approx(0.0, abs=EXACT)
    assert segment_to_segment(x, x, 2 * z, 2 * z).distance == pytest.approx(np.sqrt(5), abs=EXACT)


def test_segment_to_triangle_agrees_with_densely_sampled_trimesh():
    rng = np.random.default_rng(2)
    for _ in range(30):
        start, end, *corners = rng.normal(0, 1, (5, 3))
        triangle = np.array(corners)
        along = np.linspace(0, 1, 4001)[:, None]
        points = start + along * (end - start)
        nearest = trimesh.triangles.closest_point(np.repeat(triangle[None], len(points), 0), points)
        sampled = np.linalg.norm(nearest - points, axis=1).min()
        exact = float(segment_to_triangle(start, end, triangle).distance)
        # A sample lies within half a step of the closest point.
        assert exact <= sampled + EXACT
        assert sampled - exact <= np.linalg.norm(end - start) / 8000 + EXACT


def test_depth_in_a_box_is_that_of_the_tip_or_the_deepest_point():
    """Of a needle that ends in it, of an axis that runs through it."""
    needle = capsule([0.1, 0.2, 0.4], [0.1, 0.2, 3.0], 0.01)
    found = separation(needle, box([2, 2, 1.4]))  # its top is at z = 0.7
    assert found.distance_m == pytest.approx(-0.31, abs=EXACT)
    np.testing.assert_allclose(found.direction, [0, 0, -1], atol=1e-6)
    assert_consistent(found)
    through = capsule([-3, 0.0, 0.2], [3, 0.0, 0.2], 0.05)
    assert separation(through, box([2, 2, 1])).distance_m == pytest.approx(-0.35, abs=EXACT)


@pytest.mark.parametrize("surface", [box([2, 2, 1.4]), Plane(np.array([0.0, 0, 1]), 0.7)])
def test_distance_passes_zero_without_a_jump_at_slope_minus_one(surface):
    heights = np.linspace(0.9, 0.5, 81)
    gaps = [separation(capsule([0.1, 0.0, h], [0.4, 0.0, h + 1], 0.05), surface).distance_m for h in heights]
    np.testing.assert_allclose(gaps, heights - 0.75, atol=EXACT)


def test_capsules_that_cross():
    a = join(capsule([0, 0, 0], [1, 0, 0], 0.1), capsule([0, 5, 0], [1, 5, 0], 0.1))
    crossing = capsule_separation(a, capsule([0.5, -1, 0], [0.5, 1, 0], 0.2))
    assert crossing.distance_m == pytest.approx(-0.3, abs=EXACT)
    assert abs(crossing.direction[2]) == pytest.approx(1.0, abs=EXACT)


def test_direction_is_the_gradient_outside_and_inside():
    mesh = icosphere()
    for height in (1.3, 0.9):
        tool = capsule([0.02, 0.05, height], [0.3, 0.1, height + 2], 0.05)
        found = separation(tool, mesh)
        gradient = []
        for step in np.eye(3) * 1e-6:
            ahead = separation(Capsules(tool.start_m + step, tool.end_m + step, tool.radius_m), mesh)
            gradient.append((ahead.distance_m - found.distance_m) / 1e-6)
        np.testing.assert_allclose(gradient, -found.direction, atol=1e-3)


def test_beside_a_concave_mesh_pruning_leaves_the_nearest_face():
    """Capsules about a torus, through its hole, and beside it: as every capsule against every triangle in turn."""
    rng, mesh, outside = np.random.default_rng(12), mesh_of(trimesh.creation.torus(0.6, 0.25, 48, 24)), 0
    for _ in range(60):
        starts = rng.uniform(-1.0, 1.0, (6, 3)) * rng.choice([0.15, 1.5])
        capsules = Capsules(starts, starts + rng.normal(0.0, 0.15, (6, 3)), rng.uniform(0.01, 0.05, 6))
        every = segment_to_triangle(capsules.start_m[:, None], capsules.end_m[:, None], mesh.triangles_m[None]).distance
        inside = signed_distances(np.vstack([capsules.start_m, capsules.end_m]), mesh)[1] < 0.0
        if inside.any() or every.min() < EXACT:
            assert separation(capsules, mesh).distance_m < 0.0
            continue
        outside += 1
        found = separation(capsules, mesh)
        assert found.distance_m == pytest.approx((every - capsules.radius_m[:, None]).min(), abs=EXACT)
        assert_consistent(found)
    assert outside > 20


def test_many_capsules_against_many_agree_with_every_pair_in_turn():
    rng = np.random.default_rng(13)
    for spread in (0.3, 3.0):
        a, b = (random_capsules(rng, 12) for _ in range(2))
        b = Capsules(b.start_m * 0.1 + spread, b.end_m * 0.1 + spread, b.radius_m)
        every = segment_to_segment(a.start_m[:, None], a.end_m[:, None], b.start_m[None], b.end_m[None]).distance
        found = capsule_separation(a, b)
        expected = (every - a.radius_m[:, None] - b.radius_m[None]).min()
        assert found.distance_m == pytest.approx(expected, abs=EXACT)
        assert_consistent(found)
        back = capsule_separation(b, a)
        assert back.distance_m == pytest.approx(found.distance_m, abs=EXACT)
        np.testing.assert_allclose(-back.direction, found.direction, atol=1e-7)
        np.testing.assert_allclose(back.on_tissue_m, found.on_instrument_m, atol=1e-7)


def test_the_nearest_point_of_a_large_cloud_is_found():
    rng = np.random.default_rng(14)
    points, capsules = rng.uniform(-0.05, 0.05, (3000, 3)), random_capsules(rng, 8)
    points += np.array([0.0, 0.0, 0.13])
    capsules = Capsules(0.02 * capsules.start_m, 0.02 * capsules.end_m, 0.01 * capsules.radius_m)
    along = np.linspace(0.0, 1.0, 2001)[:, None, None]
    axes = capsules.start_m + along * (capsules.end_m - capsules.start_m)
    sampled = min(
        float((np.linalg.norm(axes - point, axis=-1) - capsules.radius_m).min())
        for point in points[np.argsort(points[:, 2])[:300]]
    )
    found = separation(capsules, Cloud(points, np.zeros(len(points))))
    assert found.distance_m <= sampled + EXACT
    assert sampled - found.distance_m < 1e-8  # (0.1 / 4000)² / 2 / 0.05
    assert_consistent(found)
    with pytest.raises(ValueError, match="without points"):
        separation(capsules, Cloud(np.zeros((0, 3)), np.zeros(0)))


def winding_number(points: Array, triangles: Array) -> Array:
    """Signed solid angles over 4π (van Oosterom and Strackee 1983): 1 inside, 0 outside."""
    a, b, c = np.moveaxis(triangles[None] - points[:, None, None, :], 2, 0)
    la, lb, lc = (np.linalg.norm(each, axis=-1) for each in (a, b, c))
    below = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    above = (a * np.cross(b, c)).sum(-1)
    return np.asarray(np.arctan2(above, below).sum(-1) / (2.0 * np.pi))


def hollow_sphere() -> trimesh.Trimesh:
    outer, inner = (trimesh.creation.icosphere(2, radius) for radius in (1.0, 0.5))
    inner.invert()
    return trimesh.util.concatenate([outer, inner])


@pytest.mark.parametrize(
    "solid",
    [
        trimesh.creation.torus(0.6, 0.25, 48, 24),
        trimesh.creation.box([2, 2, 2]),
        trimesh.creation.cone(0.5, 1.0),
        hollow_sphere(),
    ],
    ids=["torus", "box", "cone", "hollow"],
)
def test_inside_is_where_a_mesh_winds_around(solid):
    """At random points, and a micrometre about corners and edges, where many faces share the nearest point."""
    rng = np.random.default_rng(3)
    corners = solid.vertices[rng.integers(0, len(solid.vertices), 100)]
    edges = solid.vertices[solid.edges_unique[rng.integers(0, len(solid.edges_unique), 100)]].mean(1)
    beside = [corners + rng.normal(0, 1e-6, corners.shape), edges + rng.normal(0, 1e-6, edges.shape)]
    points = np.vstack([rng.uniform(-1.1, 1.1, (300, 3)), *beside])
    mesh = mesh_of(solid)
    nearest, distance = signed_distances(points, mesh)
    every = point_to_triangle(points[:, None], mesh.triangles_m[None]).distance
    np.testing.assert_array_equal(np.abs(distance), every.min(1))
    np.testing.assert_allclose(np.linalg.norm(points - nearest, axis=1), np.abs(distance), atol=EXACT)
    np.testing.assert_array_equal(distance < 0.0, winding_number(points, mesh.triangles_m) > 0.5)

"""Inside and outside of meshes: the crossings of rays tell the same as the winding number."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from svmdist.geometry.inside import contains, winding_number
from svmdist.geometry.surfaces import Mesh


def mesh_of(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(solid.vertices, np.float64), np.asarray(solid.faces, np.int64))


TORUS = mesh_of(trimesh.creation.torus(0.03, 0.01, 48, 24))
BOX = mesh_of(trimesh.creation.box([2, 2, 2]))


def test_winding_number_tells_inside_from_outside() -> None:
    points = np.array([[0.0, 0, 0], [0.9, -0.9, 0.9], [1.1, 0, 0], [5, 5, 5]])
    np.testing.assert_allclose(winding_number(points, BOX.triangles_m), [1, 1, 0, 0], atol=1e-9)


def test_rays_agree_with_the_winding_number_in_and_about_a_torus() -> None:
    """A torus is no hull: its middle is outside. Points lie on both sides, some within 1 µm of the surface."""
    rng = np.random.default_rng(3)
    anywhere = rng.uniform(-1.0, 1.0, (600, 3)) * [0.042, 0.042, 0.012]
    corners = TORUS.vertices_m[rng.integers(0, len(TORUS.vertices_m), 300)]
    points = np.vstack([anywhere, corners + rng.normal(0.0, 1e-6, corners.shape)])
    expected = winding_number(points, TORUS.triangles_m) > 0.5
    assert 0.2 < expected.mean() < 0.8
    np.testing.assert_array_equal(contains(TORUS, points), expected)


def test_rays_along_edges_and_through_corners_do_not_mislead() -> None:
    """Points on a grid of a box have rays through its corners and edges, and lie in its faces' diagonals."""
    grid = np.linspace(-1.5, 1.5, 7)
    points = np.stack(np.meshgrid(grid, grid, grid), -1).reshape(-1, 3)
    clear = (np.abs(np.abs(points).max(1) - 1.0)) > 1e-9
    np.testing.assert_array_equal(contains(BOX, points)[clear], np.abs(points[clear]).max(1) < 1.0)
    for each in points[clear]:  # alone, the ray of a point goes through the box's middle, or away from it
        assert contains(BOX, each[None])[0] == (np.abs(each).max() < 1.0)


def test_of_two_nested_spheres_the_turned_one_is_a_hollow() -> None:
    outer, inner = (trimesh.creation.icosphere(2, radius) for radius in (1.0, 0.5))
    inner.invert()
    hollow = mesh_of(trimesh.util.concatenate([outer, inner]))
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.2, 0.3], [0.6, 0.3, 0.1], [0.0, 0.8, 0.0], [0.7, 0.7, 0.7]])
    np.testing.assert_array_equal(contains(hollow, points), [False, False, True, True, False])


def test_an_open_mesh_is_inside_where_it_winds_more_than_half() -> None:
    bowl = Mesh(BOX.vertices_m, BOX.faces[2:])
    assert not bowl.is_closed
    points = np.random.default_rng(1).uniform(-1.2, 1.2, (200, 3))
    boxed = np.abs(points).max(1) < 1.0
    expected = (winding_number(points, bowl.triangles_m) > 0.5) & boxed
    np.testing.assert_array_equal(contains(bowl, points), expected)


@pytest.mark.parametrize("count", [0, 1])
def test_few_points_are_as_good_as_many(count: int) -> None:
    assert contains(BOX, np.zeros((count, 3))).tolist() == [True] * count

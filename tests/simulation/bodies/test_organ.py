"""The organ: convex, centred on its frame's origin, and of the same outline whatever lies on it."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.simulation.organ import HEIGHT_M, make_organ, polygon_centroid
from svmdist.simulation.bodies.relief import make_relief


@pytest.mark.parametrize("seed", range(4))
def test_the_outline_is_convex_about_the_origin(seed: int) -> None:
    organ = make_organ(np.random.default_rng(seed))
    sides = np.roll(organ.outline_m, -1, axis=0) - organ.outline_m
    following = np.roll(sides, -1, axis=0)
    assert (sides[:, 0] * following[:, 1] - sides[:, 1] * following[:, 0]).min() > 0.0
    np.testing.assert_allclose(polygon_centroid(organ.outline_m), 0.0, atol=1e-15)


@pytest.mark.parametrize("seed", range(4))
def test_the_dome_is_convex_and_of_its_height(seed: int) -> None:
    """No vertex before any triangle's plane, within 0.1 µm; the top within the 3 % that a seed may choose."""
    organ = make_organ(np.random.default_rng(seed))
    mesh = organ.mesh
    a, b, c = (mesh.vertices_m[mesh.faces[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    some = slice(None, None, 7)  # 2,000 of 14,000 triangles
    before_m = mesh.vertices_m @ normals[some].T - np.einsum("ij,ij->i", a[some], normals[some])
    assert before_m.max() < 1e-7
    assert organ.height_m == pytest.approx(HEIGHT_M, rel=0.03)
    assert mesh.vertices_m[:, 2].max() == organ.height_m


def test_relief_leaves_the_outline_where_it_was() -> None:
    relief = make_relief(np.random.default_rng(9), 0.0005, 0.022)
    plain, bumpy = (make_organ(np.random.default_rng(1), each) for each in (None, relief))
    assert plain.is_convex
    assert not bumpy.is_convex
    rim_m = bumpy.mesh.vertices_m[-len(bumpy.outline_m) :]
    np.testing.assert_allclose(rim_m[:, :2], bumpy.outline_m, atol=1e-15)
    np.testing.assert_allclose(rim_m[:, 2], 0.0, atol=1e-15)


def test_centroid_of_a_triangle() -> None:
    corners = np.array([[0.0, 0.0], [6.0, 0.0], [0.0, 3.0]])
    np.testing.assert_allclose(polygon_centroid(corners), [2.0, 1.0], atol=1e-15)

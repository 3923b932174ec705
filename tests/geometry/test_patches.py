"""Groups of faces: every face is in one, and what bounds a group holds it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from svmdist.geometry.patches import FACES_PER_PATCH, Patches, compact_order, is_closed
from svmdist.geometry.surfaces import Mesh
from svmdist.transforms import make_transform, rotation_x


def sphere(subdivisions: int) -> Mesh:
    solid = trimesh.creation.icosphere(subdivisions, 0.03)
    return Mesh(np.asarray(solid.vertices, np.float64), np.asarray(solid.faces, np.int64))


@pytest.mark.parametrize("subdivisions", [0, 1, 3])
def test_every_face_is_in_a_patch_whose_bounds_hold_it(subdivisions: int) -> None:
    mesh = sphere(subdivisions)
    patches = mesh.patches
    assert set(patches.faces.ravel()) == set(range(len(mesh.faces)))
    assert patches.faces.shape[1] == FACES_PER_PATCH
    for moved in (mesh, mesh.with_vertices(mesh.vertices_m * [1.0, 0.5, 2.0] + 0.1)):
        bounds = moved.patches.bounds(moved.vertices_m)
        corners = moved.vertices_m[moved.faces[patches.faces]]  # (p, k, 3, 3)
        away = np.abs(corners - bounds.centre_m[:, None, None])
        assert (away <= bounds.half_m[:, None, None]).all()
        assert (np.linalg.norm(away, axis=-1) <= bounds.reach_m[:, None, None] * (1.0 + 1e-15)).all()


def test_patches_are_small_beside_the_mesh() -> None:
    """A sphere of 1,280 faces has 80 or more patches; none reaches farther than a third of the radius's double."""
    mesh = sphere(3)
    assert mesh.bounds.reach_m.max() < 0.02


def test_moved_meshes_share_what_only_depends_on_the_faces() -> None:
    mesh = sphere(2)
    T = make_transform(rotation_x(0.4), [0.01, 0.02, 0.1])
    assert mesh.with_vertices(2.0 * mesh.vertices_m).patches is mesh.patches
    assert mesh.transformed(T).is_closed
    np.testing.assert_allclose(
        mesh.transformed(T).vertices_m, mesh.vertices_m @ T[:3, :3].T + T[:3, 3], atol=0
    )


def test_an_order_is_compact_at_every_halving() -> None:
    """Of points on a line, each half of the order is one side of it; items stand there twice to fill it up."""
    order = compact_order(np.random.default_rng(0).permutation(12)[:, None] * 1.0, 16, 16)
    assert set(order) == set(range(12))
    places = np.random.default_rng(0).permutation(12)[order]
    assert (np.diff(places) >= 0).all()


def test_closed_meshes_are_told_from_open_ones() -> None:
    mesh = sphere(1)
    assert is_closed(mesh.faces)
    assert not is_closed(mesh.faces[1:])
    turned = mesh.faces.copy()
    turned[0] = turned[0][::-1]
    assert not is_closed(turned)
    assert isinstance(Patches.of(mesh.vertices_m, mesh.faces), Patches)

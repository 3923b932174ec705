"""Meshes from files: the solids that trimesh reads, distances that trimesh finds, and every fault in a line."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from svmdist.errors import ProfileError
from svmdist.geometry import MAX_TRIANGLES, Capsules, read_closed_mesh
from svmdist.geometry.distance import separation


def organ() -> trimesh.Trimesh:
    """A lumpy closed body about 60 mm across, not convex, in mm."""
    body = trimesh.creation.icosphere(subdivisions=2)
    lumps = 1.0 + 0.25 * np.sin(3.0 * body.vertices[:, :1] + 1.0) * np.cos(4.0 * body.vertices[:, 1:2])
    body.vertices = body.vertices * lumps * (30.0, 24.0, 10.0)
    return body


def write(mesh: trimesh.Trimesh, path: Path, form: str) -> Path:
    content = mesh.export(file_type=form)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize(("form", "name"), [("obj", "a.obj"), ("stl", "a.STL"), ("stl_ascii", "b.stl")])
def test_distances_are_those_of_trimesh(tmp_path, form, name):
    """Spheres about random points are as far from the solid as trimesh says, inside and outside, within 1e-8 m."""
    truth = organ()
    mesh = read_closed_mesh(write(truth, tmp_path / name, form), 1e-3)
    assert len(mesh.faces) == len(truth.faces)
    assert len(mesh.vertices_m) == len(truth.vertices)
    rng = np.random.default_rng(5)
    points_m = rng.uniform(-1.0, 1.0, (20, 3)) * (0.03, 0.025, 0.012)
    scaled = truth.copy()
    scaled.apply_scale(1e-3)
    expected = -trimesh.proximity.signed_distance(scaled, points_m) - 0.001
    balls = [Capsules(point[None], point[None], np.array([0.001])) for point in points_m]
    assert (expected < 0).sum() > 3
    np.testing.assert_allclose([separation(ball, mesh).distance_m for ball in balls], expected, atol=1e-8)
    truth.invert()
    turned = read_closed_mesh(write(truth, tmp_path / f"inside-out-{name}", form), 1e-3)
    assert trimesh.Trimesh(turned.vertices_m, turned.faces).volume > 0.0


def test_polygons_backward_numbers_and_slashes(tmp_path):
    """A box of quadrilaterals, counted backwards, with normals and texture, is the box of 2 x 3 x 4 cm."""
    corners = "".join(f"v {x} {y} {z}  # corner\n" for x in (0, 2) for y in (0, 3) for z in (0, 4))
    sides = ((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4))
    faces = "".join(f"f {' '.join(f'{k - 9}/1/{k}' for k in side)}\n" for side in sides)
    path = tmp_path / "box.obj"
    path.write_text("mtllib box.mtl\no box\n" + corners + "vt 0 0\nvn 0 0 1\ns off\n" + faces)
    mesh = read_closed_mesh(path, 1e-2)
    box = trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)
    assert box.is_watertight
    assert box.volume == pytest.approx(24e-6, rel=1e-12)


TETRAHEDRON = "v 0 0 0\nv 30 0 0\nv 0 30 0\nv 0 0 30\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
HUGE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n" + "f 1 2 3\n" * (MAX_TRIANGLES + 1)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", None, "cannot read the mesh: No such file"),
        ("a.ply", "ply", r"expected a mesh in a file \.obj or \.stl, found \.ply"),
        ("a.obj", "", "an empty mesh"),
        ("a.stl", "", "not a mesh in STL: neither text"),
        ("a.stl", "solid nothing\nendsolid\n", "an empty mesh"),
        ("a.stl", "solid x\nvertex 1 2\nendsolid\n", "not a mesh in STL"),
        ("a.stl", "\0" * 80 + "\5\0\0\0" + "\0" * 99, "not a mesh in STL"),
        ("a.obj", TETRAHEDRON + "f 1 2 9\n", "not a mesh in OBJ: line 9 is no face"),
        ("a.obj", TETRAHEDRON + "f 1 2\n", "not a mesh in OBJ: line 9 is no face"),
        ("a.obj", TETRAHEDRON.replace("30 0 0", "30 0"), "not a mesh in OBJ: line 2 is no vertex"),
        ("a.obj", TETRAHEDRON.replace("30 0 0", "30 nan 0"), "not every coordinate is a finite number"),
        ("a.obj", TETRAHEDRON.replace("f 1 4 3\n", ""), "an open mesh: 3 edges have one face only"),
        ("a.obj", TETRAHEDRON.replace("f 1 4 3", "f 1 3 4"), "not all turned the same way"),
        ("a.obj", TETRAHEDRON + "f 1 2 3\nf 1 3 2\n", "edges have more than two faces"),
        ("a.obj", TETRAHEDRON.replace("0 0 30", "10 10 0"), "a degenerate mesh: it is flat"),
        ("a.obj", TETRAHEDRON.replace("30", "30000"), "5.196e.04 mm across.*mesh_unit"),
        ("a.obj", HUGE, "20001 triangles; at most 20000"),
    ],
)
def test_a_fault_is_one_line(tmp_path, name, content, message):
    """What bounds no solid is refused with the file and the reason, never measured."""
    path = tmp_path / name
    if content is not None:
        path.write_text(content)
    with pytest.raises(ProfileError, match=message) as caught:
        read_closed_mesh(path, 1e-3)
    assert str(caught.value).startswith(f"{path}: ")
    assert re.search(r"[\n\r]", str(caught.value)) is None

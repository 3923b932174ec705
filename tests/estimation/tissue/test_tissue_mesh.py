"""The tissue's shape from a mesh: where it is placed, what the profile refuses, and what it is worth."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from svmdist.errors import ProfileError
from svmdist.estimation.tissue import require_tissue, tissue_frame
from svmdist.profile import DEFAULT_PROFILE, Profile, Tissue, load_profile, profile_path
from svmdist.recording.log import open_recording
from svmdist.samples import Observation
from svmdist.simulation.scene import Scene, make_scene
from svmdist.transforms import make_transform, rotation_x, rotation_z
from tests.measuring import Measuring

GOLDEN_SEED = 1


def organ_obj(scene: Scene, path: Path) -> Path:
    """The organ of a seed with its underside, in mm, shifted by a centimetre as a scan's origin may be."""
    organ = scene.organ
    vertices = np.vstack([organ.mesh.vertices_m, [[0.0, 0.0, 0.0]]]) * 1e3 + (10.0, 0.0, 0.0)
    sides = len(organ.outline_m)
    rim = len(organ.mesh.vertices_m) - sides + np.arange(sides)
    bottom = np.stack([np.full(sides, len(vertices) - 1), np.roll(rim, -1), rim], -1)
    faces = np.concatenate([organ.mesh.faces, bottom]) + 1
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces]
    path.write_text("\n".join(lines))
    return path


def profile_with(folder: Path, tissue: str) -> Profile:
    """The shipped profile with other lines in place of its dome."""
    text = profile_path(DEFAULT_PROFILE).read_text("utf-8")
    text, count = re.subn(r"surface_std_m = .*\n\n\[tissue\.dome\]\n(.+\n)+", lambda _: tissue, text)
    assert count == 1
    path = folder / "mine.toml"
    path.write_text(text, "utf-8")
    return load_profile(path)


def test_clearance_is_nearer_to_the_truth_than_with_the_dome(tmp_path: Path, golden: Path) -> None:
    """With the organ's own mesh, the clearance's RMSE on a golden log falls from 0.36 to 0.20 mm."""
    shipped = load_profile()
    scene = make_scene(shipped, GOLDEN_SEED)
    organ_obj(scene, tmp_path / "organ.obj")
    R = scene.T_camera_tissue[:3, :3]
    yaw_rad = float(np.arctan2(-R[1, 0], R[0, 0]))
    offset = rotation_z(yaw_rad) @ [-0.01, 0.0, 0.0]
    lines = f'mesh = "organ.obj"\nmesh_unit = "mm"\nmesh_yaw_rad = {yaw_rad}\nmesh_position_m = {offset.tolist()}\n'
    meshed = profile_with(tmp_path, lines)
    recording = open_recording(golden / "contact.mcap", shipped)
    seen = [each for each in recording.observations() if isinstance(each, Observation)][::10]
    truth = recording.distance_track().at(np.array([each.stamp_ns for each in seen]))
    rmse_m = []
    for profile in (shipped, meshed):
        shaft = Measuring("shaft", profile)
        rows = [shaft.estimate(each) for each in seen]
        assert all(row.clearance_m is not None for row in rows)
        errors = np.array([row.clearance_m for row in rows], np.float64) - truth.clearance_m
        rmse_m.append(float(np.sqrt(np.mean(errors**2))))
    assert rmse_m[1] < 0.7 * rmse_m[0]


def test_the_tissues_frame_looks_at_the_camera() -> None:
    """z is the normal, x runs to the right and y upwards in the image, of every plane before a camera."""
    T = tissue_frame(np.array([0.01, 0.02, 0.1]), np.array([0.0, 0.0, -1.0]))
    np.testing.assert_allclose(T, make_transform(np.diag([1.0, -1.0, -1.0]), [0.01, 0.02, 0.1]), atol=1e-15)
    for normal in (rotation_x(2.5)[:, 2], np.array([0.6, 0.0, -0.8]), np.array([-1.0, 0.0, 0.0])):
        R = tissue_frame(np.zeros(3), normal)[:3, :3]
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1.0)
        np.testing.assert_allclose(R[:, 2], normal, atol=1e-12)


def test_a_mesh_turns_and_shifts_as_the_profile_says() -> None:
    tissue = Tissue(
        plane_distance_m=0.1, mesh=Path("a.obj"), mesh_yaw_rad="pi/2", mesh_position_m=(0.01, 0.0, 0.002)
    )
    np.testing.assert_allclose(
        tissue.T_tissue_mesh @ [0.03, 0.0, 0.0, 1.0], [0.01, 0.03, 0.002, 1.0], atol=1e-15
    )


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ('mesh = "a.obj"\n[tissue.dome]\nheight_m = 0.01\n', "tissue: a dome and a mesh exclude each other"),
        ("mesh_yaw_rad = 0.1\n", "tissue: mesh_yaw_rad needs a mesh"),
        ('mesh = "a.obj"\nmesh_unit = "inch"\n', r"tissue\.mesh_unit: .*'mm' \(found 'inch'\)"),
    ],
)
def test_the_profile_refuses_what_has_no_meaning(tmp_path: Path, lines: str, message: str) -> None:
    with pytest.raises(ProfileError, match=message):
        profile_with(tmp_path, lines)


def test_a_mesh_that_is_missing_is_told_when_the_method_is_made(tmp_path: Path) -> None:
    profile = profile_with(tmp_path, 'mesh = "gone.stl"\n')
    with pytest.raises(ProfileError, match=r"gone\.stl: cannot read the mesh: No such file"):
        require_tissue(profile)

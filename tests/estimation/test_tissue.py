"""The tissue: where it lies, its surface by outline, stereo or mesh, and how sure that is."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import trimesh

from svmdist.camera import Camera
from svmdist.estimation.instrument.shaft import ShaftSizes
from svmdist.estimation.instrument.verification import contradiction
from svmdist.estimation.tissue.detection import DomeModel, TissuePose, detect_tissue, tissue_frame
from svmdist.geometry import Capsules, Cloud
from svmdist.geometry.distance import separation
from svmdist.profile import Profile, load_profile
from svmdist.profile.robot import Dome
from svmdist.results import ToolPose
from svmdist.samples import Status
from svmdist.simulation.scene import Scene, make_scene
from svmdist.transforms import Array, rotation_z, transform_points
from tests.golden import golden_frames, true_distances_m
from tests.measuring import Measuring
from tests.shipped import PROFILE, write_profile

CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)


def drawn_masks(*, blood: bool = False) -> SimpleNamespace:
    """An ellipse, and a dark shaft beside it, with patches of blood."""
    tissue, shaft = np.zeros((480, 640), np.uint8), np.zeros((480, 640), np.uint8)
    cv2.ellipse(tissue, (260, 240), (110, 80), 10, 0, 360, 255, -1)
    cv2.line(shaft, (420, 200), (640, 100), 255, 56)
    tissue[shaft > 0] = 0
    if blood:
        for centre in ((470, 178), (560, 135)):
            cv2.circle(tissue, centre, 15, 255, -1)
            cv2.circle(shaft, centre, 15, 0, -1)
    return SimpleNamespace(tissue=tissue, shaft=shaft, instrument=np.zeros_like(tissue), black=None)


def centroid(masks: SimpleNamespace) -> Array:
    found = detect_tissue(masks, PROFILE, CAMERA)
    return found.outline.centroid_px


def test_blood_on_the_shaft_does_not_pull_the_outline():
    """It is as if it were not there; without a mask of the shaft nothing tells it apart."""
    clean, bloody = drawn_masks(), drawn_masks(blood=True)
    np.testing.assert_allclose(centroid(bloody), centroid(clean), atol=0.05)
    bloody.shaft = None
    assert np.linalg.norm(centroid(bloody) - centroid(clean)) > 10.0


RULE = Dome(height_m=0.008, gauge_exponent=2.3, height_exponent=0.62, height_std_m=1.5e-4, apex_std_m=2e-3)
NORMAL = np.array([0.1, -0.2, -0.9]) / np.linalg.norm([0.1, -0.2, -0.9])
ORIGIN_M = np.array([0.004, -0.003, 0.11])
T = tissue_frame(ORIGIN_M, NORMAL)
ANGLE = np.linspace(0.0, 2.0 * np.pi, 180, endpoint=False)
OUTLINE_M = np.stack([0.028 * np.cos(ANGLE), 0.022 * np.sin(ANGLE + 0.1), 0.0 * ANGLE], -1)
DOME = DomeModel.over(transform_points(T, OUTLINE_M), T, RULE)


def shaped(*shape: float) -> DomeModel:
    """The dome under another apex and height, perhaps of other exponents too."""
    return replace(DOME, shape=np.array([*shape, *DOME.shape[len(shape) :]]))


def inner_points(count: int) -> Array:
    """Points inside the outline, in the tissue's frame, shape (n, 2)."""
    rng = np.random.default_rng(3)
    radius = 0.85 * np.sqrt(rng.uniform(0.0, 1.0, count))
    return radius[:, None] * OUTLINE_M[rng.integers(0, len(ANGLE), count), :2]


def test_heights_are_those_of_the_mesh():
    """The height over the plane and the mesh's, by rays of trimesh, agree to its chords; the mesh is closed."""
    dome = shaped(3e-3, -2e-3, 8.3e-3)
    mesh = dome.mesh
    solid = trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)
    assert solid.is_watertight
    assert solid.volume > 0.0
    points_m = inner_points(200)
    height_m = dome.height_m(points_m)
    above = transform_points(T, np.column_stack([points_m, np.full(200, 0.05)]))
    hits, rays, _ = solid.ray.intersects_location(above, np.tile(-T[:3, 2], (200, 1)), multiple_hits=False)
    found_m = dome.to_tissue_frame(hits)[:, 2]
    np.testing.assert_allclose(found_m, height_m[rays], atol=6e-5)
    assert len(rays) == 200


def test_surface_deviation_is_that_of_drawn_shapes():
    """A sphere's clearance to domes of drawn apex and height scatters as the surface's variance says."""
    rng = np.random.default_rng(5)
    middle = T @ np.array([0.012, 0.006, 0.02, 1.0])
    ball = Capsules(middle[None, :3], middle[None, :3], np.array([1e-3]))
    gap = separation(ball, DOME.mesh)
    stated_m = np.sqrt(DOME.variance_m2(gap.on_tissue_m, gap.direction))
    draws = rng.multivariate_normal(DOME.shape, 0.25 * DOME.covariance, 200)
    found_m = [separation(ball, shaped(*draw).mesh).distance_m for draw in draws]
    assert np.std(found_m) == pytest.approx(0.5 * stated_m, rel=0.2)


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
    dome = (r"surface_std_m = .*\n\n\[tissue\.dome\]\n(.+\n)+", tissue)
    return load_profile(write_profile(folder / "mine.toml", dome))


def test_clearance_is_nearer_to_the_truth_than_with_the_dome(tmp_path):
    """With the organ's own mesh, the clearance's RMSE on a golden log falls from 0.36 to 0.20 mm."""
    scene = make_scene(PROFILE, GOLDEN_SEED)
    organ_obj(scene, tmp_path / "organ.obj")
    R = scene.T_camera_tissue()[:3, :3]
    yaw_rad = float(np.arctan2(-R[1, 0], R[0, 0]))
    offset = rotation_z(yaw_rad) @ [-0.01, 0.0, 0.0]
    lines = f'mesh = "organ.obj"\nmesh_unit = "mm"\nmesh_yaw_rad = {yaw_rad}\nmesh_position_m = {offset.tolist()}\n'
    meshed = profile_with(tmp_path, lines)
    seen = golden_frames("contact", range(0, 80, 10))
    truth_m = true_distances_m("contact", seen)[:, 2]
    rmse_m = []
    for profile in (PROFILE, meshed):
        shaft = Measuring("shaft", profile)
        rows = [shaft.estimate(each) for each in seen]
        assert all(row.clearance_m is not None for row in rows)
        errors = np.array([row.clearance_m for row in rows], np.float64) - truth_m
        rmse_m.append(float(np.sqrt(np.mean(errors**2))))
    assert rmse_m[1] < 0.7 * rmse_m[0]


@pytest.mark.parametrize("plane_distance_m", [0.112, 0.122])
def test_a_surface_that_both_views_show_needs_no_shape_from_the_profile(tmp_path, plane_distance_m):
    """`fused` without a dome, on a plane that is right or 10 mm off and says so: contact is seen as such."""
    bare = profile_with(tmp_path, "surface_std_m = 5e-3\n")
    rough = {"plane_distance_m": plane_distance_m, "plane_distance_std_m": 0.01}
    bare = bare.model_copy(update={"tissue": bare.tissue.model_copy(update=rough)})
    seen = golden_frames("3d/contact", range(0, 36, 7), bare)
    truth_m = true_distances_m("3d/contact", seen)[:, 2]
    fused = Measuring("fused", bare)
    rows = [fused.estimate(each) for each in seen]
    assert all(row.status is Status.OK and row.clearance_std_m < 3e-3 for row in rows)
    errors_m = np.array([row.clearance_m for row in rows]) - truth_m
    assert np.all(np.abs(errors_m) < 2e-3)


def test_where_an_outline_ends_is_as_uncertain_as_clevises_differ():
    """Without the profile's word the end may be the dark shaft's or a clevis's; a stated deviation is taken."""
    instrument = PROFILE.instrument.model_copy(update={"outline_end_m": None})
    unknown = ShaftSizes(instrument, 0.0)
    for end_m in (-unknown.end_m, 0.9 * unknown.radius_m):
        assert abs(end_m - unknown.outline_end_m) <= 1.001 * unknown.outline_end_std_m
    stated = ShaftSizes(instrument.model_copy(update={"outline_end_m": 0.0, "outline_end_std_m": 3e-3}), 0.0)
    assert (stated.outline_end_m, stated.outline_end_std_m) == (0.0, 3e-3)


@pytest.mark.parametrize(
    ("behind_m", "std_m", "is_refused"), [(-5e-3, 2e-3, False), (5e-2, 2e-2, True), (3e-2, 2e-2, False)]
)
def test_a_tool_behind_the_tissue_is_not_far_from_it(behind_m, std_m, is_refused):
    """A measured surface has no inside: a tool behind the tissue's plane by more than is uncertain would seem safe."""
    frame = SimpleNamespace(arm=SimpleNamespace(profile=PROFILE))
    T = np.eye(4)
    T[2, 3] = PROFILE.tissue.plane_distance_m + behind_m
    pose = ToolPose(T, std_m**2 * np.eye(6), np.array([0.0, 0.0, 1.0]))
    tissue = TissuePose(
        np.array([0.0, 0.0, 0.112]),
        1e-6 * np.eye(3),
        Cloud(np.zeros((1, 3)), np.zeros(1)),
        1e-3,
        is_measured=True,
    )
    assert bool(contradiction(frame, pose, None, tissue)) == is_refused

"""The scene of a seed: bodies as they are described, and options that move nothing else."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from svmdist.errors import SimulationError, UsageError
from svmdist.simulation.motion import Scenario
from svmdist.simulation.organ import LIMIT, make_organ
from svmdist.simulation.scene import BREATHING_HZ, PULSE_HZ, Options, make_scene
from svmdist.transforms import Array, polygon_centroid
from tests.simulation.conftest import chosen, perturbed

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation.plan import make_plan

T_S = np.arange(0.0, 40.0, 0.01)


def depth_in_hull_m(vertices_m: Array) -> float:
    """How far the deepest vertex lies inside of the convex hull."""
    planes = ConvexHull(vertices_m).equations
    blocks = np.array_split(vertices_m, len(vertices_m) // 16 + 1)
    return -min(float((block @ planes[:, :3].T + planes[:, 3]).max(axis=1).min()) for block in blocks)


def test_the_ideal_bodies_are_convex(profile, scene):
    """Bullet measures hulls of the parts: every vertex lies on its hull to 5 µm, the bridge's to 0.1 mm."""
    for part in scene.parts:
        depth_m = depth_in_hull_m(part.mesh.vertices_m)
        assert depth_m < (1e-4 if part.name == "bridge" else 5e-6), part.name
    for seed in range(4):
        assert depth_in_hull_m(make_scene(profile, seed).organ.mesh.vertices_m) < 5e-6


@pytest.mark.parametrize("seed", range(3))
def test_lobes_keep_centroid_and_height(seed):
    """The origin stays the outline's centroid, nothing is higher than the dome, and a place has one height."""
    shapes = ("", "tissue_shape=0.4")
    dome, organ = (make_organ(np.random.default_rng(seed), seed, chosen(text)) for text in shapes)
    np.testing.assert_allclose(polygon_centroid(organ.outline_m), 0.0, atol=1e-12)
    z_m = organ.mesh.vertices_m[:, 2]
    assert (z_m.min(), z_m.max()) == pytest.approx((0.0, dome.height_m), abs=1e-12)
    corners_m = organ.mesh.vertices_m[organ.mesh.faces][..., :2]
    (ax, ay), (bx, by) = (np.moveaxis(corners_m[:, k] - corners_m[:, 0], -1, 0) for k in (1, 2))
    assert (ax * by - ay * bx).min() > 0.0
    assert 0.0005 < depth_in_hull_m(organ.mesh.vertices_m) < 0.005


def test_an_ellipsoid_is_one():
    """Height over the plane is sqrt(1 - r²) of the apex's."""
    organ = make_organ(np.random.default_rng(1), 1, chosen("tissue_ellipsoid=1"))
    apex_m, rings = organ.mesh.vertices_m[0], organ.mesh.vertices_m[1:].reshape(-1, len(organ.outline_m), 3)
    away_m = np.linalg.norm(rings[..., :2] - apex_m[:2], axis=-1)
    np.testing.assert_allclose((rings[..., 2] / apex_m[2]) ** 2 + (away_m / away_m[-1]) ** 2, 1.0, atol=1e-9)


@pytest.mark.parametrize("text", ["", "dent=1,tissue_shape=0.4,tissue_ellipsoid=0.5"])
def test_heights_are_those_of_the_triangles(text):
    """Within 1 nm of where a ray from above meets the mesh; -inf where none does."""
    organ = make_organ(np.random.default_rng(2), 3, chosen(text))
    low, high = organ.outline_m.min(0), organ.outline_m.max(0)
    xy_m = np.random.default_rng(1).uniform(low, high, (400, 2))
    mesh = trimesh.Trimesh(organ.mesh.vertices_m * 1e3, organ.mesh.faces, process=False)
    starts = np.column_stack([xy_m * 1e3, np.full(len(xy_m), 50.0)])
    hits, ray, _ = mesh.ray.intersects_location(starts, np.tile([0.0, 0.0, -1.0], (len(starts), 1)))
    expected_m = np.full(len(xy_m), -np.inf)
    expected_m[ray] = hits[:, 2] * 1e-3
    np.testing.assert_allclose(organ.heights_m(xy_m), expected_m, atol=1e-9)
    assert 0.6 < np.isfinite(expected_m).mean() < 0.9


@pytest.mark.parametrize("depth_m", [1e-5, 5e-4, 4e-3])
def test_a_dent_goes_down_to_what_presses_and_leaves_the_rest(depth_m):
    """A ball pressed 0.01 to 4 mm deep has 2 µm inside at most, and the surface goes down as far, to 2 %."""
    organ = make_organ(np.random.default_rng(2), 0, chosen("dent=1"))
    points = np.random.default_rng(0).normal(0.0, 1.0, (6000, 3))
    points *= 0.0015 / np.linalg.norm(points, axis=1, keepdims=True)
    points += [0.002, 0.001, organ.heights_m(np.array([[0.002, 0.001]]))[0] + 0.0015 - depth_m]
    points = organ.inside(points)
    deepest_m = (organ.heights_m(points[:, :2]) - points[:, 2]).max()  # the surface is tilted
    assert not organ.is_too_deep(points)
    dented = organ.dented(points)
    assert (dented.heights_m(points[:, :2]) - points[:, 2]).max() < 2e-6
    down_m = organ.mesh.vertices_m[:, 2] - dented.mesh.vertices_m[:, 2]
    assert down_m.min() >= 0.0
    assert down_m.max() == pytest.approx(deepest_m, rel=0.02, abs=3e-6)
    away_m = np.linalg.norm(organ.mesh.vertices_m[:, None, :2] - points[None, ::20, :2], axis=2).min(axis=1)
    np.testing.assert_array_equal(down_m[away_m > 0.0135], 0.0)
    far_down = points - [0.0, 0.0, 0.9 * organ.height_m]
    assert organ.is_too_deep(far_down)
    flat_m = organ.dented(far_down).mesh.vertices_m[:, 2]
    assert (flat_m >= (1.0 - LIMIT) * organ.mesh.vertices_m[:, 2] - 1e-12).all()


def test_breath_and_pulse_have_their_amplitudes_and_frequencies(profile):
    """Two lines in the spectrum, of 2 mm at 0.25 Hz and of 0.4 mm at 1.2 Hz."""
    offset_m = make_scene(profile, 7, perturbed("breathing=2,pulse=0.4")).tissue_offset_m(T_S)
    spectrum = np.abs(np.fft.rfft(offset_m)) / (0.5 * len(T_S))
    hz = np.fft.rfftfreq(len(T_S), 0.01)
    for frequency, amplitude_m in ((BREATHING_HZ, 2e-3), (PULSE_HZ, 4e-4)):
        line = int(np.argmin(np.abs(hz - frequency)))
        assert abs(spectrum[line] - amplitude_m) < 2e-6
        spectrum[line] = 0.0
    assert spectrum.max() < 1e-6
    opening_rad = make_scene(profile, 7, perturbed("jaw=20")).jaw_opening_rad(T_S)
    assert (opening_rad.min(), opening_rad.max()) == pytest.approx((0.0, np.deg2rad(20.0)), abs=1e-4)


@pytest.mark.parametrize(
    ("update", "options", "said"),
    [
        ({"robot": None}, {}, r"it needs \[robot\], \[instrument\] and \[simulation\]"),
        ({"fiducial": None}, {"tag": True}, r"it needs \[fiducial\]"),
        ({"other_instruments": ()}, {"arms": 2}, r"places 1 of 2 arms: it needs \[\[other_instruments\]\]"),
    ],
)
def test_what_cannot_be_simulated_is_an_error(profile, update, options, said):
    with pytest.raises((SimulationError, UsageError), match=said):
        make_plan(Scenario("sweep", 1, 0.1, 10.0), profile.model_copy(update=update), options=Options(**options))
    with pytest.raises(UsageError, match="hold no frame"):
        Scenario("sweep", 0, 0.1, 1.0)

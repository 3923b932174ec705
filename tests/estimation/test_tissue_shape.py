"""A dome's shape: their geometry, what they say of a clearance, and how a stereo cloud tells them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from svmdist.estimation.dome import SMOOTH_FRACTION, DomeModel, fit_dome
from svmdist.estimation.surface import StereoSurface
from svmdist.estimation.tissue import TissuePose, tissue_frame
from svmdist.estimation.tissue_tracking import DEFAULT as TRACKING
from svmdist.estimation.tissue_tracking import SHAPE_COUNT, TissueTracker
from svmdist.geometry.distance import separation
from svmdist.geometry.surfaces import Capsules, Mesh, Plane
from svmdist.profile import Dome
from svmdist.transforms import Array, transform_points

RULE = Dome(height_m=0.008, gauge_exponent=2.3, height_exponent=0.62, height_std_m=1.5e-4, apex_std_m=2e-3)
NORMAL = np.array([0.1, -0.2, -0.9]) / np.linalg.norm([0.1, -0.2, -0.9])
ORIGIN_M = np.array([0.004, -0.003, 0.11])
T = tissue_frame(ORIGIN_M, NORMAL)
ANGLE = np.linspace(0.0, 2.0 * np.pi, 180, endpoint=False)
OUTLINE_M = np.stack([0.028 * np.cos(ANGLE), 0.022 * np.sin(ANGLE + 0.1), 0.0 * ANGLE], -1)
DOME = DomeModel.over(transform_points(T, OUTLINE_M), T, RULE)


def shaped(*shape: float) -> DomeModel:
    """The dome under another apex and height, perhaps of other exponents too."""
    return DOME.shaped(np.array([*shape, *DOME.shape[len(shape) :]]), DOME.covariance)


def inner_points(count: int, seed: int = 3, gauge: float = 0.85) -> Array:
    """Points inside the outline, in the tissue's frame, shape (n, 2)."""
    rng = np.random.default_rng(seed)
    radius = gauge * np.sqrt(rng.uniform(0.0, 1.0, count))
    return radius[:, None] * OUTLINE_M[rng.integers(0, len(ANGLE), count), :2]


def test_heights_are_those_of_the_mesh() -> None:
    """The height over the plane and the mesh's, by rays of trimesh, agree to its chords; the mesh is closed."""
    dome = shaped(3e-3, -2e-3, 8.3e-3)
    mesh = dome.mesh()
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


def test_surface_deviation_is_that_of_drawn_shapes() -> None:
    """A sphere's clearance to domes of drawn apex and height scatters as the surface's variance says."""
    rng = np.random.default_rng(5)
    middle = T @ np.array([0.012, 0.006, 0.02, 1.0])
    ball = Capsules(middle[None, :3], middle[None, :3], np.array([1e-3]))
    gap = separation(ball, DOME.mesh())
    stated_m = np.sqrt(DOME.variance_m2(gap.on_tissue_m, gap.direction))
    draws = rng.multivariate_normal(DOME.shape, 0.25 * DOME.covariance, 200)
    found_m = [separation(ball, shaped(*draw).mesh()).distance_m for draw in draws]
    assert np.std(found_m) == pytest.approx(0.5 * stated_m, rel=0.2)


def test_the_deviation_has_a_bound_at_the_rim() -> None:
    """Where the dome is vertical its derivative has no bound; the stated deviation has."""
    rim = T @ np.array([*OUTLINE_M[0, :2], 0.0, 1.0])
    assert 0.0 < DOME.variance_m2(rim[:3], -NORMAL) < (5e-4) ** 2


def cloud(dome: DomeModel, error_m: Array | float = 0.0, points_m: Array | None = None) -> StereoSurface:
    flat_m = inner_points(800) if points_m is None else points_m
    return StereoSurface(
        transform_points(T, np.column_stack([flat_m, dome.height_m(flat_m) + error_m])), 3.6e-4
    )


def test_a_cloud_tells_apex_and_height() -> None:
    """Of an exact cloud the fit goes the prior's part short of the truth, and is surer than before."""
    truth = shaped(2.5e-3, -1.5e-3, 8.15e-3)
    found = fit_dome(DOME, cloud(truth))
    assert found is not None
    assert np.all(np.diag(found.covariance) < np.diag(DOME.covariance))
    z = (found.shape - truth.shape) / np.sqrt(np.diag(found.covariance))
    assert np.abs(z).max() < 1.0
    points_m = inner_points(300, seed=8)
    before_m, after_m = (dome.height_m(points_m) - truth.height_m(points_m) for dome in (DOME, found))
    assert np.sqrt(np.mean(after_m**2)) < 0.3 * np.sqrt(np.mean(before_m**2))


def test_fitted_shapes_are_as_sure_as_they_say() -> None:
    """Over drawn shapes and smooth errors of the cloud the normalised squared error is five, as of five numbers."""
    rng = np.random.default_rng(11)
    flat_m = inner_points(400)
    u, v = (flat_m / 0.02).T
    basis = np.stack([u**i * v**j for i in range(4) for j in range(4 - i)], -1)
    smooth = np.linalg.qr(basis)[0] * np.sqrt(len(flat_m) / basis.shape[1])
    squares = []
    for _ in range(60):
        truth = DOME.shaped(rng.multivariate_normal(DOME.shape, DOME.covariance), DOME.covariance)
        error_m = smooth @ rng.normal(0.0, SMOOTH_FRACTION * 3.6e-4, basis.shape[1])
        found = fit_dome(DOME, cloud(truth, error_m, flat_m))
        assert found is not None
        off = found.shape - truth.shape
        squares.append(off @ np.linalg.solve(found.covariance, off))
    assert 3.0 < np.mean(squares) < 7.5


@pytest.mark.parametrize("error_m", [0.0, 0.004])
def test_what_is_no_dome_is_refused(error_m: float) -> None:
    """A cloud that scatters by millimetres, or has hardly a point, changes nothing; nor does any, without a doubt."""
    rng = np.random.default_rng(2)
    if error_m:
        assert fit_dome(DOME, cloud(DOME, rng.normal(0.0, error_m, 800))) is None
    else:
        assert fit_dome(DOME, cloud(DOME, 0.0, inner_points(20))) is None
        sure = DOME.shaped(DOME.shape, np.zeros((5, 5)))
        assert fit_dome(sure, cloud(DOME)) is None


def test_shape_is_remembered_until_the_tissue_moves() -> None:
    """Views of the shape enter the surface and its deviation, are soon wanted rarely, and are forgotten in a move."""
    tracker = TissueTracker()
    seen = DOME.shaped(np.array([2e-3, 0.0, 8.2e-3, 2.2, 0.6]), 0.1 * DOME.covariance)
    fix = TissuePose(ORIGIN_M, 1e-10 * np.eye(3), DOME.mesh(), 0.0, DOME)
    for _ in range(SHAPE_COUNT):
        assert tracker.wants_shape
        known = tracker.add(fix)
        tracker.add_shape(seen)
    known = tracker.add(fix)
    assert not tracker.wants_shape
    assert known is not None
    assert known.dome is not None
    assert isinstance(known.surface, Mesh)
    np.testing.assert_allclose(known.dome.shape, seen.shape, rtol=1e-6)
    np.testing.assert_allclose(known.dome.covariance, seen.covariance, rtol=1e-3)
    np.testing.assert_allclose(known.surface.vertices_m, known.dome.mesh().vertices_m)
    far = TissuePose(ORIGIN_M + np.array([0.01, 0.0, 0.0]), 1e-10 * np.eye(3), DOME.mesh(), 0.0, DOME)
    for _ in range(TRACKING.moved_count):
        known = tracker.add(far)
    assert known is not None
    assert known.dome is not None
    np.testing.assert_allclose(known.dome.shape, DOME.shape)


def test_a_plane_has_no_shape() -> None:
    plane = Plane(NORMAL, float(NORMAL @ ORIGIN_M))
    fix = TissuePose(ORIGIN_M, 1e-10 * np.eye(3), plane, 2e-4)
    tracker = TissueTracker()
    tracker.add(fix)
    tracker.add_shape(DOME)
    known = tracker.now()
    assert known is not None
    assert known.surface is plane
    assert fix.surface_variance_m2(ORIGIN_M, NORMAL) == pytest.approx(4e-8)

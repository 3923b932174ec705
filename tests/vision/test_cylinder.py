"""The closed form against silhouettes found otherwise, over any direction."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from svmdist.transforms import Array
from svmdist.vision.lines import (
    Line,
    TangentPlane,
    axis_of_cylinder,
    tangent_normal,
    tangent_plane,
)

NONE = np.zeros((3, 3))


def random_cylinder(rng: np.random.Generator) -> tuple[Array, Array, float]:
    """A point of the axis nearest to the camera, the axis' direction, and a radius in m."""
    d = rng.normal(size=3)
    d /= np.linalg.norm(d)
    p = np.cross(d, rng.normal(size=3))
    p *= rng.uniform(0.03, 0.3) / np.linalg.norm(p)
    return p, d, rng.uniform(0.001, 0.01)


def silhouette_normals(p: Array, d: Array, radius_m: float) -> tuple[Array, Array]:
    """Tangent planes from the surface: where a normal of the cylinder stands across the viewing ray, by root search."""
    u = p / np.linalg.norm(p)
    v = np.cross(d, u)

    def surface_normal(angle: float) -> Array:
        return np.cos(angle) * u + np.sin(angle) * v

    def facing(angle: float) -> float:
        return float(surface_normal(angle) @ (p + radius_m * surface_normal(angle)))

    roots = [brentq(facing, *between, xtol=1e-15) for between in ((np.pi / 2, np.pi), (-np.pi, -np.pi / 2))]
    normals = [-surface_normal(angle) for angle in roots]
    return normals[0], normals[1]


def test_axis_comes_back_from_its_silhouette_to_1e_9():
    rng = np.random.default_rng(0)
    for _ in range(300):
        p, d, radius_m = random_cylinder(rng)
        first, second = silhouette_normals(p, d, radius_m)
        axis = axis_of_cylinder(TangentPlane(first, NONE), TangentPlane(second, NONE), radius_m)
        assert axis is not None
        np.testing.assert_allclose(axis.point_m, p, atol=1e-9)
        np.testing.assert_allclose(axis.direction * np.sign(axis.direction @ d), d, atol=1e-9)


def test_tangent_normals_are_the_silhouettes_and_know_their_side():
    rng = np.random.default_rng(1)
    for _ in range(100):
        p, d, radius_m = random_cylinder(rng)
        found = [tangent_normal(p + 0.3 * d, d, radius_m, side) for side in (1, -1)]
        expected = silhouette_normals(p, d, radius_m)
        for normal in found:
            assert min(np.linalg.norm(normal - other) for other in expected) < 1e-9
    # An axis to the right through the image's middle: its right edge, y being down, is the lower one.
    lower = tangent_normal(np.array([0.0, 0.0, 0.1]), np.array([1.0, 0.0, 0.0]), 0.004, 1)
    assert -lower[2] / lower[1] > 0.0


def test_a_cylinder_without_width_and_one_around_the_camera_are_rejected():
    p, d = np.array([0.0, 0.0, 0.5]), np.array([1.0, 0.0, 0.0])
    thin = [TangentPlane(tangent_normal(p, d, 0.001, side), NONE) for side in (1, -1)]
    assert axis_of_cylinder(thin[0], thin[1], 0.001) is None
    assert np.isnan(tangent_normal(np.array([0.0, 0.0, 0.003]), d, 0.004, 1)).all()


def test_covariance_agrees_with_a_thousand_disturbed_lines():
    p, d, radius_m = np.array([0.004, 0.012, 0.09]), np.array([0.8, -0.1, 0.0]), 0.004
    d[2] = -(d @ p) / p[2]
    d /= np.linalg.norm(d)
    rng = np.random.default_rng(2)
    spread = np.diag([2e-3**2, 2e-4**2])

    def line(normal: Array, turn: float, shift: float) -> Line:
        scale = np.hypot(*normal[:2])
        n, offset = normal[:2] / scale, -normal[2] / scale
        centre = offset * n
        turned = np.array([n[0] - turn * n[1], n[1] + turn * n[0]]) / np.hypot(1.0, turn)
        return Line(turned, float(turned @ centre) + shift, centre, spread, 100)

    inside = p[:2] / p[2]
    normals = [tangent_normal(p, d, radius_m, side) for side in (1, -1)]
    exact = axis_of_cylinder(*(tangent_plane(line(n, 0.0, 0.0), inside) for n in normals), radius_m)
    assert exact is not None
    drawn = []
    for _ in range(1000):
        planes = [
            tangent_plane(line(n, *(rng.normal(size=2) * np.sqrt(np.diag(spread)))), inside) for n in normals
        ]
        axis = axis_of_cylinder(*planes, radius_m)
        assert axis is not None
        drawn.append(np.concatenate([axis.point_m, axis.direction]))
    ratio = np.std(drawn, axis=0) / np.sqrt(np.diag(exact.covariance))
    assert ratio == pytest.approx(np.ones(6), abs=0.12)

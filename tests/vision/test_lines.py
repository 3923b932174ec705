"""Cylinders from their outlines."""

import numpy as np
from scipy.optimize import brentq

from svmdist.transforms import Array
from svmdist.vision.lines import TangentPlane, axis_of_cylinder, line_between


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
        d = rng.normal(size=3)
        d /= np.linalg.norm(d)
        p = np.cross(d, rng.normal(size=3))
        p *= rng.uniform(0.03, 0.3) / np.linalg.norm(p)
        radius_m = rng.uniform(0.001, 0.01)
        normals = silhouette_normals(p, d, radius_m)
        axis = axis_of_cylinder([TangentPlane(n, np.zeros((3, 3))) for n in normals], radius_m)
        np.testing.assert_allclose(axis.point_m, p, atol=1e-9)
        np.testing.assert_allclose(axis.direction * np.sign(axis.direction @ d), d, atol=1e-9)


def test_offsets_of_a_line_have_the_covariance_of_its_ends():
    """The plane's covariance, carried back to where its line has its ends, is that of the offsets it was made of."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        ends, root, inside = rng.normal(size=(2, 2)), rng.normal(size=(2, 2)), rng.normal(size=2)
        covariance = root @ root.T
        plane = line_between(ends, covariance, inside)
        rays = np.column_stack([ends, np.ones(2)])
        np.testing.assert_allclose(rays @ plane.normal, 0.0, atol=1e-12)
        assert plane.normal @ np.append(inside, 1.0) > 0.0
        J = rays / np.linalg.norm(plane.normal[:2])
        np.testing.assert_allclose(J @ plane.covariance @ J.T, covariance, atol=1e-9)

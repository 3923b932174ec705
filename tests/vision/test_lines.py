"""Sub-pixel edges, lines and discs, and the cylinders whose outlines they are."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.optimize import brentq

from svmdist.profile.settings import ShaftSettings
from svmdist.transforms import Array
from svmdist.vision.edges import edge_points, fit_disc
from svmdist.vision.frame_context import to_hsv
from svmdist.vision.lines import (
    TangentPlane,
    axis_of_cylinder,
    fit_line,
)

FAINT = ShaftSettings(min_contrast_levels=15.0)


def half_plane(angle_rad: float, offset_px: float, blur_px: float, noise: float) -> Array:
    """A dark half plane, drawn in 8 x 8 parts of each pixel; dark where normal · (p - (60, 50)) < offset."""
    part = (np.arange(8) + 0.5) / 8 - 0.5
    x = (np.arange(120)[:, None] + part).ravel() - 60.0
    y = (np.arange(100)[:, None] + part).ravel() - 50.0
    bright = np.cos(angle_rad) * x[None, :] + np.sin(angle_rad) * y[:, None] > offset_px
    image = (30.0 + 140.0 * bright).reshape(100, 8, 120, 8).mean((1, 3))
    image = cv2.GaussianBlur(image, (0, 0), blur_px) if blur_px else image
    image = image + np.random.default_rng(3).normal(0.0, noise, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("blur_px", "noise", "tolerance_px"),
    [(0.8, 0.0, 0.02), (0.8, 4.0, 0.05), (3.0, 2.0, 0.08), (0.0, 2.0, 0.06)],
)
@pytest.mark.parametrize("angle_rad", [0.0, 0.4, 1.2, 2.0, 3.3, 5.1])
def test_line_is_found_where_it_was_drawn(
    blur_px: float, noise: float, tolerance_px: float, angle_rad: float
):
    normal = np.array([np.cos(angle_rad), np.sin(angle_rad)])
    along, at = np.array([-normal[1], normal[0]]), np.array([60.0, 50.0]) + 0.37 * normal
    image = half_plane(angle_rad, 0.37, blur_px, noise)
    rough = at + 1.7 * normal
    points = edge_points(image, rough - 35 * along, rough + 35 * along, normal, 5.0, FAINT)
    line = fit_line(points, 1.0)
    assert line is not None
    assert abs(line.normal @ (at - line.centre)) < tolerance_px
    assert abs(line.direction @ normal) < 0.003 + noise * 1e-3


CENTRE_PX, RADIUS_PX = np.array([61.3, 48.8]), 11.6


def _drawn() -> np.ndarray:
    """A cyan disc over grey, drawn at sixteen times the size."""
    big = np.full((96 * 16, 128 * 16, 3), (112, 114, 116), np.float32)
    middle = tuple(int(v) for v in np.round((CENTRE_PX + 0.5) * 16))
    cv2.circle(big, middle, round(RADIUS_PX * 16), (178.0, 158.0, 0.0), -1)
    return cv2.resize(big, (128, 96), interpolation=cv2.INTER_AREA)


@pytest.mark.parametrize("blur_px", [0.5, 1.2, 2.0])
@pytest.mark.parametrize(("light", "haze"), [(1.0, 0.0), (0.5, 0.0), (1.0, 0.4)])
def test_size_and_place_through_blur_light_and_haze(blur_px: float, light: float, haze: float) -> None:
    """Within 2 % and 0.15 px, where a threshold of saturation would move the border by a pixel."""
    image = cv2.GaussianBlur(_drawn(), (0, 0), blur_px) * light * (1 - haze) + haze * 205.0
    hsv = to_hsv(np.rint(image).astype(np.uint8))
    mask = np.asarray(255 * (hsv[..., 1] > 60), np.uint8)
    disc = fit_disc(hsv, mask, CENTRE_PX + np.array([0.7, -0.5]), RADIUS_PX * 1.06)
    assert disc is not None
    assert disc.radius_px == pytest.approx(RADIUS_PX, rel=0.02)
    np.testing.assert_allclose(disc.centre_px, CENTRE_PX, atol=0.15)
    assert disc.blur_px == pytest.approx(blur_px, abs=0.5)


NONE = np.zeros((3, 3))


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
        first, second = silhouette_normals(p, d, radius_m)
        axis = axis_of_cylinder(TangentPlane(first, NONE), TangentPlane(second, NONE), radius_m)
        assert axis is not None
        np.testing.assert_allclose(axis.point_m, p, atol=1e-9)
        np.testing.assert_allclose(axis.direction * np.sign(axis.direction @ d), d, atol=1e-9)

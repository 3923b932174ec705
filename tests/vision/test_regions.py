"""Regions: gates, pixel counts and centroids against NumPy; outlines of partly hidden objects."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.profile.segmentation import ColourRegion
from svmdist.transforms import polygon_centroid
from svmdist.vision.regions import CURVE_POINTS, _centroid, complete_outline, find_region
from tests.jacobian import check_jacobian


def rule(min_area_px: int) -> ColourRegion:
    """A region rule of which only the gate matters here."""
    return ColourRegion(hue=(0, 10), min_area_px=min_area_px, components="all", occlusion="none")


def blank() -> np.ndarray:
    return np.zeros((120, 160), np.uint8)


def mean_of_pixels(mask: np.ndarray) -> np.ndarray:
    """Mean x and y of the set pixels by definition: eqs. (1) and (2)."""
    return np.argwhere(mask)[:, ::-1].mean(0)


@pytest.mark.parametrize(("width", "passes"), [(9, False), (10, False), (11, True)])
def test_a_region_passes_its_gate_only_if_larger(width, passes):
    """The paper's "bigger than 50": 45 and 50 pixels are no region, 55 are."""
    mask = blank()
    mask[20:25, 30 : 30 + width] = 255
    region = find_region(mask, rule(min_area_px=50))
    assert (region is not None) is passes
    if region is not None:
        assert region.area_px == 55


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_a_regions_count_and_centroid_are_those_of_its_pixels(seed):
    """For random blobs with all parts above the gate, count and centroid equal NumPy's, within 1e-9 px."""
    rng = np.random.default_rng(seed)
    mask = blank()
    for _ in range(rng.integers(1, 4)):
        centre = (int(rng.integers(0, 160)), int(rng.integers(0, 120)))
        cv2.ellipse(mask, centre, (int(rng.integers(9, 40)), int(rng.integers(9, 30))), 25, 0, 360, 255, -1)
    region = find_region(mask, rule(min_area_px=1))
    assert region.area_px == np.count_nonzero(mask)
    np.testing.assert_allclose(region.centroid_px, mean_of_pixels(mask), atol=1e-9)


CENTRE = np.array([310.0, 236.0])


def _hull(mask: np.ndarray) -> np.ndarray:
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return cv2.convexHull(np.concatenate(contours))


def _covered_egg(rng: np.random.Generator, depth: float) -> tuple[np.ndarray, np.ndarray]:
    """The mask of an irregular egg of which a straight edge covers `depth` of its radius, and its true centroid."""
    theta = np.linspace(0, 2 * np.pi, 1440, endpoint=False)
    size_px = rng.uniform(60, 130)
    radius = size_px * np.ones_like(theta)
    for order, amplitude in ((2, 0.12), (3, 0.03), (4, 0.01)):
        radius += size_px * amplitude * np.cos(order * theta + rng.uniform(0, 2 * np.pi))
    points = CENTRE + rng.uniform(-2, 2, 2) + radius[:, None] * np.stack([np.cos(theta), np.sin(theta)], -1)
    mask = np.zeros((480, 640), np.uint8)
    cv2.fillPoly(mask, [np.round(points * 16).astype(np.int32)], 255, shift=4)
    angle = rng.uniform(0, 2 * np.pi)
    out = np.array([np.cos(angle), np.sin(angle)])
    y, x = np.mgrid[:480, :640]
    edge = (points @ out).max() - depth * size_px
    mask[x * out[0] + y * out[1] > edge] = 0
    return mask, polygon_centroid(points.astype(np.float32))


@pytest.mark.parametrize("depth", [0.0, 0.15, 0.35, 0.6])
def test_the_covariance_holds_the_centroid(depth):
    """Over eggs of any size, cut anywhere, the error is as large as stated: no larger, and no third of it."""
    rng = np.random.default_rng(11)
    nees, spread_px = [], []
    for _ in range(24):
        mask, truth_px = _covered_egg(rng, depth)
        found = complete_outline(mask, _hull(mask))
        error_px = found.centroid_px - truth_px
        nees.append(error_px @ np.linalg.solve(found.covariance_px2, error_px) / 2.0)
        spread_px.append(np.sqrt(np.linalg.eigvalsh(found.covariance_px2)[-1]))
        assert len(found.curve_px) == CURVE_POINTS  # fitted: it is not the hull
    # A border cut exactly has no share of the deviation that a threshold leaves: the mean may be well below one.
    assert 0.05 < np.mean(nees) < 1.5
    assert np.mean(np.array(nees) < 3.0) >= 0.9  # 95 % of chi-squared with two degrees of freedom
    if depth >= 0.35:
        assert np.median(spread_px) > 0.5


def test_the_centroids_jacobian_is_its_derivative():
    """Of a curve of some 100 px with every harmonic in it."""
    order = np.repeat(np.arange(1, 7), 2)
    coefficients = np.concatenate([[100.0], np.random.default_rng(3).normal(scale=10.0 / order**2)])
    check_jacobian(
        lambda step: 1e-3 * _centroid(coefficients + 1e3 * step)[0], _centroid(coefficients)[1], absolute=1e-8
    )

"""The outline of a partly hidden object: what completion gives back, and what it leaves alone."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.profile.settings import OutlineSettings
from svmdist.transforms import polygon_centroid
from svmdist.vision.regions import _any_of, _centroid, _circle, complete_outline

CENTRE = np.array([310.0, 236.0])


def _egg(width_px: int = 640, height_px: int = 480) -> np.ndarray:
    """An egg-shaped mask, no ellipse, and its centroid."""
    theta = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    radius = 110 + 14 * np.cos(2 * theta + 0.4) + 6 * np.cos(3 * theta)
    points = CENTRE + radius[:, None] * np.stack([np.cos(theta), np.sin(theta)], -1)
    mask = np.zeros((height_px, width_px), np.uint8)
    cv2.fillPoly(mask, [np.round(points).astype(np.int32)], 255)
    return mask


def _hull(mask: np.ndarray) -> np.ndarray:
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return cv2.convexHull(np.concatenate(contours))


def _completed_centroid(mask: np.ndarray, hull: np.ndarray) -> np.ndarray:
    return complete_outline(mask, hull).centroid_px


def _pixel_mean(mask: np.ndarray) -> np.ndarray:
    rows, columns = np.nonzero(mask)
    return np.array([columns.mean(), rows.mean()])


def test_a_whole_object_keeps_its_centroid() -> None:
    """Nothing hidden: the centroid is that of the pixels within 0.5 px."""
    mask = _egg()
    np.testing.assert_allclose(_completed_centroid(mask, _hull(mask)), _pixel_mean(mask), atol=0.5)


@settings(deadline=None, max_examples=60)
@given(angle_deg=st.floats(0, 360), offset_px=st.floats(-58, 58), half_width_px=st.floats(15, 30))
def test_a_bar_across_costs_little(angle_deg: float, offset_px: float, half_width_px: float) -> None:
    """An instrument from outside to the middle and beyond moves the centroid by under 3 px.

    The pixels that are left move by 10 to 23 px. A bar that runs along the outline leaves slivers; see below.
    """
    whole = _egg()
    mask = whole.copy()
    direction = np.array([np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))])
    across = np.array([-direction[1], direction[0]])
    start, end = CENTRE + offset_px * across - 60 * direction, CENTRE + offset_px * across + 400 * direction
    corners = [start - half_width_px * across, end - half_width_px * across]
    corners += [end + half_width_px * across, start + half_width_px * across]
    cv2.fillPoly(mask, [np.round(corners).astype(np.int32)], 0)
    assert np.linalg.norm(_completed_centroid(mask, _hull(mask)) - _pixel_mean(whole)) < 3.0


@pytest.mark.parametrize("depth_px", [20, 35])
@pytest.mark.parametrize("side", ["bottom", "left", "right", "top"])
def test_a_covered_side_is_given_back(depth_px: int, side: str) -> None:
    """Where a straight edge covers a side, the hull is off by several times what completion leaves."""
    whole = _egg()
    turned = np.rot90(whole, {"bottom": 0, "left": 1, "top": 2, "right": 3}[side]).copy()
    truth = _pixel_mean(turned)
    mask = turned.copy()
    lowest = int(np.flatnonzero(mask.any(axis=1)).max())
    mask[lowest - depth_px :] = 0
    hull = _hull(mask)
    hull_error = np.linalg.norm(polygon_centroid(hull) - truth)
    error = np.linalg.norm(_completed_centroid(mask, hull) - truth)
    assert error < 0.5 * hull_error
    assert error < 6.0


def test_the_border_of_the_image_is_no_outline() -> None:
    """An object that goes on beyond the image is completed, as far as a smooth curve can."""
    shifted = np.roll(_egg(), -230, axis=1)
    shifted[:, 500:] = 0
    truth = CENTRE - [230.0, 0.0]
    error = np.linalg.norm(_completed_centroid(shifted, _hull(shifted)) - truth)
    assert error < 0.5 * np.linalg.norm(_pixel_mean(shifted) - truth)


def test_too_little_outline_falls_back_to_the_hull() -> None:
    """A triangle has no curved outline at all: its hull's centroid is used."""
    mask = np.zeros((200, 200), np.uint8)
    triangle = np.array([[20, 20], [180, 30], [60, 170]], np.int32)
    cv2.fillPoly(mask, [triangle], 255)
    hull = _hull(mask)
    np.testing.assert_array_equal(_completed_centroid(mask, hull), polygon_centroid(hull))


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
def test_the_covariance_holds_the_centroid(depth: float) -> None:
    """Over eggs of any size, cut anywhere, the error is as large as stated: no larger, and no third of it."""
    rng = np.random.default_rng(11)
    nees, spread_px = [], []
    for _ in range(24):
        mask, truth_px = _covered_egg(rng, depth)
        found = complete_outline(mask, _hull(mask))
        error_px = found.centroid_px - truth_px
        nees.append(error_px @ np.linalg.solve(found.covariance_px2, error_px) / 2.0)
        spread_px.append(np.sqrt(np.linalg.eigvalsh(found.covariance_px2)[-1]))
        assert found.fitted
    # A border cut exactly has no share of the deviation that a threshold leaves: the mean may be well below one.
    assert 0.05 < np.mean(nees) < 1.5
    assert np.mean(np.array(nees) < 3.0) >= 0.9  # 95 % of chi-squared with two degrees of freedom
    if depth >= 0.35:
        assert np.median(spread_px) > 0.5


def _bumpy(seed: int, harmonics: int = 6) -> np.ndarray:
    """Coefficients of a curve of some 100 px with every harmonic in it."""
    rng = np.random.default_rng(seed)
    order = np.repeat(np.arange(1, harmonics + 1), 2)
    return np.concatenate([[100.0], rng.normal(scale=10.0 / order**2)])


def _as_polygon(coefficients: np.ndarray) -> np.ndarray:
    unit, series = _circle(len(coefficients) // 2)
    corners = (coefficients @ series) * unit
    return np.stack([corners.real, corners.imag], -1)


@pytest.mark.parametrize("harmonics", [2, 6, 12])
def test_the_curves_centroid_in_closed_form_is_that_of_its_polygon(harmonics: int) -> None:
    """The few corners that the closed form looks at give what all 360 give, within 1e-10 px of rounding."""
    for seed in range(10):
        coefficients = _bumpy(seed, harmonics)
        expected_px = polygon_centroid(_as_polygon(coefficients))
        np.testing.assert_allclose(_centroid(coefficients)[0], expected_px, atol=1e-10)


def test_the_centroids_jacobian_is_its_derivative() -> None:
    """Central differences of 1e-3 px agree within 1e-8: their own error is of third order."""
    coefficients = _bumpy(3)
    _, J = _centroid(coefficients)
    for k, step in enumerate(1e-3 * np.eye(len(coefficients))):
        numeric = (_centroid(coefficients + step)[0] - _centroid(coefficients - step)[0]) / 2e-3
        np.testing.assert_allclose(J[:, k], numeric, atol=1e-8)


@settings(deadline=None, max_examples=60)
@given(st.lists(st.booleans(), min_size=9, max_size=30), st.integers(0, 4), st.integers(0, 4))
def test_a_flag_reaches_its_neighbours_all_around(flags: list[bool], before: int, after: int) -> None:
    """The sequence is closed: the last place is beside the first."""
    shifted = [np.roll(flags, shift) for shift in range(-after, before + 1)]
    np.testing.assert_array_equal(_any_of(np.array(flags), before, after), np.any(shifted, axis=0))


def test_a_mask_moved_by_whole_pixels_gives_the_same_outline_moved() -> None:
    """Nothing depends on where in the image the object is: to 1e-9 px, which is rounding."""
    mask = _egg()
    mask[:, 330:] = 0
    moved = np.roll(mask, (-31, 17), axis=(0, 1))
    shift_px = np.array([17.0, -31.0])
    here, there = complete_outline(mask, _hull(mask)), complete_outline(moved, _hull(moved))
    np.testing.assert_allclose(there.centroid_px, here.centroid_px + shift_px, atol=1e-9)
    np.testing.assert_allclose(there.curve_px, here.curve_px + shift_px, atol=1e-9)
    np.testing.assert_allclose(there.covariance_px2, here.covariance_px2, atol=1e-9)


def test_settings_decide_what_too_little_is() -> None:
    """An egg cut in half is fitted by default, and not where nine tenths of the outline are asked for."""
    mask = _egg()
    mask[:, 310:] = 0
    strict = OutlineSettings(min_visible_fraction=0.9)
    assert complete_outline(mask, _hull(mask)).fitted
    assert not complete_outline(mask, _hull(mask), strict).fitted

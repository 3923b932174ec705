"""Rectified stereo: disparity surfaces and row offsets, on pairs warped from one texture."""

import cv2
import numpy as np
import pytest

from svmdist.profile.settings import StereoSettings
from svmdist.transforms import Array
from svmdist.vision.disparity import DisparityMap, disparity_map, fit_cells

HEIGHT, WIDTH = 240, 320


def textured(shape: tuple[int, int], contrast: float, sigma_px: float, rng: np.random.Generator) -> Array:
    """A soft texture of so many grey levels about 120."""
    noise = cv2.GaussianBlur(rng.normal(0.0, 1.0, shape), (0, 0), sigma_px)
    return np.asarray(120.0 + contrast * noise / noise.std())


def noisy(image: Array, noise: float, rng: np.random.Generator) -> np.ndarray:
    return np.clip(image + rng.normal(0.0, noise, image.shape), 0, 255).astype(np.uint8)


def _disparity(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A gentle dome of disparities about 27 px."""
    return 27.0 + 1.5 * ((u - 160) / 100) + 2.0 * (1 - ((u - 170) / 110) ** 2 - ((v - 120) / 110) ** 2)


def views_of(disparity, rng: np.random.Generator, rows_px: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A textured pair with a disparity by left pixels, the right view's rows so far below the left one's."""
    texture = textured((HEIGHT, WIDTH + 120), 14.0, 4.0, rng)
    u, v = np.meshgrid(np.arange(WIDTH, dtype=np.float64), np.arange(HEIGHT, dtype=np.float64))
    source = u.copy()
    for _ in range(20):  # u_left = u_right + d(u_left): a contraction, d changes slowly
        source = u + disparity(source, v)
    # The left pixel u shows the texture at u + 60; the right pixel that shows the same is u - d(u, v).
    places = ((u, v), (source, v - rows_px))
    left, right = (
        noisy(cv2.remap(texture, *(one.astype(np.float32) for one in (x + 60, y)), cv2.INTER_CUBIC), 2.0, rng)
        for x, y in places
    )
    return left, right


def matched(left: np.ndarray, right: np.ndarray) -> DisparityMap | None:
    region = cv2.ellipse(np.zeros((HEIGHT, WIDTH), np.uint8), (175, 120), (100, 90), 0, 0, 360, 255, -1)
    masks = region, np.full_like(region, 255)
    return disparity_map((left, right), masks, (1.0, 150.0), StereoSettings(), 10**6)


@pytest.mark.parametrize("rows_px", [0.0, 1.2])
@pytest.mark.parametrize("slope", [0.0, 0.08])
def test_a_surface_is_found_within_its_deviations(rows_px, slope):
    """A dome and a steep plane: most of it is seen, to a tenth of a pixel, and as well as is stated."""
    shape = _disparity if slope == 0.0 else (lambda u, v: 30.0 + slope * (u - 160) - 0.5 * slope * (v - 120))
    found = matched(*views_of(shape, np.random.default_rng(3), rows_px))
    error_px = (found.disparity_px - shape(*np.meshgrid(found.columns_px, found.rows_px)))[found.is_seen]
    assert len(error_px) > 0.7 * np.pi * 95 * 85 / 16
    assert float(np.sqrt(np.mean(error_px**2))) < 0.1
    assert np.mean(np.abs(error_px) < 2.0 * found.std_px[found.is_seen]) > 0.9


def test_a_surface_that_continues_beyond_what_is_seen_says_how_sure_that_is():
    """Quadrics of which a part as wide as a fifth of the view is seen, with noise that neighbours share."""
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 120), np.linspace(-1.0, 1.0, 90))
    covered = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        truth = 27.0 + sum(rng.normal(0.0, 2.0) * x**i * y**j for i in range(3) for j in range(3 - i))
        off = np.hypot(x, y)
        noise = cv2.GaussianBlur(rng.normal(0.0, 1.0, x.shape), (0, 0), 2.0)
        information = np.where(off < 0.2, 4.0, 0.0).astype(np.float32)
        total = (information * (truth + 0.5 * noise / noise.std())).astype(np.float32)
        fitted, variance = fit_cells(information, total)
        covered.append(np.mean(np.abs(fitted - truth)[off > 0.8] < 2.0 * np.sqrt(variance[off > 0.8])))
        assert np.median(variance[off > 0.8]) > 100.0 * np.median(variance[off < 0.2])
    assert np.mean(covered) > 0.5


def test_a_few_cells_between_those_that_are_looked_at_are_fitted():
    information = np.zeros((90, 120), np.float32)
    information[3:5, 7:9] = 1.0
    fitted, variance = fit_cells(information, 27.0 * information)
    assert np.abs(fitted[3:5, 7:9] - 27.0).max() < 0.5
    assert np.isfinite(variance).all()


def test_views_of_different_places_match_nowhere():
    """Neither noise nor another texture of the same kind is taken for a surface."""
    rng = np.random.default_rng(5)
    left, _ = views_of(_disparity, rng)
    other, _ = views_of(_disparity, rng)
    for right in (other, noisy(np.full_like(left, 120), 2.0, rng), np.full_like(left, 120)):
        found = matched(left, right)
        assert found is None or np.count_nonzero(found.is_seen) < 0.1 * np.pi * 100 * 90 / 16

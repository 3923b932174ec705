"""Rectified stereo: disparity surfaces and row offsets, on pairs warped from one texture."""

import cv2
import numpy as np
import pytest

from svmdist.estimation.surface import fit_surface
from svmdist.transforms import Array
from svmdist.vision.stereo import agreed_offset, corresponding_points

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


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_a_smooth_disparity_is_found_to_a_tenth_of_a_pixel(noise):
    """On texture of 14 grey levels with sensor noise, the surface is right to 0.1 px rms inside the region."""
    rng = np.random.default_rng(3)
    texture = textured((HEIGHT, WIDTH + 120), 14.0, 6.0, rng)
    u, v = np.meshgrid(np.arange(WIDTH, dtype=np.float64), np.arange(HEIGHT, dtype=np.float64))
    source = u.copy()
    for _ in range(20):  # u_left = u_right + d(u_left): a contraction, d changes slowly
        source = u + _disparity(source, v)
    # The left pixel u shows the texture at u + 60; the right pixel that shows the same is u - d(u, v).
    left, right = (
        noisy(
            cv2.remap(texture, (at + 60).astype(np.float32), v.astype(np.float32), cv2.INTER_CUBIC),
            noise,
            rng,
        )
        for at in (u, source)
    )
    region = cv2.ellipse(np.zeros((HEIGHT, WIDTH), np.uint8), (175, 120), (100, 90), 0, 0, 360, 255, -1)
    surface = fit_surface(left, right, region, np.full_like(region, 255), 10, 60)
    assert surface is not None
    rows, columns = np.nonzero(cv2.erode(region, np.ones((21, 21), np.uint8)))
    points = np.stack([columns, rows], -1).astype(np.float64)
    error = surface.at(points) - _disparity(points[:, 0], points[:, 1])
    assert float(np.sqrt(np.mean(error**2))) < 0.1


@pytest.mark.parametrize("rows_px", [-3.4, 0.0, 1.5, 5.0])
def test_the_offset_is_found(rows_px):
    """To a tenth of a pixel, and within what is stated of it, of a pair 25 px and some rows apart."""
    rng = np.random.default_rng(0)
    texture = textured((280, 420), 20.0, 3.0, rng)
    moved = np.array([[1.0, 0.0, -25.0], [0.0, 1.0, rows_px]])
    right = cv2.warpAffine(texture, moved, (420, 280), None, cv2.INTER_CUBIC, cv2.BORDER_REFLECT)
    views = (noisy(view, 2.0, rng) for view in (texture, right))
    left_px, right_px = corresponding_points(*views, 8.0, (5.0, 60.0), step=1)
    found = agreed_offset(right_px[:, 1] - left_px[:, 1])
    assert found is not None
    assert found.px == pytest.approx(rows_px, abs=0.1)
    assert abs(found.px - rows_px) < 3.0 * found.std_px

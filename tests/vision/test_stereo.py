"""The disparity surface, on pairs warped from one texture by a known disparity."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.estimation.surface import SMOOTHING_PX, fit_surface

HEIGHT, WIDTH = 240, 320


def _disparity(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A gentle dome of disparities about 27 px."""
    return 27.0 + 1.5 * ((u - 160) / 100) + 2.0 * (1 - ((u - 170) / 110) ** 2 - ((v - 120) / 110) ** 2)


def _pair(noise: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A faint, smooth texture in the left view, and the right view that the disparity makes of it."""
    rng = np.random.default_rng(seed)
    texture = cv2.GaussianBlur(rng.normal(0.0, 1.0, (HEIGHT, WIDTH + 120)), (0, 0), 6.0)
    texture = 120.0 + 14.0 * texture / texture.std()
    u, v = np.meshgrid(np.arange(WIDTH, dtype=np.float64), np.arange(HEIGHT, dtype=np.float64))
    # The left pixel u shows the texture at u + 60; the right pixel that shows the same is u - d(u, v).
    left = cv2.remap(texture, (u + 60).astype(np.float32), v.astype(np.float32), cv2.INTER_CUBIC)
    source = u.copy()
    for _ in range(20):  # u_left = u_right + d(u_left): a contraction, d changes slowly
        source = u + _disparity(source, v)
    right = cv2.remap(texture, (source + 60).astype(np.float32), v.astype(np.float32), cv2.INTER_CUBIC)
    return tuple(  # type: ignore[return-value]
        np.clip(image + rng.normal(0.0, noise, image.shape), 0, 255).astype(np.uint8)
        for image in (left, right)
    )


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_a_smooth_disparity_is_found_to_a_tenth_of_a_pixel(noise: float) -> None:
    """On texture of 14 grey levels with sensor noise, the surface is right to 0.1 px rms inside the region."""
    left, right = _pair(noise, seed=3)
    region = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.ellipse(region, (175, 120), (100, 90), 0, 0, 360, 255, -1)
    surface = fit_surface(left, right, region, np.full_like(region, 255), 10, 60)
    assert surface is not None
    rows, columns = np.nonzero(cv2.erode(region, np.ones((21, 21), np.uint8)))
    points = np.stack([columns, rows], -1).astype(np.float64)
    error = surface.at(points) - _disparity(points[:, 0], points[:, 1])
    assert float(np.sqrt(np.mean(error**2))) < 0.1


def test_the_mismatch_is_that_of_the_noise() -> None:
    """Noise that the alignment's smoothing leaves, over the texture's slope: by so much a pixel seems shifted."""
    region = np.zeros((HEIGHT, WIDTH), np.uint8)
    region[30:210, 80:280] = 255
    smoothing_px = SMOOTHING_PX
    for noise in (2.0, 6.0):
        left, right = _pair(noise, seed=4)
        surface = fit_surface(left, right, region, np.full_like(region, 255), 10, 60)
        assert surface is not None
        # White noise through a Gaussian of σ keeps 1 / (2 √π σ); both views have it, and whole grey levels, of 1/√12.
        kept = noise / (2.0 * np.sqrt(np.pi) * smoothing_px)
        left_over = np.sqrt(2.0) * np.hypot(kept, 1.0 / np.sqrt(12.0))
        wide_px = np.hypot(6.0, smoothing_px)
        slope = 14.0 * (6.0 / wide_px) / (np.sqrt(2.0) * wide_px)
        assert surface.mismatch_px == pytest.approx(left_over / slope, rel=0.2)


def test_a_brighter_right_view_changes_nothing() -> None:
    """A constant difference of brightness between the views moves the surface by less than 0.05 px."""
    left, right = _pair(1.0, seed=5)
    region = np.zeros((HEIGHT, WIDTH), np.uint8)
    region[30:210, 80:280] = 255
    everywhere = np.full_like(region, 255)
    plain = fit_surface(left, right, region, everywhere, 10, 60)
    brighter = fit_surface(left, cv2.add(right, 12), region, everywhere, 10, 60)
    assert plain is not None
    assert brighter is not None
    points = np.array([[120.0, 100.0], [180.0, 120.0], [240.0, 160.0]])
    np.testing.assert_allclose(plain.at(points), brighter.at(points), atol=0.05)


def test_nothing_to_match() -> None:
    """A region of a few pixels gives no surface."""
    left, right = _pair(0.0, seed=1)
    region = np.zeros((HEIGHT, WIDTH), np.uint8)
    region[100:110, 100:110] = 255
    assert fit_surface(left, right, region, region, 10, 60) is None


def test_matching_at_reduced_size_places_the_surface_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether matching is reduced or not, surfaces differ by less than the 0.1 px by which each may be wrong."""
    left, right = _pair(2.0, seed=6)
    region = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.ellipse(region, (175, 120), (100, 90), 0, 0, 360, 255, -1)
    everywhere = np.full_like(region, 255)
    points = np.array([[120.0, 100.0], [180.0, 120.0], [240.0, 160.0]])
    found = []
    for count in (16, 32, 64):
        monkeypatch.setattr("svmdist.vision.stereo.MATCHED_DISPARITIES", count)
        found.append(fit_surface(left, right, region, everywhere, 10, 60))
    for surface in found[:-1]:
        assert surface is not None
        assert found[-1] is not None
        np.testing.assert_allclose(surface.at(points), found[-1].at(points), atol=0.1)

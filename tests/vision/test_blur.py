"""The degradations of Table I: what each does to an image, and which kernels are refused."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.vision.degradations import Blur, apply_blur

RNG = np.random.default_rng(1)
IMAGE = RNG.integers(0, 256, (40, 50, 3)).astype(np.uint8)


@pytest.mark.parametrize("blur", list(Blur))
@pytest.mark.parametrize("kernel_px", [0, -1, 2, 4])
def test_a_kernel_must_be_odd(blur, kernel_px):
    """Even and non-positive kernels have no middle: ValueError says what is expected."""
    with pytest.raises(ValueError, match=f"odd size of at least 1 px, found {kernel_px}"):
        apply_blur(IMAGE, blur, kernel_px)


@pytest.mark.parametrize("blur", list(Blur))
def test_a_blur_keeps_shape_and_type_and_its_input(blur):
    """Every degradation gives uint8 of the same shape and does not write to the image it was given."""
    before = IMAGE.copy()
    blurred = apply_blur(IMAGE, blur, 5)
    assert (blurred.shape, blurred.dtype) == (IMAGE.shape, IMAGE.dtype)
    np.testing.assert_array_equal(IMAGE, before)


@pytest.mark.parametrize("blur", list(Blur))
def test_a_uniform_image_stays_uniform(blur):
    """No degradation invents structure: 77 stays 77 everywhere, border included."""
    uniform = np.full((30, 30, 3), 77, np.uint8)
    np.testing.assert_array_equal(apply_blur(uniform, blur, 5), uniform)


def test_erosion_and_dilation_are_minimum_and_maximum():
    """Inside the image, erosion is the least and dilation the greatest of the kernel's square."""
    windows = np.lib.stride_tricks.sliding_window_view(IMAGE, (3, 3), axis=(0, 1))
    np.testing.assert_array_equal(apply_blur(IMAGE, Blur.EROSION, 3)[1:-1, 1:-1], windows.min((-1, -2)))
    np.testing.assert_array_equal(apply_blur(IMAGE, Blur.DILATION, 3)[1:-1, 1:-1], windows.max((-1, -2)))


def test_the_median_is_the_median():
    """Inside the image, the median filter equals NumPy's median of the kernel's square."""
    windows = np.lib.stride_tricks.sliding_window_view(IMAGE, (5, 5), axis=(0, 1))
    np.testing.assert_array_equal(apply_blur(IMAGE, Blur.MEDIAN, 5)[2:-2, 2:-2], np.median(windows, (-1, -2)))


@pytest.mark.parametrize("kernel_px", [3, 5, 7, 9])
def test_the_gaussian_has_the_stated_sigma(kernel_px):
    """An impulse spreads with σ = 0.3 ((k - 1) / 2 - 1) + 0.8, within 1 grey level of 255.

    Left to choose, OpenCV takes binomial kernels up to 7 px, which are narrower: 5 levels at 3 px.
    """
    impulse = np.zeros((31, 31, 3), np.uint8)
    impulse[15, 15] = 255
    sigma = 0.3 * ((kernel_px - 1) / 2 - 1) + 0.8
    offsets = np.arange(kernel_px) - kernel_px // 2
    weights = np.exp(-(offsets**2) / (2 * sigma**2))
    weights /= weights.sum()
    half = kernel_px // 2
    found = apply_blur(impulse, Blur.GAUSSIAN, kernel_px)[15 - half : 16 + half, 15 - half : 16 + half, 0]
    np.testing.assert_allclose(found, 255 * np.outer(weights, weights), atol=1.0)


def test_the_bilateral_filter_keeps_edges_that_the_gaussian_softens():
    """Across a strong edge the bilateral filter leaves a steeper step than the Gaussian of its size."""
    edge = np.zeros((20, 20, 3), np.uint8)
    edge[:, 10:] = 255
    steps = {
        blur: int(np.diff(apply_blur(edge, blur, 9)[10, :, 0].astype(int)).max())
        for blur in (Blur.GAUSSIAN, Blur.BILATERAL)
    }
    assert steps[Blur.BILATERAL] > 2 * steps[Blur.GAUSSIAN]


def test_none_is_the_clean_row():
    """Without blur the image comes back as it is."""
    np.testing.assert_array_equal(apply_blur(IMAGE, Blur.NONE, 1), IMAGE)

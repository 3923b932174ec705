"""Degradations: the paper's blurs, and those that get worse with severity and depend on nothing but the seed."""

import cv2
import numpy as np
import pytest

from svmdist.samples import Image
from svmdist.vision.degradations import SEVERITIES, Blur, Degradation, apply_blur, degrade


@pytest.mark.parametrize("kernel_px", [3, 5, 7, 9])
def test_the_gaussian_has_the_stated_sigma(kernel_px):
    """An impulse spreads with σ = 0.3 ((k - 1) / 2 - 1) + 0.8, not as OpenCV's binomial kernels, to 1 grey level."""
    impulse = np.zeros((31, 31, 3), np.uint8)
    impulse[15, 15] = 255
    sigma = 0.3 * ((kernel_px - 1) / 2 - 1) + 0.8
    offsets = np.arange(kernel_px) - kernel_px // 2
    weights = np.exp(-(offsets**2) / (2 * sigma**2))
    weights /= weights.sum()
    half = kernel_px // 2
    found = apply_blur(impulse, Blur.GAUSSIAN, kernel_px)[15 - half : 16 + half, 15 - half : 16 + half, 0]
    np.testing.assert_allclose(found, 255 * np.outer(weights, weights), atol=1.0)


def picture() -> Image:
    """A red surface with structure, and a dark bar with sharp edges across it."""
    cells = np.random.default_rng(4).uniform(60, 200, (30, 40, 3)).astype(np.float32)
    image = cv2.resize(cells, (640, 480), interpolation=cv2.INTER_CUBIC)
    image[160:240, 160:] = 30
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("name", list(Degradation))
@pytest.mark.parametrize("seed", [0, 1, 7])
def test_worse_with_severity(name, seed):
    """PSNR falls by 0.5 dB or more from each severity to the next; severity 1 is still a good picture."""
    image = picture()
    psnr = np.array([cv2.PSNR(image, degrade(image, name, severity, seed)) for severity in SEVERITIES])
    assert np.diff(psnr).max() < -0.5
    assert psnr[0] > 14.0
    assert psnr[-1] > 3.0

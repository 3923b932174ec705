"""Degradations get worse with severity, keep the image's form, and depend on nothing but the seed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.samples import Image
from svmdist.vision.degradations import SEVERITIES, Degradation, degrade


def picture(width_px: int = 640, height_px: int = 480) -> Image:
    """A red surface with structure, and a dark bar with sharp edges across it."""
    rng = np.random.default_rng(4)
    cells = rng.uniform(60, 200, (30, 40, 3)).astype(np.float32)
    image = cv2.resize(cells, (width_px, height_px), interpolation=cv2.INTER_CUBIC)
    image[height_px // 3 : height_px // 2, width_px // 4 :] = 30
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("name", list(Degradation))
@pytest.mark.parametrize("seed", [0, 1, 7])
def test_worse_with_severity(name: Degradation, seed: int) -> None:
    """PSNR falls by 0.5 dB or more from each severity to the next; severity 1 is still a good picture."""
    image = picture()
    psnr = np.array([cv2.PSNR(image, degrade(image, name, severity, seed)) for severity in SEVERITIES])
    assert np.diff(psnr).max() < -0.5
    assert psnr[0] > 14.0
    assert psnr[-1] > 3.0


@pytest.mark.parametrize("name", list(Degradation))
@pytest.mark.parametrize("severity", SEVERITIES)
def test_form_stays_and_the_input_is_left_alone(name: Degradation, severity: int) -> None:
    image = picture(401, 303)
    before = image.copy()
    degraded = degrade(image, name, severity, 3)
    assert degraded.shape == image.shape
    assert degraded.dtype == np.uint8
    assert degraded.flags.c_contiguous
    np.testing.assert_array_equal(image, before)
    assert (degraded != image).any()


@pytest.mark.parametrize("name", list(Degradation))
def test_a_seed_settles_all(name: Degradation) -> None:
    """The same seed gives the same image; another one another, where there is chance in it."""
    image = picture()
    first = degrade(image, name, 3, 5)
    np.testing.assert_array_equal(first, degrade(image, str(name), 3, 5))
    is_random = name not in (Degradation.DEFOCUS, Degradation.JPEG)
    assert (first != degrade(image, name, 3, 6)).any() == is_random


@pytest.mark.parametrize("name", [Degradation.DEFOCUS, Degradation.MOTION_BLUR])
def test_blurs_keep_the_light_where_it_is(name: Degradation) -> None:
    """A point keeps its sum and its centre: to 3 % of rounding, and 0.05 px."""
    image = np.zeros((101, 101, 3), np.uint8)
    image[48:53, 48:53] = 250
    blurred = degrade(cv2.resize(image, (1010, 1010), interpolation=cv2.INTER_NEAREST), name, 3, 2)[..., 0]
    assert blurred.sum() == pytest.approx(250 * 50 * 50, rel=0.03)
    rows, columns = np.mgrid[:1010, :1010]
    for axis in (rows, columns):
        assert (axis * blurred.astype(float)).sum() / blurred.sum() == pytest.approx(504.5, abs=0.05)


def test_lengths_grow_with_the_image() -> None:
    """Twice the pixels, twice the blur: the same picture, degraded at half the size, looks the same."""
    large = picture(1280, 960)
    small = cv2.resize(large, (640, 480), interpolation=cv2.INTER_AREA)
    for name in (Degradation.DEFOCUS, Degradation.MOTION_BLUR):
        shrunk = cv2.resize(degrade(large, name, 5, 1), (640, 480), interpolation=cv2.INTER_AREA)
        assert cv2.PSNR(shrunk, degrade(small, name, 5, 1)) > 38.0


def test_what_cannot_be_is_an_error() -> None:
    with pytest.raises(ValueError, match="1 to 5"):
        degrade(picture(), "noise", 6, 0)
    with pytest.raises(ValueError, match="rain"):
        degrade(picture(), "rain", 1, 0)

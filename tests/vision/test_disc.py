"""A disc's size from where its colour has half its strength: blur, light and haze must not move it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.vision.edges import fit_disc
from svmdist.vision.frame_context import to_hsv

CENTRE_PX, RADIUS_PX = np.array([61.3, 48.8]), 11.6


def _drawn(fork: bool = False) -> np.ndarray:
    """A cyan disc over grey, drawn at sixteen times the size; a grey bar over its side where asked for."""
    big = np.full((96 * 16, 128 * 16, 3), (112, 114, 116), np.float32)
    middle = tuple(int(v) for v in np.round((CENTRE_PX + 0.5) * 16))
    cv2.circle(big, middle, round(RADIUS_PX * 16), (178.0, 158.0, 0.0), -1)
    if fork:
        cv2.rectangle(big, (middle[0] + 100, 0), (middle[0] + 160, 1536), (150.0, 150.0, 148.0), -1)
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


def test_what_covers_a_side_does_not_shrink_it() -> None:
    """A bar over a side leaves the size within 3 %; the pixels that are left are a sixth too few."""
    hsv = to_hsv(np.rint(cv2.GaussianBlur(_drawn(fork=True), (0, 0), 0.8)).astype(np.uint8))
    disc = fit_disc(hsv, np.asarray(255 * (hsv[..., 1] > 60), np.uint8), CENTRE_PX, RADIUS_PX)
    assert disc is not None
    assert disc.radius_px == pytest.approx(RADIUS_PX, rel=0.03)


def test_no_disc_where_there_is_no_border() -> None:
    """A plain image of the colour, and a grey one, give none."""
    cyan = to_hsv(np.full((96, 128, 3), (178, 158, 0), np.uint8))
    assert fit_disc(cyan, np.full((96, 128), 255, np.uint8), CENTRE_PX, RADIUS_PX) is None
    grey = to_hsv(np.full((96, 128, 3), 120, np.uint8))
    assert fit_disc(grey, np.zeros((96, 128), np.uint8), CENTRE_PX, RADIUS_PX) is None

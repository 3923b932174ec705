"""Matching of a region: the shift of a pair that is shifted, and nothing where there is nothing to match."""

import cv2
import numpy as np
import pytest

from svmdist.profile.settings import StereoSettings
from svmdist.vision.stereo import match_region

SETTINGS = StereoSettings()
TEXTURE = cv2.GaussianBlur(
    np.random.default_rng(2).integers(0, 256, (240, 400)).astype(np.uint8), (0, 0), 1.5
)


def core(shape: tuple[int, int]) -> np.ndarray:
    """The middle of an image."""
    mask = np.zeros(shape, np.uint8)
    mask[shape[0] // 4 : -shape[0] // 4, shape[1] // 4 : -shape[1] // 4] = 255
    return mask


@pytest.mark.parametrize(
    ("low", "high"), [(0, 32), (0, 64), (-16, 16)], ids=["whole", "reduced", "both ways"]
)
def test_a_shift_is_found(low, high):
    shift_px = 12
    right = np.roll(TEXTURE, -shift_px, 1)
    matches = match_region(TEXTURE, right, core(TEXTURE.shape), low, high, SETTINGS)
    assert matches is not None
    found = np.isfinite(matches.disparity_px)
    assert np.count_nonzero(found) > 0.8 * np.count_nonzero(matches.is_core)
    assert not np.any(found & ~matches.is_core)
    assert float(np.median(matches.disparity_px[found])) == pytest.approx(shift_px, abs=0.2)


def test_an_empty_region_has_no_matches():
    assert match_region(TEXTURE, TEXTURE, np.zeros_like(TEXTURE), 0, 32, SETTINGS) is None


def test_an_image_too_narrow_for_the_search_has_no_matches():
    narrow = np.ascontiguousarray(TEXTURE[:, :40])
    matches = match_region(narrow, narrow, core(narrow.shape), 0, 32, SETTINGS)
    assert matches is None or not np.isfinite(matches.disparity_px).any()

"""Textures by seed, in colours that segmentation can tell apart."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.simulation.bodies.relief import make_relief
from svmdist.simulation.textures import (
    TEXTURE_PX,
    fine_tissue_texture,
    floor_texture,
    smooth_noise,
    tissue_texture,
)


@pytest.mark.parametrize("make", [tissue_texture, floor_texture])
def test_a_seed_settles_the_texture(make: object) -> None:
    assert callable(make)
    first, again, other = (make(np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first.shape == (TEXTURE_PX, TEXTURE_PX, 3)
    assert first.dtype == np.uint8
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.5


def test_tissue_is_saturated_and_the_floor_is_dull() -> None:
    tissue, floor = (
        cv2.cvtColor(make(np.random.default_rng(1)), cv2.COLOR_BGR2HSV)[..., 1]
        for make in (tissue_texture, floor_texture)
    )
    assert np.percentile(tissue, 5) > np.percentile(floor, 95)


def test_relief_adds_speckle_and_keeps_the_colour() -> None:
    """The mean of each channel moves by less than ten levels, and neighbours differ more than before."""
    coarse = tissue_texture(np.random.default_rng(1))
    fine = fine_tissue_texture(
        np.random.default_rng(2), coarse, make_relief(np.random.default_rng(3), 0.0005, 0.022)
    )
    assert np.abs(fine.mean(axis=(0, 1)) - coarse.mean(axis=(0, 1))).max() < 10.0
    roughness = [np.abs(np.diff(image.astype(int)[..., 2], axis=1)).mean() for image in (coarse, fine)]
    assert roughness[1] > roughness[0]


def test_noise_is_about_one_high_and_smooth() -> None:
    noise = smooth_noise(np.random.default_rng(0), 16)
    assert 0.5 < np.abs(noise).max() < 1.6  # a cubic overshoots its cells
    assert np.abs(np.diff(noise, axis=0)).max() < 0.1  # 64 px to a cell

"""The height of the relief: its amplitude is what was asked for, and it fades out towards the outline."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.simulation.bodies.relief import OCTAVES, make_relief


@pytest.mark.parametrize("seed", range(3))
def test_the_largest_height_is_the_amplitude(seed: int) -> None:
    relief = make_relief(np.random.default_rng(seed), 0.0004, 0.022)
    xy_m = np.random.default_rng(0).uniform(-0.02, 0.02, (2000, 2))
    height_m = relief.height_m(xy_m, np.zeros(2000))
    assert np.abs(height_m).max() == pytest.approx(0.0004, rel=1e-12)
    assert height_m.min() < 0.0 < height_m.max()


def test_it_is_gone_at_the_outline() -> None:
    relief = make_relief(np.random.default_rng(1), 0.0004, 0.022)
    xy_m = np.random.default_rng(0).uniform(-0.02, 0.02, (500, 2))
    radius = np.linspace(0.0, 1.0, 500)
    height_m = relief.height_m(xy_m, radius)
    assert height_m[-1] == 0.0
    assert np.abs(height_m[radius > 0.97]).max() < 0.05 * np.abs(height_m).max()  # smoothly: 3 t² of t < 0.11


def test_no_wave_is_shorter_than_the_shortest_octave() -> None:
    relief = make_relief(np.random.default_rng(2), 0.0004, 0.022)
    wavelengths_m = 2.0 * np.pi / np.linalg.norm(relief.wave_vectors_rad_m, axis=1)
    assert wavelengths_m.min() >= min(length for length, _ in OCTAVES) * (1.0 - 1e-12)

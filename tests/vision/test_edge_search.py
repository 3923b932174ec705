"""Straight edges across profiles: found where they are, whatever their sign, and not in texture."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.vision.edge_lines import points_near, profiles_across, straightest

HEIGHT, WIDTH, EDGE_PX = 80, 200, 40.3
FEET = np.stack([np.arange(20.0, 180.0, 1.5), np.full(107, 38.0)], -1)
DOWN = np.array([0.0, 1.0])


def step(above: int, below: int) -> np.ndarray:
    """An image whose rows change from one grey to another at `EDGE_PX`, blurred by a pixel."""
    rows = np.arange(HEIGHT)[:, None]
    share = 0.5 * (1.0 + np.tanh((rows - EDGE_PX) / 1.2))
    grey = np.repeat(above + (below - above) * share, WIDTH, 1)
    return np.repeat(grey[..., None], 3, 2).round().astype(np.uint8)


@pytest.mark.parametrize(("above", "below"), [(40, 120), (120, 40)])
def test_a_step_of_either_sign_is_found_to_a_tenth_of_a_pixel(above: int, below: int) -> None:
    profiles = profiles_across(step(above, below), FEET, DOWN, 12.0, 1.2, None)
    line = straightest(profiles, np.linspace(0.0, 1.0, len(FEET)), 8.0, 4.0)
    assert line is not None
    assert line.part == 1.0
    where = line.at(np.linspace(0.0, 1.0, len(FEET)))
    found = points_near(profiles, where, 4.0, 1.0)
    assert np.isfinite(found).mean() > 0.9
    assert np.nanmedian(found) == pytest.approx(EDGE_PX - 38.0, abs=0.1)


def test_texture_is_no_straight_edge() -> None:
    """Noise that is smooth over three pixels: no line of it is as distinct as a faint step."""
    import cv2

    rng = np.random.default_rng(5)
    noise = cv2.GaussianBlur(rng.normal(0.0, 60.0, (HEIGHT, WIDTH, 3)), (0, 0), 3.0)
    image = np.clip(110.0 + noise, 0, 255).astype(np.uint8)
    profiles = profiles_across(image, FEET, DOWN, 12.0, 1.2, None)
    line = straightest(profiles, np.linspace(0.0, 1.0, len(FEET)), 8.0, 4.0)
    assert line is None or line.part < 0.5

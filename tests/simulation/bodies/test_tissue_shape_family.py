"""Tissue of another family than the profile's: its waves, its profile from rim to apex, and what stays the same."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.simulation.organ import make_tissue_shape


def test_an_ellipsoid_and_the_dome_are_the_two_ends() -> None:
    """Height over the radius: the dome's (1 - r^2.3)^0.62 at 0, (1 - r²)^½ at 1."""
    radius = np.linspace(0.0, 1.0, 50)
    for share, expected in ((0.0, (1 - radius**2.3) ** 0.62), (1.0, np.sqrt(1 - radius**2))):
        shape = make_tissue_shape(np.random.default_rng(1), 0.0, share)
        np.testing.assert_allclose(shape.profile(radius), expected, atol=1e-12)
        assert shape.is_convex


@pytest.mark.parametrize("strength", [0.1, 0.3])
def test_waves_change_height_and_outline_by_the_strength(strength: float) -> None:
    """At most by it, and somewhere by nearly all of it; the outline by a fifth."""
    xy_m = np.stack(np.meshgrid(np.linspace(-0.03, 0.03, 80), np.linspace(-0.03, 0.03, 80)), -1).reshape(
        -1, 2
    )
    angle = np.linspace(0.0, 2 * np.pi, 720)
    shape = make_tissue_shape(np.random.default_rng(2), strength, 0.0)
    raised, stretched = shape.raised(xy_m) - 1.0, shape.stretched(angle) - 1.0
    assert np.abs(raised).max() == pytest.approx(strength, rel=1e-9)
    assert 0.3 * 0.2 * strength < np.abs(stretched).max() <= 0.2 * strength + 1e-12
    assert not shape.is_convex


def test_the_same_stream_gives_the_same_waves() -> None:
    angle = np.linspace(0.0, 2 * np.pi, 90)
    weak, strong = (make_tissue_shape(np.random.default_rng(5), strength, 0.0) for strength in (0.1, 0.2))
    np.testing.assert_allclose(2.0 * (weak.stretched(angle) - 1.0), strong.stretched(angle) - 1.0, atol=1e-12)

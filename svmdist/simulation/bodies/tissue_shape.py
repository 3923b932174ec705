"""Tissue that is not of the profile's family: other curves from rim to apex, and broad random waves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.transforms import Array

GAUGE_EXPONENT, HEIGHT_EXPONENT = 2.3, 0.62
"""Of the ideal world's dome: height (1 - r^2.3)^0.62 over the normalised radius r."""
ELLIPSOID_EXPONENTS = 2.0, 0.5
OUTLINE_ORDERS = (3, 4, 5, 6)
OUTLINE_SHARE = 0.2
"""Of the strength: waves of 6 % of the outline's radius at a strength of 0.3."""
WAVE_COUNT = 10
WAVELENGTHS_M = (0.014, 0.032)
"""Half of the organ to the whole of it: lobes, where relief has folds and vessels of 3.5 to 14 mm."""


@dataclass(frozen=True)
class TissueShape:
    """How an organ departs from the dome.

    `ellipsoid` goes from the dome's exponents (0) to an ellipsoid's (1). `height` is the largest share by which waves
    change the height, `outline` that by which they change the outline's radius; wave vectors have shape (n, 2) in
    rad/m, phases shape (n,), and the outline's amplitudes and phases shape (4,).
    """

    ellipsoid: float
    height: float
    outline: float
    wave_vectors_rad_m: Array
    phases_rad: Array
    outline_weights: Array
    outline_phases_rad: Array

    @property
    def is_convex(self) -> bool:
        """Whether the organ stays convex: no waves."""
        return not (self.height or self.outline)

    def profile(self, radius: Array) -> Array:
        """Height over the plane, 0 to 1, at normalised radii, shape (n,): 1 at the apex."""
        a, b = (
            ideal + self.ellipsoid * (other - ideal)
            for ideal, other in zip((GAUGE_EXPONENT, HEIGHT_EXPONENT), ELLIPSOID_EXPONENTS, strict=True)
        )
        return np.asarray((1.0 - radius**a) ** b)

    def stretched(self, angle: Array) -> Array:
        """By what the outline's radius is multiplied at angles, shape (n,)."""
        waves = sum(
            weight * np.cos(order * angle + phase)
            for order, weight, phase in zip(
                OUTLINE_ORDERS, self.outline_weights, self.outline_phases_rad, strict=True
            )
        )
        return np.asarray(1.0 + self.outline * waves)

    def raised(self, xy_m: Array) -> Array:
        """By what the height is multiplied at points, shape (n, 2); shape (n,)."""
        waves = np.cos(xy_m @ self.wave_vectors_rad_m.T + self.phases_rad).sum(axis=1)
        return np.asarray(1.0 + self.height * waves / np.abs(waves).max())


def make_tissue_shape(rng: np.random.Generator, strength: float, ellipsoid: float) -> TissueShape:
    """Draw the shape of a random stream; the same stream gives the same waves at every strength."""
    length_m = rng.uniform(*WAVELENGTHS_M, WAVE_COUNT)
    heading_rad = rng.uniform(0.0, 2.0 * np.pi, WAVE_COUNT)
    vectors = 2.0 * np.pi / length_m[:, None] * np.stack([np.cos(heading_rad), np.sin(heading_rad)], -1)
    weights = rng.uniform(0.5, 1.0, len(OUTLINE_ORDERS))
    return TissueShape(
        ellipsoid,
        strength,
        strength * OUTLINE_SHARE,
        vectors,
        rng.uniform(0.0, 2.0 * np.pi, WAVE_COUNT),
        weights / weights.sum(),
        rng.uniform(0.0, 2.0 * np.pi, len(OUTLINE_ORDERS)),
    )

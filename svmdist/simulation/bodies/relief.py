"""Relief of one seed: bumps, folds and raised vessels on the organ's surface, smooth and band-limited.

Bumps and folds are sums of plane waves, so that no wavelength is shorter than the shortest octave's;
vessels are ridges with a Gaussian section. The organ's mesh resolves both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.geometry.closest import point_to_segment
from svmdist.transforms import Array

OCTAVES = ((0.014, 1.0), (0.007, 0.5), (0.0035, 0.25))
"""Wavelength in m and weight. Half the wavelength, half the height: slopes stay alike, as in real surfaces."""
WAVES_PER_OCTAVE = 8
FOLD_SPREAD_RAD = 0.6
"""Waves of the longest octave run within this of one direction, which makes folds of what would be bumps."""

VESSEL_COUNT = 4
VESSEL_HALF_WIDTH_M = 0.0007
VESSEL_WEIGHT = 1.5
VESSEL_STEP_M = 0.0015
VESSEL_STEP_COUNT = 18

FADE_FROM = 0.72
"""The relief is complete up to this normalised radius (0 at the apex, 1 on the outline), and fades to 0 at 1."""


@dataclass(frozen=True)
class Relief:
    """What lies on the smooth dome: its amplitude in m, the plane waves, and the vessels' courses.

    `wave_vectors_rad_m` has shape (n, 2), `phases_rad` and `weights` shape (n,); a vessel is a polyline of
    shape (k, 2) in m. All in the tissue frame.
    """

    amplitude_m: float
    wave_vectors_rad_m: Array
    phases_rad: Array
    weights: Array
    vessels_m: tuple[Array, ...]

    def height_m(self, xy_m: Array, radius: Array) -> Array:
        """Height over the smooth dome at points, shape (n, 2), whose normalised radius has shape (n,); shape (n,).

        The largest of all points, up or down, is the amplitude.
        """
        waves = np.cos(xy_m @ self.wave_vectors_rad_m.T + self.phases_rad) @ self.weights
        nearest_m = np.full(len(xy_m), np.inf)
        for course_m in self.vessels_m:
            pair = point_to_segment(xy_m[:, None], course_m[:-1], course_m[1:])
            nearest_m = np.minimum(nearest_m, pair.distance.min(axis=1))
        ridges = np.exp(-0.5 * (nearest_m / VESSEL_HALF_WIDTH_M) ** 2)
        t = np.clip((1.0 - radius) / (1.0 - FADE_FROM), 0.0, 1.0)
        raw = (waves + VESSEL_WEIGHT * ridges) * t * t * (3.0 - 2.0 * t)
        return np.asarray(self.amplitude_m * raw / np.abs(raw).max())


def make_relief(rng: np.random.Generator, amplitude_m: float, half_size_m: float) -> Relief:
    """Draw the relief of a random stream for an organ of about that half size."""
    vectors, weights = [], []
    fold_rad = rng.uniform(0.0, np.pi)
    for order, (wavelength_m, weight) in enumerate(OCTAVES):
        spread_rad = FOLD_SPREAD_RAD if order == 0 else np.pi / 2
        heading_rad = fold_rad + rng.uniform(-spread_rad, spread_rad, WAVES_PER_OCTAVE)
        # From this octave's wavelength up to nearly the next longer one's.
        length_m = wavelength_m * rng.uniform(1.0, 1.7, WAVES_PER_OCTAVE)
        vectors.append(
            2.0 * np.pi / length_m[:, None] * np.stack([np.cos(heading_rad), np.sin(heading_rad)], -1)
        )
        weights.append(np.full(WAVES_PER_OCTAVE, weight * np.sqrt(2.0 / WAVES_PER_OCTAVE)))
    phases_rad = rng.uniform(0.0, 2.0 * np.pi, len(OCTAVES) * WAVES_PER_OCTAVE)
    vessels_m = tuple(_course(rng, half_size_m) for _ in range(VESSEL_COUNT))
    return Relief(amplitude_m, np.concatenate(vectors), phases_rad, np.concatenate(weights), vessels_m)


def _course(rng: np.random.Generator, half_size_m: float) -> Array:
    """A winding line across the organ."""
    start_m = rng.uniform(-0.7, 0.7, 2) * half_size_m
    # Towards the middle, more or less, so that it crosses the organ.
    heading_rad = np.arctan2(-start_m[1], -start_m[0]) + rng.normal(0.0, 0.5)
    turns_rad = np.cumsum(rng.normal(0.0, 0.16, VESSEL_STEP_COUNT)) + heading_rad
    steps_m = VESSEL_STEP_M * np.stack([np.cos(turns_rad), np.sin(turns_rad)], -1)
    return np.asarray(np.vstack([start_m, start_m + np.cumsum(steps_m, axis=0)]))

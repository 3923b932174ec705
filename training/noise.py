"""Random fields, shape (h, w) and float32, that tissue, smoke and blood are made of."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float32]
"""Shape (h, w)."""
Canvas = NDArray[np.float32]
"""A picture in BGR, shape (h, w, 3), levels 0 to 255."""
Size = tuple[int, int]
"""(h, w) in px."""


def smooth(rng: np.random.Generator, size: Size, cells: float) -> Field:
    """Smooth noise of unit variance with `cells` bumps over the width."""
    columns = max(2, round(cells))
    rows = max(2, round(cells * size[0] / size[1]))
    coarse = rng.standard_normal((rows + 1, columns + 1)).astype(np.float32)
    return np.asarray(cv2.resize(coarse, (size[1], size[0]), interpolation=cv2.INTER_CUBIC), np.float32)


def fractal(rng: np.random.Generator, size: Size, cells: float, octaves: int = 4, gain: float = 0.5) -> Field:
    """Noise of several scales: each has twice the bumps of the one before, and `gain` times its amplitude."""
    field = smooth(rng, size, cells)
    amplitude, total = 1.0, 1.0
    for octave in range(1, octaves):
        amplitude *= gain
        total += amplitude**2
        field += amplitude * smooth(rng, size, min(cells * 2.0**octave, size[1] / 2))
    return np.asarray(field / np.sqrt(total), np.float32)


def lobules(rng: np.random.Generator, size: Size, count: int) -> Field:
    """Cushions as fat has them: 1 in the middle of each, falling towards the creases between them."""
    seeds = np.full(size, 255, np.uint8)
    seeds[rng.integers(0, size[0], count), rng.integers(0, size[1], count)] = 0
    away = np.asarray(cv2.distanceTransform(seeds, cv2.DIST_L2, 3), np.float32)
    return np.asarray(1.0 - (away / (2.2 * float(away.mean()) + 1e-3)) ** 2, np.float32)


def shading(height: Field, steepness: float, light: NDArray[np.float64]) -> tuple[Field, Field]:
    """Cosines to the light and to its mirror image of a relief seen from above, both clipped to [0, 1].

    `height` has unit variance, `steepness` is the relief's amplitude in px, `light` the direction to the lamp,
    shape (3,).
    """
    slope_x = steepness * cv2.Sobel(height, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    slope_y = steepness * cv2.Sobel(height, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    norm = np.sqrt(1.0 + slope_x**2 + slope_y**2)
    half = light + np.array([0.0, 0.0, 1.0])
    half = half / np.linalg.norm(half)
    diffuse = (light[2] - light[0] * slope_x - light[1] * slope_y) / norm
    mirror = (half[2] - half[0] * slope_x - half[1] * slope_y) / norm
    return np.clip(diffuse, 0.0, 1.0).astype(np.float32), np.clip(mirror, 0.0, 1.0).astype(np.float32)

"""Textures of one seed: smooth on the scale of pixels, so that frames stay small as lossless PNG."""

from __future__ import annotations

import cv2
import numpy as np

from svmdist.samples import Image
from svmdist.transforms import Array

TEXTURE_PX = 1024
TEXTURE_SPAN_M = 0.07
"""The tissue's texture covers a square of this side about the tissue frame's origin."""


def tissue_texture(rng: np.random.Generator) -> Image:
    """Red-pink mottling with a few faint, branching vessels; BGR, shape (1024, 1024, 3)."""
    base = np.array([92.0, 84.0, 214.0])
    paler = np.array([38.0, 36.0, 18.0])
    mottling = 0.9 * smooth_noise(rng, 8) + 0.3 * smooth_noise(rng, 17)
    colour = base + mottling[..., None] * paler
    vessels = _vessels(rng)[..., None]
    colour += vessels * np.array([-22.0, -34.0, -48.0])
    return _as_image(colour)


def floor_texture(rng: np.random.Generator) -> Image:
    """Dull beige-brown folds, low in saturation; BGR, shape (1024, 1024, 3)."""
    base = np.array([104.0, 112.0, 122.0])
    folds = smooth_noise(rng, 7, stretch=2.2)
    return _as_image(base + folds[..., None] * np.array([13.0, 14.0, 14.0]))


def smooth_noise(rng: np.random.Generator, cell_count: int, stretch: float = 1.0) -> Array:
    """Noise with `cell_count` bumps across the texture, mean 0 and about -1 to 1, shape (1024, 1024).

    `stretch` makes the bumps longer along x.
    """
    columns = max(2, round(cell_count / stretch))
    cells = rng.uniform(-1.0, 1.0, (cell_count, columns))
    return np.asarray(cv2.resize(cells, (TEXTURE_PX, TEXTURE_PX), interpolation=cv2.INTER_CUBIC), np.float64)


def _vessels(rng: np.random.Generator) -> Array:
    """Dark branching lines with soft edges, 0 to 1, shape (1024, 1024)."""
    canvas = np.zeros((TEXTURE_PX, TEXTURE_PX), np.uint8)
    for _ in range(5):
        start = rng.uniform(0.25, 0.75, 2) * TEXTURE_PX
        _grow_vessel(canvas, rng, start, rng.uniform(0.0, 2.0 * np.pi), width_px=9.0)
    return cv2.GaussianBlur(canvas, (0, 0), 4.0).astype(np.float64) / 255.0


def _grow_vessel(
    canvas: Image, rng: np.random.Generator, start_px: Array, heading_rad: float, width_px: float
) -> None:
    position = start_px
    for step in range(16):
        following = position + 24.0 * np.array([np.cos(heading_rad), np.sin(heading_rad)])
        ends = [tuple(round(float(value) * 16) for value in point) for point in (position, following)]
        cv2.line(canvas, ends[0], ends[1], 255, max(1, round(width_px)), cv2.LINE_AA, shift=4)
        position = following
        heading_rad += rng.normal(0.0, 0.22)
        width_px *= 0.93
        if width_px > 5.0 and step in (4, 9):
            turn = rng.choice([-0.8, 0.8])
            _grow_vessel(canvas, rng, position, heading_rad + turn, width_px * 0.7)


def _as_image(colour: Array) -> Image:
    return np.clip(np.rint(colour), 0, 255).astype(np.uint8)

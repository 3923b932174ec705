"""What lies behind the instruments: tissue, phantoms, cloth and paper, and the noise that they are made of."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Size = tuple[int, int]
"""(h, w) in px. Fields have this shape and are float32; pictures have a third axis, BGR, with levels from 0 to 255."""
# Weight, red level, and green and blue over red, as (least, most) of each: what tissue looks like in a white light.
TISSUES = (
    (0.22, (75, 185), (0.20, 0.45), (0.20, 0.50)),  # liver, muscle
    (0.28, (130, 235), (0.35, 0.60), (0.35, 0.65)),  # red and pink organs
    (0.16, (170, 245), (0.55, 0.80), (0.50, 0.85)),  # pale serosa
    (0.14, (180, 245), (0.62, 0.90), (0.28, 0.65)),  # fat
    (0.06, (170, 240), (0.75, 0.95), (0.70, 0.98)),  # fascia, nearly white
    (0.08, (70, 165), (0.35, 0.80), (0.45, 1.10)),  # gall bladder, spleen, veins: brown to violet
    (0.06, (45, 110), (0.08, 0.30), (0.08, 0.35)),  # blood
)


def fractal(rng: np.random.Generator, size: Size, cells: float, octaves: int = 4, gain: float = 0.5) -> Array:
    """Noise of unit variance: `cells` bumps over the width, then twice as many with `gain` times the amplitude."""
    field = np.zeros(size, np.float32)
    amplitudes = gain ** np.arange(octaves)
    for octave, amplitude in enumerate(amplitudes):
        columns = max(2.0, min(cells * 2.0**octave, size[1] / 2))
        rows = max(2, round(columns * size[0] / size[1]))
        coarse = rng.standard_normal((rows + 1, round(columns) + 1)).astype(np.float32)
        field += amplitude * cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(field / np.sqrt(np.sum(amplitudes**2)), np.float32)


def _shading(rng: np.random.Generator, height: Array, steepness: float) -> tuple[Array, Array]:
    """Cosines to a lamp near the camera and to its mirror image, in [0, 1], of a relief seen from above.

    `height` has unit variance, `steepness` is the relief's amplitude in px.
    """
    light = np.array([*rng.normal(0.0, 0.35, 2), 1.0])
    light /= np.linalg.norm(light)
    half = light + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half)
    slope_x = steepness * cv2.Sobel(height, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    slope_y = steepness * cv2.Sobel(height, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    norm = np.sqrt(1.0 + slope_x**2 + slope_y**2)
    diffuse, mirror = (
        np.clip((to[2] - to[0] * slope_x - to[1] * slope_y) / norm, 0.0, 1.0) for to in (light, half)
    )
    return diffuse.astype(np.float32), mirror.astype(np.float32)


def background(rng: np.random.Generator, size: Size) -> tuple[Array, Array]:
    """A picture without instruments, and which of its pixels are tissue: tissue mostly, else what other rooms have."""
    kind = rng.choice(["tissue", "phantom", "cloth"], p=[0.74, 0.1, 0.16])
    if kind == "phantom":
        return _phantom(rng, size), np.ones(size, bool)
    of, other, seldom = (_tissue, _cloth, 0.1) if kind == "tissue" else (_cloth, _tissue, 0.3)
    scene, is_tissue = of(rng, size), np.full(size, kind == "tissue")
    if rng.random() < seldom:  # gauze on tissue, or tissue on a drape
        patch = fractal(rng, size, rng.uniform(1.2, 3.0), 3, 0.3) > rng.uniform(0.2, 1.2)
        scene[patch] = other(rng, size)[patch]
        is_tissue ^= patch
    return scene, is_tissue


def tissue_colour(rng: np.random.Generator) -> Array:
    """A colour of one kind of tissue in BGR, shape (3,)."""
    weights = [weight for weight, *_ in TISSUES]
    _, red, green, blue = TISSUES[int(rng.choice(len(TISSUES), p=weights))]
    level = rng.uniform(*red)
    return np.array([level * rng.uniform(*blue), level * rng.uniform(*green), level], np.float32)


def _tissue(rng: np.random.Generator, size: Size) -> Array:
    """Organs side by side, each with its colour and texture; folds, vessels, wet highlights, dark cavities."""
    height = fractal(rng, size, rng.uniform(1.5, 5.0), int(rng.integers(2, 6)), rng.uniform(0.3, 0.6))
    scene = np.empty((*size, 3), np.float32)
    scene[:] = tissue_colour(rng)
    for _ in range(int(rng.integers(0, 5))):
        edge = fractal(rng, size, rng.uniform(1.2, 4.0), 3, rng.uniform(0.2, 0.5)) - rng.normal(0.5, 0.5)
        scene += _soft(edge, np.exp(rng.uniform(0.5, 3.5))) * (tissue_colour(rng) - scene)
    scene *= 1.0 + rng.uniform(0.02, 0.16) * fractal(rng, size, rng.uniform(8, 50), 3)[..., None]
    if rng.random() < 0.6:  # vessels, darker and redder or bluer than what they run over
        lines = np.zeros(size, np.uint8)
        for _ in range(int(rng.integers(2, 14))):
            level, width = int(rng.integers(90, 255)), int(rng.integers(1, 4))
            cv2.polylines(lines, [wandering(rng, size, 0.25)], False, level, width, cv2.LINE_AA)
        share = cv2.GaussianBlur(lines, (0, 0), rng.uniform(0.5, 1.5)).astype(np.float32)[..., None] / 255.0
        colour = np.array([rng.uniform(0.3, 0.9), rng.uniform(0.25, 0.6), rng.uniform(0.5, 0.95)], np.float32)
        scene *= 1.0 - rng.uniform(0.2, 0.8) * share * (1.0 - colour)
    diffuse, mirror = _shading(rng, height, rng.uniform(2.0, 30.0) * size[1] / 350)
    scene *= (rng.uniform(0.15, 0.6) + diffuse)[..., None] * rng.uniform(0.7, 1.0)
    if rng.random() < 0.8:  # it is wet
        wet = mirror ** rng.uniform(40, 400) * np.clip(0.5 + fractal(rng, size, 12.0, 1), 0.0, 1.5)
        scene += (rng.uniform(60, 500) * wet * rng.uniform(0.2, 1.0))[..., None]
    if rng.random() < 0.35:
        deep = fractal(rng, size, rng.uniform(1.5, 4.0), 1) - rng.uniform(0.3, 1.2)
        scene *= 1.0 - rng.uniform(0.4, 0.95) * _soft(deep, rng.uniform(2.0, 8.0))
    return np.clip(scene, 0.0, 255.0)


def _soft(field: Array, sharpness: float) -> Array:
    """0 to 1 over the field's change of sign, shape (h, w, 1)."""
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(sharpness * field, -30.0, 30.0))), np.float32)[..., None]


def wandering(rng: np.random.Generator, size: Size, bend: float) -> Array:
    """Points, shape (24, 2) of int32, of a line that turns by about `bend` rad a step."""
    headings = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0.0, bend, 24))
    steps = np.stack([np.cos(headings), np.sin(headings)], -1) * size[1] * rng.uniform(0.005, 0.03)
    return np.asarray(np.rint(rng.uniform(0.0, 1.0, 2) * size[::-1] + np.cumsum(steps, axis=0)), np.int32)


def _phantom(rng: np.random.Generator, size: Size) -> Array:
    """Silicone: one colour with grooves, dull."""
    level = rng.uniform(90, 225)
    colour = level * np.array([rng.uniform(0.35, 0.85), rng.uniform(0.4, 0.85), 1.0], np.float32)
    creased = np.abs(fractal(rng, size, rng.uniform(1.5, 4.0), 2, 0.4)) ** rng.uniform(0.6, 1.5)
    diffuse, mirror = _shading(rng, creased.astype(np.float32), rng.uniform(2, 25))
    shade = rng.uniform(0.2, 0.6) + diffuse + rng.uniform(0.0, 0.5) * mirror**60
    return np.asarray(np.clip(colour * shade[..., None] * 0.8, 0.0, 255.0), np.float32)


def _cloth(rng: np.random.Generator, size: Size) -> Array:
    """Drapes, foam, gauze and paper: any colour, often blue, green or white, woven or plain."""
    hue = rng.choice([rng.uniform(90, 125), rng.uniform(60, 95), rng.uniform(0, 180)])
    saturation = rng.uniform(0, 60) if rng.random() < 0.6 else rng.uniform(60, 220)
    pixel = np.array([[[hue, saturation, rng.uniform(70, 245)]]]).astype(np.uint8)
    colour = cv2.cvtColor(pixel, cv2.COLOR_HSV2BGR)[0, 0].astype(np.float32)
    height = fractal(rng, size, rng.uniform(2.0, 6.0), 3, 0.5)
    shade = 0.3 + 0.75 * _shading(rng, height, rng.uniform(0, 25))[0]
    if rng.random() < 0.5:
        y, x = np.mgrid[: size[0], : size[1]].astype(np.float32)
        angle, period = rng.uniform(0, np.pi), rng.uniform(3.0, 9.0)
        one, two = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        weave = np.sin(2 * np.pi * one / period) * np.sin(2 * np.pi * two / period)
        shade = shade * (1.0 + rng.uniform(0.03, 0.2) * weave)
    return np.asarray(np.clip(colour * shade[..., None], 0.0, 255.0), np.float32)

"""What lies behind the instruments: tissue, phantoms, paper, cloth and gauze, and the noise that they are made of."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Size = tuple[int, int]
"""(h, w) in px. Fields have this shape and are float32; pictures have a third axis, BGR, with levels from 0 to 255."""
# Red level, and green and blue over red, as (least, most) of each: what tissue looks like in a white light.
TISSUE_COLOURS = (
    ((75, 185), (0.20, 0.45), (0.20, 0.50)),  # liver, muscle
    ((130, 235), (0.35, 0.60), (0.35, 0.65)),  # red and pink organs
    ((170, 245), (0.55, 0.80), (0.50, 0.85)),  # pale serosa
    ((180, 245), (0.62, 0.90), (0.28, 0.65)),  # fat
    ((170, 240), (0.75, 0.95), (0.70, 0.98)),  # fascia, nearly white
    ((70, 165), (0.35, 0.80), (0.45, 1.10)),  # gall bladder, spleen, veins: brown to violet
    ((45, 110), (0.08, 0.30), (0.08, 0.35)),  # blood
)
WEIGHTS = (0.22, 0.28, 0.16, 0.14, 0.06, 0.08, 0.06)


def smooth(rng: np.random.Generator, size: Size, cells: float) -> Array:
    """Smooth noise of unit variance with `cells` bumps over the width."""
    columns, rows = max(2, round(cells)), max(2, round(cells * size[0] / size[1]))
    coarse = rng.standard_normal((rows + 1, columns + 1)).astype(np.float32)
    return cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC)


def fractal(rng: np.random.Generator, size: Size, cells: float, octaves: int = 4, gain: float = 0.5) -> Array:
    """Noise of several scales: each has twice the bumps of the one before, and `gain` times its amplitude."""
    field = smooth(rng, size, cells)
    amplitude, total = 1.0, 1.0
    for octave in range(1, octaves):
        amplitude *= gain
        total += amplitude**2
        field += amplitude * smooth(rng, size, min(cells * 2.0**octave, size[1] / 2))
    return np.asarray(field / np.sqrt(total), np.float32)


def lobules(rng: np.random.Generator, size: Size, count: int) -> Array:
    """Cushions as fat has them: 1 in the middle of each, falling towards the creases between them."""
    seeds = np.full(size, 255, np.uint8)
    seeds[rng.integers(0, size[0], count), rng.integers(0, size[1], count)] = 0
    away = cv2.distanceTransform(seeds, cv2.DIST_L2, 3)
    return np.asarray(1.0 - (away / (2.2 * float(away.mean()) + 1e-3)) ** 2, np.float32)


def shading(height: Array, steepness: float, light: Array) -> tuple[Array, Array]:
    """Cosines to the light, of direction (3,), and to its mirror image of a relief seen from above, in [0, 1].

    `height` has unit variance, `steepness` is the relief's amplitude in px.
    """
    slope_x = steepness * cv2.Sobel(height, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    slope_y = steepness * cv2.Sobel(height, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    norm = np.sqrt(1.0 + slope_x**2 + slope_y**2)
    half = light + np.array([0.0, 0.0, 1.0])
    half = half / np.linalg.norm(half)
    diffuse = (light[2] - light[0] * slope_x - light[1] * slope_y) / norm
    mirror = (half[2] - half[0] * slope_x - half[1] * slope_y) / norm
    return np.clip(diffuse, 0.0, 1.0).astype(np.float32), np.clip(mirror, 0.0, 1.0).astype(np.float32)


def background(rng: np.random.Generator, size: Size) -> tuple[Array, Array]:
    """A picture without instruments, and which of its pixels are tissue: tissue mostly, else what other rooms have."""
    kind = rng.choice(["tissue", "phantom", "paper", "cloth"], p=[0.74, 0.1, 0.08, 0.08])
    if kind == "tissue":
        scene, is_tissue = _tissue(rng, size), np.ones(size, bool)
        if rng.random() < 0.1:
            gauze = _patch(rng, size)
            scene[gauze] = _cloth(rng, size)[gauze]
            is_tissue &= ~gauze
        return scene, is_tissue
    if kind == "phantom":
        return _phantom(rng, size), np.ones(size, bool)
    scene = _paper(rng, size) if kind == "paper" else _cloth(rng, size)
    is_tissue = np.zeros(size, bool)
    if rng.random() < 0.3:
        is_tissue = _patch(rng, size)
        scene[is_tissue] = _tissue(rng, size)[is_tissue]
    return scene, is_tissue


def tissue_colour(rng: np.random.Generator) -> Array:
    """A colour of one kind of tissue in BGR, shape (3,)."""
    red, green, blue = TISSUE_COLOURS[int(rng.choice(len(TISSUE_COLOURS), p=WEIGHTS))]
    level = rng.uniform(*red)
    return np.array([level * rng.uniform(*blue), level * rng.uniform(*green), level], np.float32)


def _tissue(rng: np.random.Generator, size: Size) -> Array:
    """Organs side by side, each with its colour and texture; folds, vessels, wet highlights, dark cavities."""
    height = fractal(rng, size, rng.uniform(1.5, 5.0), int(rng.integers(2, 6)), rng.uniform(0.3, 0.6))
    scene = _organs(rng, size)
    if rng.random() < 0.3:  # lobes of fat
        lobes = lobules(rng, size, int(rng.integers(60, 600)))
        where = _soft(smooth(rng, size, 3.0) - rng.uniform(0.0, 1.0), 6.0)
        height = height + 0.25 * rng.random() * lobes * where
        scene *= 1.0 + (0.25 * rng.random() * where * (lobes - 0.6))[..., None]
    scene *= 1.0 + rng.uniform(0.02, 0.16) * fractal(rng, size, rng.uniform(8, 50), 3)[..., None]
    if rng.random() < 0.6:
        _vessels(rng, scene)
    light = _light(rng, 0.35)
    diffuse, mirror = shading(height, rng.uniform(2.0, 30.0) * size[1] / 350, light)
    scene *= (rng.uniform(0.15, 0.6) + diffuse)[..., None] * rng.uniform(0.7, 1.0)
    if rng.random() < 0.8:  # it is wet
        wet = mirror ** rng.uniform(40, 400) * np.clip(0.5 + smooth(rng, size, 12.0), 0.0, 1.5)
        scene += (rng.uniform(60, 500) * wet * rng.uniform(0.2, 1.0))[..., None]
    if rng.random() < 0.35:
        deep = _soft(smooth(rng, size, rng.uniform(1.5, 4.0)) - rng.uniform(0.3, 1.2), rng.uniform(2.0, 8.0))
        scene *= 1.0 - rng.uniform(0.4, 0.95) * deep[..., None]
    return np.clip(scene, 0.0, 255.0)


def _light(rng: np.random.Generator, spread: float) -> Array:
    """A direction to the lamp, shape (3,)."""
    light = np.array([rng.normal(0.0, spread), rng.normal(0.0, spread), 1.0])
    return np.asarray(light / np.linalg.norm(light))


def _organs(rng: np.random.Generator, size: Size) -> Array:
    scene = np.empty((*size, 3), np.float32)
    scene[:] = tissue_colour(rng)
    for _ in range(int(rng.integers(0, 5))):
        edge = fractal(rng, size, rng.uniform(1.2, 4.0), 3, rng.uniform(0.2, 0.5)) - rng.normal(0.5, 0.5)
        share = _soft(edge, float(np.exp(rng.uniform(0.5, 3.5))))[..., None]
        scene += share * (tissue_colour(rng) - scene)
    tint = fractal(rng, size, rng.uniform(3, 12), 3)[..., None] * rng.normal(0.0, 0.06, 3).astype(np.float32)
    return np.asarray(scene * (1.0 + tint), np.float32)


def _vessels(rng: np.random.Generator, scene: Array) -> None:
    """Branching lines, darker and redder or bluer than what they run over."""
    lines = np.zeros(scene.shape[:2], np.uint8)
    extent = np.array(scene.shape[1::-1], float)
    for _ in range(int(rng.integers(2, 14))):
        start, heading = rng.uniform(0.0, 1.0, 2) * extent, rng.uniform(0.0, 2 * np.pi)
        headings = heading + np.cumsum(rng.normal(0.0, 0.25, 24))
        steps = np.stack([np.cos(headings), np.sin(headings)], -1) * extent[0] * rng.uniform(0.008, 0.03)
        points = np.rint(start + np.cumsum(steps, axis=0)).astype(np.int32)
        level, width = int(rng.integers(90, 255)), int(rng.integers(1, 4))
        cv2.polylines(lines, [points], False, level, width, cv2.LINE_AA)
    share = cv2.GaussianBlur(lines, (0, 0), rng.uniform(0.5, 1.5)).astype(np.float32)[..., None] / 255.0
    colour = np.array([rng.uniform(0.3, 0.9), rng.uniform(0.25, 0.6), rng.uniform(0.5, 0.95)], np.float32)
    scene *= 1.0 - rng.uniform(0.2, 0.8) * share * (1.0 - colour)


def _phantom(rng: np.random.Generator, size: Size) -> Array:
    """Silicone: one colour with grooves, dull."""
    level = rng.uniform(90, 225)
    colour = level * np.array([rng.uniform(0.35, 0.85), rng.uniform(0.4, 0.85), 1.0], np.float32)
    height = fractal(rng, size, rng.uniform(1.5, 4.0), 2, 0.4)
    creased = np.asarray(np.abs(height) ** rng.uniform(0.6, 1.5), np.float32)  # where the noise changes sign
    light = _light(rng, 0.4)
    diffuse, mirror = shading(creased, rng.uniform(2, 25), light)
    shade = rng.uniform(0.2, 0.6) + diffuse + rng.uniform(0.0, 0.5) * mirror**60
    return np.asarray(np.clip(colour * shade[..., None] * 0.8, 0.0, 255.0), np.float32)


def _paper(rng: np.random.Generator, size: Size) -> Array:
    """Pale or grey, hardly coloured, perhaps with printed lines and dots."""
    base = rng.uniform(70, 245) * np.array([rng.uniform(0.8, 1.05), 1.0, rng.uniform(0.9, 1.1)], np.float32)
    texture = 0.05 * smooth(rng, size, 4) + rng.uniform(0.0, 0.04) * smooth(rng, size, 90)
    scene = np.ascontiguousarray(base * (1.0 + texture[..., None]), np.float32)
    for _ in range(int(rng.integers(0, 8))):
        ink = rng.uniform(10, 220, 3).tolist()
        first, second = np.rint(rng.uniform(0.0, 1.0, (2, 2)) * size[::-1]).astype(int).tolist()
        if rng.random() < 0.5:
            cv2.line(scene, first, second, ink, int(rng.integers(1, 4)), cv2.LINE_AA)
        else:
            radius = int(rng.integers(2, 2 + size[1] // 12))
            cv2.circle(scene, first, radius, ink, cv2.FILLED if rng.random() < 0.5 else 2, cv2.LINE_AA)
    return scene


def _cloth(rng: np.random.Generator, size: Size) -> Array:
    """Drapes, foam and gauze: any colour, often blue, green or white, woven or plain."""
    hue = rng.choice([rng.uniform(90, 125), rng.uniform(60, 95), rng.uniform(0, 180)])
    saturation = rng.uniform(0, 60) if rng.random() < 0.45 else rng.uniform(60, 220)
    pixel = np.array([[[hue, saturation, rng.uniform(70, 245)]]]).astype(np.uint8)
    colour = cv2.cvtColor(pixel, cv2.COLOR_HSV2BGR)[0, 0].astype(np.float32)
    height = fractal(rng, size, rng.uniform(2.0, 6.0), 3, 0.5)
    light = _light(rng, 0.4)
    shade = 0.3 + 0.75 * shading(height, rng.uniform(2, 25), light)[0]
    if rng.random() < 0.6:
        y, x = np.mgrid[: size[0], : size[1]].astype(np.float32)
        angle, period = rng.uniform(0, np.pi), rng.uniform(3.0, 9.0)
        one, two = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        weave = np.sin(2 * np.pi * one / period) * np.sin(2 * np.pi * two / period)
        shade = shade * (1.0 + rng.uniform(0.03, 0.2) * weave)
    return np.asarray(np.clip(colour * shade[..., None], 0.0, 255.0), np.float32)


def _patch(rng: np.random.Generator, size: Size) -> Array:
    """A part of the picture with a wavy outline."""
    return fractal(rng, size, rng.uniform(1.2, 3.0), 3, 0.3) > rng.uniform(0.2, 1.2)


def _soft(field: Array, sharpness: float) -> Array:
    """0 to 1 over the field's change of sign."""
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(sharpness * field, -30.0, 30.0))), np.float32)

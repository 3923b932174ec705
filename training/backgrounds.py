"""What is behind the instruments, drawn: organs, drapes, training boxes, and what may be taken for instruments."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from training.instruments import OTHER, TISSUE
from training.parts import Array, Part, Size, fractal, lay, painted

# Weight, red level, and green and blue over red, as (least, most) of each, in a white light
TISSUES = (
    (0.42, (75, 235), (0.20, 0.60), (0.20, 0.65)),  # liver, muscle, red and pink organs
    (0.10, (170, 245), (0.55, 0.80), (0.50, 0.85)),  # pale serosa
    (0.20, (170, 245), (0.62, 0.95), (0.28, 0.98)),  # fat; fascia, nearly white
    (0.16, (70, 200), (0.35, 1.05), (0.45, 1.10)),  # gall bladder, spleen, veins: brown to violet and grey
    (0.12, (45, 150), (0.05, 0.25), (0.06, 0.30)),  # blood
)
PLASTIC_PAPER_CLOTH = (
    (0.45, (15, 250), (0.85, 1.15), (0.80, 1.25)),  # grey, white
    (0.20, (10, 120), (1.00, 2.00), (1.20, 5.00)),  # blue
    (0.20, (10, 120), (1.20, 4.00), (0.90, 2.00)),  # green
    (0.15, (40, 250), (0.10, 1.00), (0.10, 1.50)),  # any
)


def background(rng: np.random.Generator, size: Size) -> tuple[Array, Array]:
    """A picture without instruments, and where it is TISSUE or OTHER: tissue mostly, else what other rooms have."""
    is_tissue = rng.random() < 0.66
    scene = _surroundings(rng, size, is_tissue=is_tissue)
    if not is_tissue or rng.random() < 0.75:
        return scene, np.full(size, TISSUE if is_tissue else OTHER, np.uint8)
    # Tissue or silicone as a pad with straight sides that lies on a drape or a table
    around = _surroundings(rng, size, is_tissue=False) * rng.uniform(0.15, 1.0)
    begin, end = (rng.uniform([left, 0.3], [left + 0.25, 0.7]) * size[::-1] for left in (0.05, 0.7))
    half, end_half = (size[0] * rng.uniform(0.25, 0.5, 2)).tolist()
    return around, lay(rng, around, [Part(begin, end, half, end_half, TISSUE, scene)], 1.0)


def colour(rng: np.random.Generator, colours: tuple[tuple[Any, ...], ...]) -> Array:
    """One at random, in BGR, shape (3,)."""
    _, red, green, blue = colours[rng.choice(len(colours), p=[weight for weight, *_ in colours])]
    return np.asarray(rng.uniform(*red) * np.array([rng.uniform(*blue), rng.uniform(*green), 1.0]), np.float32)


def _surroundings(rng: np.random.Generator, size: Size, *, is_tissue: bool) -> Array:
    """Organs side by side, or silicone; or drapes, foam, gauze, paper, the board of a training box, what lies on it."""
    colours = TISSUES if is_tissue else PLASTIC_PAPER_CLOTH
    scene = np.tile(colour(rng, colours), (*size, 1)).astype(np.float32)
    if rng.random() < 0.2:
        return scene
    is_bare = rng.random() < 0.3  # nearly without texture, as silicone and near or blurred tissue are
    height = fractal(rng, size, rng.uniform(1.5, 5.0), 1 if is_bare else int(rng.integers(2, 6)), rng.uniform(0.3, 0.6))
    for _ in range(int(rng.integers(6)) if is_tissue else 0):  # an organ lies over what was there, and shades it
        edge = fractal(rng, size, rng.uniform(1.2, 4.0), 3, rng.uniform(0.1, 0.5)) - rng.normal(0.5, 0.5)
        over = 1.0 / (1.0 + np.exp(-np.clip(float(np.exp(rng.uniform(0.5, 4.0))) * edge, -30.0, 30.0)))
        height += over * rng.uniform(0.0, 3.0) * np.sqrt(np.clip(edge, 0.0, None))
        scene *= 1.0 - rng.uniform(0.0, 0.9) * cv2.GaussianBlur(over, (0, 0), 0.02 * size[1])[..., None]
        scene += over[..., None] * (colour(rng, colours) - scene)
    for _ in range(int(rng.integers(1, 4)) if rng.random() < 0.33 else 0):  # from side to side; else what lies there
        _bar(rng, scene, colour(rng, colours), 0.14 if is_tissue else 0.3, 1.5, 0.4 if is_tissue else 0.1)
    for _ in range(int(rng.integers(2, 25)) if not is_tissue and rng.random() < 0.45 else 0):
        _bar(rng, scene, colour(rng, colours), 0.1, 0.1, 0.0)
    if not is_bare:
        scene *= (1.0 + rng.uniform(0.02, 0.16) * fractal(rng, size, rng.uniform(2, 60), 3))[..., None]
    if is_tissue and not is_bare:
        vessels = np.exp(-((fractal(rng, size, rng.uniform(2, 8), 3) / rng.uniform(0.01, 0.08)) ** 2))[..., None]
        scene *= 1.0 - rng.uniform(0.0, 0.8) * vessels * rng.uniform([0.1, 0.4, 0.05], [0.7, 0.75, 0.5])
    # A relief of some px, seen from above, in the light of a lamp near the camera
    steepness, tilt = rng.uniform(2.0, 30.0) * size[1] / 350, rng.normal(0.0, 0.35, 2)
    slopes = np.stack([steepness * cv2.Sobel(height, cv2.CV_32F, x, 1 - x, ksize=3, scale=1 / 8) for x in (1, 0)])
    diffuse, mirror = (  # it mirrors the lamp where its own tilt is half of the lamp's
        np.clip((1.0 - np.tensordot(to, slopes, 1)) / np.sqrt((1.0 + (slopes**2).sum(0)) * (1.0 + to @ to)), 0.0, 1.0)
        for to in (tilt, tilt / 2.0)
    )
    scene *= (rng.uniform(0.15, 0.6) + diffuse)[..., None] * rng.uniform(0.7, 1.0)
    if is_tissue and rng.random() < 0.8:  # it is wet
        wet = mirror ** rng.uniform(40, 400) * np.clip(0.5 + fractal(rng, size, 12.0, 1), 0.0, 1.5)
        scene += (rng.uniform(30, 400) * wet)[..., None]
    return np.asarray(np.clip(scene, 0.0, 255.0), np.float32)


def _bar(rng: np.random.Generator, scene: Array, bgr: Array, widest: float, reach: float, bend: float) -> None:
    """Draw bowel, a vessel, a fold; a strip, a peg, a cable. Half-width, length and bend are shares of the width."""
    size, heading = scene.shape[:2], rng.uniform(0.0, 2.0 * np.pi)
    half, length = size[1] * np.exp(rng.uniform(*np.log([[0.01, 0.7 * reach], [widest, 1.4 * reach]])))
    begin, surface = rng.uniform(-0.2, 1.2, 2) * size[::-1], painted(rng, bgr, 0.15, 3.0, rng.uniform(0.0, 150.0))
    end, end_half = begin + length * np.array([np.cos(heading), np.sin(heading)]), half * np.exp(rng.normal(0.0, 0.4))
    bar = Part(begin, end, half, end_half, 1, surface, rng.uniform(-0.2, 1.0), size[1] * rng.normal(0.0, bend))
    lay(rng, scene, [bar], rng.uniform(0.3, 3.0))

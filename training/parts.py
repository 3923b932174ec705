"""What pictures are drawn with: noise, and straight or curved parts that have a painted surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Size = tuple[int, int]
"""(h, w) in px. Fields have this shape and are float32; pictures have a third axis, BGR, with levels from 0 to 255."""
ROWS = 40  # of a surface, from one side to the other


def fractal(rng: np.random.Generator, size: Size, cells: float, octaves: int = 4, gain: float = 0.5) -> Array:
    """Noise of unit variance: `cells` bumps over the width, then twice as many with `gain` times the amplitude."""
    field = np.zeros(size, np.float32)
    for octave in range(octaves):
        columns = max(2.0, min(cells * 2.0**octave, size[1] / 2))
        shape = max(2, round(columns * size[0] / size[1])) + 1, round(columns) + 1
        field += gain**octave * cv2.resize(rng.standard_normal(shape), size[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(field / np.sqrt(sum(gain ** (2 * octave) for octave in range(octaves))), np.float32)


def painted(rng: np.random.Generator, bgr: Array, contrast: float, length: float, glare: float) -> Array:
    """A round surface by a lamp at its beginning, with streaks and glare, (ROWS, columns, 3); `length` in widths."""
    size = int(np.clip(ROWS * length, 2, 2000)), ROWS
    across, ambient = np.linspace(-1.0, 1.0, ROWS)[:, None], rng.uniform(0.2, 0.9)
    shade = ambient + (1.0 - ambient) * np.sqrt(1.0 - across**2)
    for share, cells in ((1.0, (int(rng.integers(4, 14)), 1)), (0.5, (1, int(rng.integers(2, 9))))):
        noise = cv2.resize(rng.standard_normal(cells).astype(np.float32), size)
        shade = shade * np.clip(1.0 + share * contrast * noise, 0.15, 2.3)
    shade *= np.linspace(1.0 + rng.exponential(0.5), 1.0, size[0])
    shine = rng.uniform(0.0, glare) * np.exp(-(((across - rng.uniform(-0.75, 0.75)) / rng.uniform(0.03, 0.25)) ** 2))
    return np.clip(bgr * shade[..., None] + shine[..., None], 0.0, 400.0).astype(np.float32)


@dataclass(frozen=True)
class Part:
    """A piece between two points in px, (2,), each with its half-width; round, or hollow, at its end."""

    begin: Array
    end: Array
    begin_half: float
    end_half: float
    label: int
    surface: Array | None  # without one it is a window
    round_end: float = 0.0
    bend: float = 0.0  # px from the straight line to its mid-line, a parabola


def draw(canvas: Array, labels: Array, parts: list[Part]) -> None:
    """Draw parts over what is there; a pixel is a part's where that covers half of it or more."""
    limits, behind = np.array(labels.shape[::-1]), canvas.copy()
    for part in parts:
        reach = max(part.begin_half, part.end_half) * (1.5 + abs(part.round_end)) + abs(part.bend) + 2.0
        low = np.clip(np.floor(np.minimum(part.begin, part.end) - reach), 0, limits).astype(int)
        high = np.clip(np.ceil(np.maximum(part.begin, part.end) + reach) + 1, 0, limits).astype(int)
        if (low >= high).any():
            continue
        y, x = np.mgrid[low[1] : high[1], low[0] : high[0]].astype(np.float32)
        length = float(np.linalg.norm(part.end - part.begin))
        axis, x, y = (part.end - part.begin) / length, x - part.begin[0], y - part.begin[1]
        along = (x * axis[0] + y * axis[1]) / length
        share = np.clip(along, 0.0, 1.0)
        slope = 4.0 * part.bend / length * (1.0 - 2.0 * share)
        half = (part.begin_half + (part.end_half - part.begin_half) * share) * np.hypot(1.0, slope)
        across = (y * axis[0] - x * axis[1] - 4.0 * part.bend * share * (1.0 - share)) / half
        bulge = part.round_end * half * np.sqrt(np.clip(1.0 - across**2, 0.0, 1.0))
        # The part of the pixel that is covered: one px wide ramps over the sides and over both ends
        covered = np.clip((1.0 - np.abs(across)) * half + 0.5, 0.0, 1.0)
        covered *= np.clip(np.minimum(along * length, (1.0 - along) * length + bulge) + 0.5, 0.0, 1.0)
        region = np.s_[low[1] : high[1], low[0] : high[0]]
        colours = behind[region]
        if part.surface is not None:
            down, right = (np.array(part.surface.shape[:2]) - 1).tolist()
            at = np.stack([right * share, down * np.clip(0.5 * across + 0.5, 0.0, 1.0)]).astype(np.float32)
            colours = cv2.remap(part.surface, at[0], at[1], cv2.INTER_LINEAR)
        canvas[region] += covered[..., None] * (colours - canvas[region])
        labels[region][covered >= 0.5] = part.label


def lay(rng: np.random.Generator, scene: Array, parts: list[Part], blur_px: float) -> Array:
    """Draw parts over a scene, blurred by a Gaussian, often with a shadow; gives their labels, 0 where none is."""
    drawn, labels, half = scene.copy(), np.zeros(scene.shape[:2], np.uint8), parts[0].end_half
    draw(drawn, labels, parts)
    mask = (labels > 0).astype(np.float32)
    if rng.random() < 0.6:
        shift = np.array([[1.0, 0.0, rng.normal(0.0, 1.2) * half], [0.0, 1.0, rng.normal(0.3, 1.2) * half]])
        soft = cv2.GaussianBlur(mask, (0, 0), rng.uniform(0.5, 1.0 + 0.6 * half))
        scene *= 1.0 - rng.uniform(0.1, 0.75) * cv2.warpAffine(soft, shift, labels.shape[::-1])[..., None]
    share = cv2.GaussianBlur(mask, (0, 0), blur_px)[..., None]
    scene += share * (cv2.GaussianBlur(drawn, (0, 0), blur_px) - scene)
    return labels


def lettering(rng: np.random.Generator, size: Size, heights: tuple[float, float]) -> Array:
    """A word at random, from 0 to 1, shape (h, w, 1); `heights` of its letters are shares of h, from least to most."""
    ink, height = np.zeros(size, np.uint8), size[0] * rng.uniform(*heights)
    word = "".join(rng.choice(list("ABCDEFGHILMNOPRSTUVXZ 0123456789:"), int(rng.integers(1, 13))))
    at = (rng.uniform([0.0, 0.5], [0.8, 1.0]) * size[::-1]).astype(int).tolist()
    cv2.putText(ink, word, at, cv2.FONT_HERSHEY_SIMPLEX, height / 22, 255, int(rng.integers(1, 4)), cv2.LINE_AA)
    return ink[..., None] / np.float32(255.0)

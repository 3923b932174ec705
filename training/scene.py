"""One random picture with its exact labels, made from a seed."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from training.backgrounds import background
from training.camera import BORDERS, film, light_and_colour, picture_area
from training.instruments import (
    OTHER,
    TISSUE,
    Labels,
    Part,
    cords,
    draw,
    instrument,
    silhouette,
)
from training.noise import Canvas, Size, fractal

WIDTH, HEIGHT = 256, 192
"""The network's input in px. Pictures of any aspect are stretched to it, as `method = "onnx"` does."""
MIDDLE = 127.5
"""Its pixels are (level - MIDDLE) / MIDDLE."""
ASPECTS = (4 / 3, 4 / 3, 5 / 4, 16 / 9, 16 / 9, 1.0, 1.5)
BORDER_WEIGHTS = (0.45, 0.18, 0.1, 0.12, 0.15)


@dataclass(frozen=True)
class Layers:
    """A scene before light and camera.

    `behind` is the picture without instruments, `bgr` with them, shape (h, w, 3); `labels`, shape (h, w), says which
    class each pixel is of, the border left out, which is where `picture`, shape (h, w), is 0.
    """

    behind: Canvas
    bgr: Canvas
    labels: Labels
    picture: NDArray[np.uint8]


def layers(
    rng: np.random.Generator, size: Size, count: int | None = None, border: str | None = None
) -> Layers:
    """Draw background, shadows, instruments, blood and what covers their tips; `count` instruments, else 0 to 3."""
    ground = background(rng, size)
    count = int(rng.choice(4, p=[0.1, 0.42, 0.38, 0.1])) if count is None else count
    behind = ground.bgr
    if rng.random() < 0.35:
        draw(behind, np.zeros(size, np.uint8), cords(rng, size))
    scene = behind.copy()
    labels = np.where(ground.tissue, TISSUE, OTHER).astype(np.uint8)
    around = np.asarray(scene.mean((0, 1)), np.float32)
    for _ in range(count):
        parts = instrument(rng, size, around)
        if rng.random() < 0.6:
            _shadow(rng, scene, parts)
        before = labels.copy()
        draw(scene, labels, parts)
        if rng.random() < 0.45:
            _stain(rng, scene, labels > TISSUE)
        if rng.random() < 0.12:
            _cover_tip(rng, scene, labels, before, behind, parts)
    if rng.random() < 0.3:
        _thread(rng, scene, labels)
    border = str(rng.choice(BORDERS, p=BORDER_WEIGHTS)) if border is None else border
    return Layers(behind, scene, labels, picture_area(rng, size, border))


def render(seed: int) -> tuple[NDArray[np.uint8], Labels]:
    """A picture, shape (HEIGHT, WIDTH, 3) in BGR, and the class of each pixel, shape (HEIGHT, WIDTH).

    The same seed gives the same picture.
    """
    rng = np.random.default_rng(seed)
    height = int(rng.integers(200, 290))
    made = layers(rng, (height, round(height * float(rng.choice(ASPECTS)))))
    image = film(rng, light_and_colour(rng, made.bgr), made.picture)
    labels = np.where(made.picture > 0, made.labels, OTHER).astype(np.uint8)
    if rng.random() < 0.15:  # recorded small, and enlarged
        less = rng.uniform(0.4, 0.9)
        image = np.asarray(cv2.resize(image, None, fx=less, fy=less, interpolation=cv2.INTER_AREA), np.uint8)
    shrinks = image.shape[1] >= WIDTH and image.shape[0] >= HEIGHT
    how = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    shown = cv2.resize(image, (WIDTH, HEIGHT), interpolation=how)
    told = cv2.resize(labels, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST_EXACT)
    return np.asarray(shown, np.uint8), np.asarray(told, np.uint8)


def _shadow(rng: np.random.Generator, scene: Canvas, parts: list[Part]) -> None:
    """The instrument's shadow on what is behind it, beside it, soft or hard."""
    size = (scene.shape[0], scene.shape[1])
    half = parts[0].end_half
    shift = np.float32([[1, 0, rng.normal(0.0, 1.2) * half], [0, 1, rng.normal(0.3, 1.2) * half]])  # type: ignore[arg-type]
    moved = cv2.warpAffine(silhouette(size, parts), np.asarray(shift), size[::-1])
    soft = cv2.GaussianBlur(moved, (0, 0), rng.uniform(0.5, 1.0 + 0.6 * half)).astype(np.float32)
    scene *= 1.0 - rng.uniform(0.1, 0.75) * soft[..., None] / 255.0


def _stain(rng: np.random.Generator, scene: Canvas, where: NDArray[np.bool_]) -> None:
    """Blood, or what is like it, on instruments: they stay what they are."""
    size = (scene.shape[0], scene.shape[1])
    spots = fractal(rng, size, rng.uniform(6.0, 25.0), 3) - rng.uniform(0.3, 1.8)
    share = np.clip(4.0 * spots, 0.0, 1.0) * where * rng.uniform(0.4, 1.0)
    red = rng.uniform(35, 170)
    blood = red * np.array([rng.uniform(0.05, 0.4), rng.uniform(0.05, 0.35), 1.0], np.float32)
    scene += share[..., None].astype(np.float32) * (blood - scene)


def _cover_tip(
    rng: np.random.Generator,
    scene: Canvas,
    labels: Labels,
    before: Labels,
    behind: Canvas,
    parts: list[Part],
) -> None:
    """Tissue in front of the end of an instrument, which grasps it or is behind it."""
    size = labels.shape
    tip, half = parts[-1].end, parts[0].end_half
    y, x = np.mgrid[: size[0], : size[1]].astype(np.float32)
    radius = half * rng.uniform(0.6, 2.5)
    away = np.hypot(x - tip[0], y - tip[1]) / radius + 0.25 * fractal(rng, (size[0], size[1]), 8.0, 2)
    over = away < 1.0
    shift = rng.integers(-size[1] // 4, size[1] // 4, 2)
    moved = np.roll(behind, tuple(shift), axis=(0, 1))
    shade = np.clip(1.3 - 0.5 * away, 0.5, 1.2)[..., None]
    scene[over] = (moved * shade)[over]
    labels[over] = before[over]


def _thread(rng: np.random.Generator, scene: Canvas, labels: Labels) -> None:  # noqa: ARG001
    """A suture or a needle: thin, of any colour, and no instrument."""
    start = rng.uniform(0.0, 1.0, 2) * scene.shape[1::-1]
    headings = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0.0, 0.3, 20))
    steps = np.stack([np.cos(headings), np.sin(headings)], -1) * scene.shape[1] * rng.uniform(0.005, 0.03)
    points = np.rint(start + np.cumsum(steps, axis=0)).astype(np.int32)
    cv2.polylines(scene, [points], False, rng.uniform(0, 255, 3).tolist(), 1, cv2.LINE_AA)

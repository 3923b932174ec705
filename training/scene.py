"""One random picture with its exact labels, made from a seed: layers of a scene, light, camera and video link."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from training.instruments import OTHER, TISSUE, Part, cords, draw, instrument, silhouette
from training.textures import Array, Size, background, fractal

WIDTH, HEIGHT = 256, 192
"""The network's input in px. Pictures of any aspect are stretched to it, as `method = "onnx"` does."""
MIDDLE = 127.5
"""Its pixels are (level - MIDDLE) / MIDDLE."""
ASPECTS = (4 / 3, 4 / 3, 5 / 4, 16 / 9, 16 / 9, 1.0, 1.5)
BORDERS = ("none", "circle", "octagon", "rectangle", "cut circle")
BORDER_WEIGHTS = (0.45, 0.18, 0.1, 0.12, 0.15)


@dataclass(frozen=True)
class Layers:
    """A scene before light and camera.

    `bgr` is the picture, shape (h, w, 3); `labels`, shape (h, w), says which class each pixel is of, the border left
    out, which is where `picture`, shape (h, w), is 0.
    """

    bgr: Array
    labels: Array
    picture: Array


def layers(
    rng: np.random.Generator, size: Size, count: int | None = None, border: str | None = None
) -> Layers:
    """Draw background, shadows, instruments, blood and what covers their tips; `count` instruments, else 0 to 3."""
    behind, is_tissue = background(rng, size)
    count = int(rng.choice(4, p=[0.1, 0.42, 0.38, 0.1])) if count is None else count
    if rng.random() < 0.35:
        draw(behind, np.zeros(size, np.uint8), cords(rng, size))
    scene = behind.copy()
    labels = np.where(is_tissue, TISSUE, OTHER).astype(np.uint8)
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
        _thread(rng, scene)
    border = str(rng.choice(BORDERS, p=BORDER_WEIGHTS)) if border is None else border
    return Layers(scene, labels, picture_area(rng, size, border))


def render(seed: int) -> tuple[Array, Array]:
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
        image = cv2.resize(image, None, fx=less, fy=less, interpolation=cv2.INTER_AREA)
    shrinks = image.shape[1] >= WIDTH and image.shape[0] >= HEIGHT
    how = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    shown = cv2.resize(image, (WIDTH, HEIGHT), interpolation=how)
    return shown, cv2.resize(labels, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST_EXACT)


def _shadow(rng: np.random.Generator, scene: Array, parts: list[Part]) -> None:
    """The instrument's shadow on what is behind it, beside it, soft or hard."""
    size = (scene.shape[0], scene.shape[1])
    half = parts[0].end_half
    shift = np.array([[1, 0, rng.normal(0.0, 1.2) * half], [0, 1, rng.normal(0.3, 1.2) * half]], np.float32)
    moved = cv2.warpAffine(silhouette(size, parts), shift, size[::-1])
    soft = cv2.GaussianBlur(moved, (0, 0), rng.uniform(0.5, 1.0 + 0.6 * half)).astype(np.float32)
    scene *= 1.0 - rng.uniform(0.1, 0.75) * soft[..., None] / 255.0


def _stain(rng: np.random.Generator, scene: Array, where: Array) -> None:
    """Blood, or what is like it, on instruments: they stay what they are."""
    spots = fractal(rng, (scene.shape[0], scene.shape[1]), rng.uniform(6.0, 25.0), 3) - rng.uniform(0.3, 1.8)
    share = np.clip(4.0 * spots, 0.0, 1.0) * where * rng.uniform(0.4, 1.0)
    red = rng.uniform(35, 170)
    blood = red * np.array([rng.uniform(0.05, 0.4), rng.uniform(0.05, 0.35), 1.0], np.float32)
    scene += share[..., None].astype(np.float32) * (blood - scene)


def _cover_tip(
    rng: np.random.Generator, scene: Array, labels: Array, before: Array, behind: Array, parts: list[Part]
) -> None:
    """Tissue in front of the end of an instrument, which grasps it or is behind it."""
    height, width = labels.shape
    tip, half = parts[-1].end, parts[0].end_half
    y, x = np.mgrid[:height, :width].astype(np.float32)
    radius = half * rng.uniform(0.6, 2.5)
    away = np.hypot(x - tip[0], y - tip[1]) / radius + 0.25 * fractal(rng, (height, width), 8.0, 2)
    over = away < 1.0
    shift = rng.integers(-width // 4, width // 4, 2)
    moved = np.roll(behind, tuple(shift), axis=(0, 1))
    scene[over] = (moved * np.clip(1.3 - 0.5 * away, 0.5, 1.2)[..., None])[over]
    labels[over] = before[over]


def _thread(rng: np.random.Generator, scene: Array) -> None:
    """A suture or a needle: thin, of any colour, and no instrument."""
    start = rng.uniform(0.0, 1.0, 2) * scene.shape[1::-1]
    headings = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0.0, 0.3, 20))
    steps = np.stack([np.cos(headings), np.sin(headings)], -1) * scene.shape[1] * rng.uniform(0.005, 0.03)
    points = np.rint(start + np.cumsum(steps, axis=0)).astype(np.int32)
    cv2.polylines(scene, [points], False, rng.uniform(0, 255, 3).tolist(), 1, cv2.LINE_AA)


def picture_area(rng: np.random.Generator, size: Size, border: str) -> Array:
    """Where the picture is inside of its black border: 255, else 0; shape (h, w)."""
    height, width = size
    mask = np.zeros(size, np.uint8)
    centre = np.array([width, height]) * (0.5 + rng.normal(0.0, 0.02, 2))
    if border == "none":
        mask[:] = 255
    elif border == "rectangle":
        left, right = rng.uniform(0.0, 0.2, 2) * width * (rng.random() < 0.8)
        top, bottom = rng.uniform(0.0, 0.12, 2) * height * (rng.random() < 0.5)
        mask[int(top) : height - int(bottom), int(left) : width - int(right)] = 255
    elif border == "octagon":
        half = np.array([width * rng.uniform(0.36, 0.5), height * rng.uniform(0.44, 0.5)])
        cut = min(half) * rng.uniform(0.2, 0.6)
        one, two = (half[0] - cut, half[1]), (half[0], half[1] - cut)
        ring = [(sx * x, sy * y) for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1)) for x, y in (one, two)]
        corners = cv2.convexHull((centre + np.array(ring)).astype(np.float32))
        cv2.fillConvexPoly(mask, np.rint(corners).astype(np.int32), 255)
    else:
        radius = height * (rng.uniform(0.42, 0.52) if border == "circle" else rng.uniform(0.5, 0.68))
        cv2.circle(mask, np.rint(centre).astype(int).tolist(), int(radius), 255, cv2.FILLED)
    return mask


def light_and_colour(rng: np.random.Generator, scene: Array) -> Array:
    """The lamp's cone, exposure and contrast, the balance of colours, and smoke."""
    height, width = scene.shape[:2]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    at = (np.array([width, height]) * (0.5 + rng.normal(0.0, 0.1, 2))).astype(np.float32)
    r2 = ((x - at[0]) ** 2 + (y - at[1]) ** 2) / (width / 2) ** 2
    scene = scene * (1.0 / (1.0 + rng.exponential(0.35) * r2))[..., None]
    if rng.random() < 0.25:  # vignette of the optics
        depth = rng.uniform(0.4, 1.0)
        scene *= (1.0 - depth * np.clip((r2 - rng.uniform(0.2, 0.6)) / rng.uniform(0.3, 1.2), 0, 1))[
            ..., None
        ]
    if rng.random() < 0.3:
        plume = rng.uniform(0.0, 0.6) + 0.25 * fractal(rng, (height, width), 2.0, 3)
        smoke = np.clip(plume, 0.0, 0.85)[..., None]
        haze = rng.uniform(90, 230) * np.array([rng.uniform(0.9, 1.15), 1.0, rng.uniform(0.85, 1.05)])
        scene = (1.0 - smoke) * scene + smoke * haze.astype(np.float32)
    grey = scene @ np.array([0.11, 0.59, 0.3], np.float32)
    saturation = float(np.clip(rng.normal(1.0, 0.25), 0.3, 1.6))
    scene = grey[..., None] + saturation * (scene - grey[..., None])
    cast = np.exp(rng.normal(0.0, 0.1 if rng.random() < 0.8 else 0.25, 3))
    if rng.random() < 0.12:  # a strong blue to violet cast
        cast *= np.array([rng.uniform(1.2, 2.2), rng.uniform(0.6, 1.0), rng.uniform(0.5, 1.0)])
    cast = cast / cast.mean() * np.exp(rng.normal(0.05, 0.3))
    levels = np.clip(scene * cast.astype(np.float32) / 255.0, 0.0, 1.0)
    return np.asarray(255.0 * levels ** float(np.exp(rng.normal(0.0, 0.25))) + rng.uniform(0, 14), np.float32)


def film(rng: np.random.Generator, scene: Array, picture: Array) -> Array:
    """The picture as recorded, uint8 of the same shape: blur, border, interlaced rows, noise, compression."""
    height, width = scene.shape[:2]
    scene = cv2.GaussianBlur(scene, (0, 0), rng.uniform(0.3, 1.6) * width / 350)
    if rng.random() < 0.2:
        length = int(rng.integers(3, max(4, width // 30)))
        kernel = np.zeros((length, length), np.float32)
        angle = rng.uniform(0, 2 * np.pi)
        end = np.rint((length - 1) / 2 * (1 + np.array([np.cos(angle), np.sin(angle)]))).astype(int)
        cv2.line(kernel, end.tolist(), (length - 1 - end).tolist(), 1.0)
        scene = cv2.filter2D(scene, -1, kernel / kernel.sum())
    if rng.random() < 0.3:  # sharpening, as cameras do it, leaves halos
        scene = scene + rng.uniform(0.3, 1.5) * (scene - cv2.GaussianBlur(scene, (0, 0), 1.5))
    edge = cv2.GaussianBlur(picture, (0, 0), rng.uniform(0.4, 1.5)).astype(np.float32)[..., None] / 255.0
    black = np.array(rng.uniform(0, 6) if rng.random() < 0.7 else rng.uniform(0, 22, 3), np.float32)
    scene = edge * scene + (1.0 - edge) * black
    if rng.random() < 0.1:
        scene[1::2] = np.roll(scene[1::2], int(rng.integers(-3, 4)), axis=1)
    strength = rng.exponential(2.5)
    scene = scene + strength * rng.standard_normal((height, width, 1), np.float32)
    if rng.random() < 0.3:  # noise of colour is coarser
        coarse = rng.standard_normal((height // 3, width // 3, 3), np.float32)
        scene = scene + strength * cv2.resize(coarse, (width, height))
    image = np.clip(scene, 0, 255).astype(np.uint8)
    if rng.random() < 0.6:
        _, coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(20, 96))])
        image = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)
    return image

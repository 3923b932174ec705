"""Random pictures with exact labels and keypoints, each made from a seed: scene, light, camera, video link."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor

import cv2
import numpy as np

from svmdist.vision.degradations import degrade, light_left
from training import instruments
from training.backgrounds import background
from training.instruments import OTHER
from training.parts import Array, Size, lettering

WIDTH, HEIGHT = 560, 420
"""Of pictures in px. Those of any aspect are stretched to it, as `method = "onnx"` does."""
MIDDLE = 127.5  # the network's pixels are (level - MIDDLE) / MIDDLE
MOST, POINTS = 5, 5  # instruments of a picture, and of each: entry, end, hinge, and two tips
VALIDATION_SEED = 10_000_000  # from here on they are not trained on
# Degradations in the order in which they come about, and how often each does
IN_VIEW = {"smoke": 0.22, "specular": 0.15}
IN_CAMERA = {"defocus": 0.5, "motion_blur": 0.15, "low_light": 0.08, "noise": 0.4, "jpeg": 0.6}
Rendered = tuple[Array, Array, Array]
"""A picture (h, w, 3) in BGR, the class of each pixel (h, w), and keypoints in px, (MOST, POINTS, 2)."""


def layers(rng: np.random.Generator, size: Size, count: int | None = None) -> Rendered:
    """One picture before light and camera, with `count` instruments or any number; its classes and keypoints."""
    scene, labels = background(rng, size)
    points = np.full((MOST, POINTS, 2), np.nan, np.float32)
    for number in range(rng.choice(5, p=[0.13, 0.37, 0.34, 0.12, 0.04]) if count is None else count):
        parts, points[number] = instruments.instrument(rng, size, scene.mean((0, 1)))
        instruments.place(rng, scene, labels, parts)
    return scene, labels, points


def seen(points: Array, view: Array) -> Array:
    """Keypoints, shape (n, POINTS, 2), in the view, a mask (h, w): others are NaN, and shafts enter at its rim."""
    paths = np.repeat(points[:, :, None], 256, 2)
    paths[:, 0] += np.linspace(0.0, 1.0, 256)[:, None] * (points[:, 1] - points[:, 0])[:, None]
    at = np.nan_to_num(np.floor(paths + 1.5)).clip(0, np.array(view.shape[::-1]) + 1).astype(int)
    inside = np.pad(view, 1)[at[..., 1], at[..., 0]] > 0
    first = np.take_along_axis(paths, inside.argmax(2)[..., None, None], 2)[:, :, 0]
    return np.where(inside.any(2)[..., None], first, np.nan)


def render(seed: int) -> Rendered:
    """A seed's picture, (HEIGHT, WIDTH, 3) in BGR, the class of each pixel, (HEIGHT, WIDTH), and keypoints in px."""
    rng = np.random.default_rng(seed)
    height, aspect, border = int(rng.integers(230, 440)), float(rng.choice([1.0, 5 / 4, 4 / 3, 3 / 2, 16 / 9])), 0.0
    if rng.random() < 0.5:  # the endoscope's round view, whole or cut; users of the network crop to it
        aspect, border = rng.uniform(1.0, 1.4), rng.uniform(0.7, 1.1)
    width = round(height * aspect)
    scene, labels, points = layers(rng, (height, width))
    view = np.asarray(light_left(border, 0.0, width, height), np.float32)
    x, y = (np.linspace(-1.0, 1.0, n, dtype=np.float32) + rng.normal(0.0, 0.2) for n in (width, height))
    cone = 1.0 / (1.0 + rng.exponential(0.5) * (x**2 + (y[:, None] / aspect) ** 2))[..., None]  # of the lamp
    scene = view * spoilt(rng, toned(rng, cone * scene, 1.0) + rng.uniform(0, 14), IN_VIEW)
    scene = scene + (1.0 - view) * rng.uniform(0, 12, 3)
    inside = (view[..., 0] > 0.5).astype(np.uint8)
    image, points, labels = filmed(rng, scene), seen(points, inside), np.where(inside, labels, OTHER)
    for _ in range(int(rng.integers(1, 4)) if rng.random() < 0.12 else 0):
        _overlay(rng, image, labels)
    points = (points + 0.5) * (WIDTH / width, HEIGHT / height) - 0.5
    image = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)
    labels = cv2.resize(labels.astype(np.uint8), (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST_EXACT)
    return image, labels, points.astype(np.float32)


def _overlay(rng: np.random.Generator, image: Array, labels: Array) -> None:
    """A box with letters of the robot or the recorder, drawn over a picture, often at its border."""
    size = rng.uniform([0.03, 0.05], [0.14, 0.35]) * labels.shape
    top, left = np.clip(rng.uniform(-0.5, 1.5, 2), 0.0, 1.0) * (labels.shape - size)
    box = np.s_[int(top) : int(top + size[0]), int(left) : int(left + size[1])]
    over = image[box] + rng.uniform(0.4, 1.0) * (rng.uniform(0, 90) + rng.uniform(0, 30, 3) - image[box])
    ink = lettering(rng, over.shape[:2], (0.3, 0.7))
    image[box], labels[box] = over + ink * (rng.uniform(150, 255, 3) - over), OTHER


def spoilt(rng: np.random.Generator, image: Array, shares: dict[str, float]) -> Array:
    """The picture, as uint8 of the same shape, with some degradations, more often slight than severe."""
    image = np.clip(image, 0, 255).astype(np.uint8)
    for name, share in shares.items():
        if rng.random() < share:
            image = degrade(image, name, 1 + min(4, int(rng.exponential(1.5))), int(rng.integers(1 << 31)))
    return image


def toned(rng: np.random.Generator, image: Array, much: float) -> Array:
    """The picture, as float32 of the same shape, with other saturation, exposure, balance of colours and contrast."""
    grey = image.mean(2, keepdims=True, dtype=np.float32)
    gain = np.exp(rng.normal(0.0, 0.35 * much) + 0.1 * much * rng.standard_t(4, 3)).astype(np.float32)
    levels = (grey + float(np.clip(rng.normal(1.0, 0.25 * much), 0.3, 1.8)) * (image - grey)) * (gain / 255.0)
    return np.asarray(255.0 * np.clip(levels, 0.0, 1.0) ** float(np.exp(rng.normal(0.0, 0.25 * much))), np.float32)


def filmed(rng: np.random.Generator, scene: Array) -> Array:
    """The picture as recorded, uint8 of the same shape: blur, noise, JPEG; interlaced or sharpened now and then."""
    image = spoilt(rng, scene, IN_CAMERA)
    if rng.random() < 0.08:  # every other line is from a moment later
        shift = np.array([[1.0, 0.0, rng.normal(0.0, 5.0)], [0.0, 1.0, rng.normal(0.0, 2.0)]])
        image[1::2] = cv2.warpAffine(image, shift, image.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)[1::2]
    if rng.random() < 0.3:  # cameras sharpen, which leaves halos
        share = rng.uniform(0.3, 1.5)
        image = cv2.addWeighted(image, 1.0 + share, cv2.GaussianBlur(image, (0, 0), 1.5), -share, 0.0)
    return np.asarray(image, np.uint8)


def rendered(first_seed: int, count: int, processes: int = 1) -> list[Rendered]:
    """The pictures of `count` seeds."""
    with ProcessPoolExecutor(processes, initializer=cv2.setNumThreads, initargs=(1,)) as pool:
        return list(pool.map(render, range(first_seed, first_seed + count), chunksize=25))

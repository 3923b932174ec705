"""Random pictures with exact labels and keypoints, each made from a seed: scene, light, camera, video link."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor

import cv2
import numpy as np

from training import instruments
from training.backgrounds import Array, Size, background, fractal
from training.instruments import NOWHERE, OTHER, TISSUE

WIDTH, HEIGHT = 560, 420
"""Of pictures in px. Those of any aspect are stretched to it, as `method = "onnx"` does."""
MIDDLE = 127.5  # the network's pixels are (level - MIDDLE) / MIDDLE
MOST, POINTS = 5, 5  # instruments of a picture, and of each: entry, end, hinge, and two tips
ASPECTS = (4 / 3, 4 / 3, 5 / 4, 16 / 9, 16 / 9, 1.0, 1.5)
VALIDATION_SEED = 10_000_000  # from here on they are not trained on
Rendered = tuple[Array, Array, Array]
"""Pictures (n, h, w, 3) in BGR, the class of each pixel (n, h, w), and keypoints in px, (n, MOST, POINTS, 2)."""


def layers(rng: np.random.Generator, size: Size, count: int | None = None) -> Rendered:
    """One picture before light and camera, with `count` instruments or any number; its classes and keypoints."""
    scene, is_tissue = background(rng, size)
    labels = np.where(is_tissue, TISSUE, OTHER).astype(np.uint8)
    around = np.asarray(scene.mean((0, 1)), np.float32)
    points = np.full((MOST, POINTS, 2), np.nan, np.float32)
    for number in range(rng.choice(5, p=[0.13, 0.37, 0.34, 0.12, 0.04]) if count is None else count):
        parts, points[number] = instruments.instrument(rng, size, around)
        instruments.place(rng, scene, labels, parts)
    return scene, labels, points


def seen(points: Array, view: Array) -> Array:
    """Keypoints, shape (n, POINTS, 2), in the view, a mask (h, w): others are NaN, and shafts enter at its rim."""
    out, shares = points.copy(), np.linspace(0.0, 1.0, 256, dtype=np.float32)[:, None]
    limits = np.array(view.shape[::-1]) - 1
    for item in out:
        for number, places in enumerate([item[0] + shares * (item[1] - item[0]), *item[1:, None]]):
            at = np.where(np.isfinite(places), np.floor(np.nan_to_num(places) + 0.5), -1).astype(int)
            x, y = at.clip(0, limits).T
            inside = (at == np.stack([x, y], -1)).all(1) & (view[y, x] > 0)
            item[number] = places[inside.argmax()] if inside.any() else NOWHERE
    return out


def render(seed: int) -> Rendered:
    """A seed's picture, (HEIGHT, WIDTH, 3) in BGR, the class of each pixel, (HEIGHT, WIDTH), and keypoints in px."""
    rng = np.random.default_rng(seed)
    height = int(rng.integers(230, 440))
    size = (height, round(height * float(rng.choice(ASPECTS))))
    scene, labels, points = layers(rng, size)
    (height, width), circle = size, rng.random() < 0.5
    view = np.full(size, 0 if circle else 255, np.uint8)
    if circle:  # the endoscope's, whole or cut; users of the network crop to it
        middle = np.rint(np.array([width, height]) * (0.5 + rng.normal(0.0, 0.02, 2))).astype(int).tolist()
        cv2.circle(view, middle, int(height * rng.uniform(0.42, 0.68)), 255, cv2.FILLED)
    edge = cv2.GaussianBlur(view, (0, 0), rng.uniform(0.4, 1.5)).astype(np.float32)[..., None] / 255.0
    scene = edge * _light_and_colour(rng, scene) + (1.0 - edge) * rng.uniform(0, 12, 3).astype(np.float32)
    image, points, labels = filmed(rng, scene), seen(points, view), np.where(view > 0, labels, OTHER)
    for _ in range(int(rng.integers(1, 4)) if rng.random() < 0.12 else 0):
        _overlay(rng, image, labels)
    x, y, width, height = cv2.boundingRect(view)
    image, labels = (one[y : y + height, x : x + width] for one in (image, labels.astype(np.uint8)))
    points = (points - (x, y) + 0.5) * (WIDTH / width, HEIGHT / height) - 0.5
    shown = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)
    labels = cv2.resize(labels, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST_EXACT)
    return shown, labels, points.astype(np.float32)


def _overlay(rng: np.random.Generator, image: Array, labels: Array) -> None:
    """A box with letters of the robot or the recorder, drawn over a picture, often at its border."""
    size, box = np.array(image.shape[1::-1]), rng.uniform([0.05, 0.03], [0.35, 0.14])
    corner = np.where(rng.random(2) < 0.6, rng.choice([0.0, 1.0], 2), rng.random(2)) * (1.0 - box)
    (x, y), (right, bottom) = np.rint([corner * size, (corner + box) * size]).astype(int).tolist()
    over = image[y:bottom, x:right]
    over[:] = over + rng.uniform(0.4, 1.0) * (rng.uniform(0, 90) + rng.uniform(0, 30, 3) - over)
    word = "".join(rng.choice(list("ABCDEFGHILMNOPRSTUV 0123456789:"), int(rng.integers(1, 14))))
    letters = cv2.FONT_HERSHEY_SIMPLEX, (bottom - y) / 40.0 * rng.uniform(0.5, 1.1)
    cv2.putText(image, word, (x + 2, bottom - 3), *letters, rng.uniform(150, 255, 3).tolist(), 1, cv2.LINE_AA)
    labels[y:bottom, x:right] = OTHER


def _light_and_colour(rng: np.random.Generator, scene: Array) -> Array:
    """The lamp's cone, exposure and contrast, the balance of colours, and smoke."""
    height, width = scene.shape[:2]
    x, y = (np.linspace(-1.0, 1.0, n, dtype=np.float32) + rng.normal(0.0, 0.2) for n in (width, height))
    scene = scene / (1.0 + rng.exponential(0.5) * (x**2 + (height / width * y[:, None]) ** 2))[..., None]
    if rng.random() < 0.22:
        smoke = rng.uniform(0.0, 0.6) + 0.25 * fractal(rng, (height, width), 2.0, 3)[..., None]
        scene += np.clip(smoke, 0.0, 0.85) * (rng.uniform(90, 230) - scene)
    grey = (scene @ np.array([0.11, 0.59, 0.3], np.float32))[..., None]
    scene = grey + float(np.clip(rng.normal(1.0, 0.25), 0.3, 1.8)) * (scene - grey)  # saturation
    cast = np.exp(rng.normal(0.0, 0.1 if rng.random() < 0.8 else 0.25, 3))
    levels = np.clip(scene * (cast / cast.mean() * np.exp(rng.normal(0.05, 0.35))) / 255.0, 0.0, 1.0)
    return np.asarray(255.0 * levels ** float(np.exp(rng.normal(0.0, 0.25))) + rng.uniform(0, 14), np.float32)


def filmed(rng: np.random.Generator, scene: Array) -> Array:
    """The picture as recorded, uint8 of the same shape: blur, sharpening, noise, JPEG."""
    scene = cv2.GaussianBlur(scene.astype(np.float32), (0, 0), rng.uniform(0.3, 1.6) * scene.shape[1] / 400)
    if rng.random() < 0.3:  # cameras sharpen, which leaves halos
        scene = scene + rng.uniform(0.3, 1.5) * (scene - cv2.GaussianBlur(scene, (0, 0), 1.5))
    scene = scene + rng.exponential(2.5) * rng.standard_normal((*scene.shape[:2], 1), np.float32)
    quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(20, 101))]
    coded = cv2.imencode(".jpg", np.clip(scene, 0, 255).astype(np.uint8), quality)[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)


def rendered(first_seed: int, count: int, processes: int = 1) -> Rendered:
    """The pictures of `count` seeds."""
    with ProcessPoolExecutor(processes, initializer=cv2.setNumThreads, initargs=(1,)) as pool:
        results = list(pool.map(render, range(first_seed, first_seed + count), chunksize=25))
    return tuple(np.stack(kind) for kind in zip(*results, strict=True))  # type: ignore[return-value]

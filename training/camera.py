"""What an endoscope and a video link make of a scene: light, casts, smoke, border, blur, interlacing, compression."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from training.noise import Canvas, Size, fractal

BORDERS = ("none", "circle", "octagon", "rectangle", "cut circle")


def picture_area(rng: np.random.Generator, size: Size, border: str) -> NDArray[np.uint8]:
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


def light_and_colour(rng: np.random.Generator, scene: Canvas) -> Canvas:
    """The lamp's cone, exposure and contrast, the balance of colours, and smoke."""
    height, width = scene.shape[:2]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    at = (np.array([width, height]) * (0.5 + rng.normal(0.0, 0.1, 2))).astype(np.float32)
    r2 = ((x - at[0]) ** 2 + (y - at[1]) ** 2) / (width / 2) ** 2
    scene = scene * (1.0 / (1.0 + rng.exponential(0.35) * r2))[..., None]
    if rng.random() < 0.25:  # vignette of the optics
        scene *= (
            1.0 - rng.uniform(0.4, 1.0) * np.clip((r2 - rng.uniform(0.2, 0.6)) / rng.uniform(0.3, 1.2), 0, 1)
        )[..., None]
    if rng.random() < 0.3:
        smoke = np.clip(rng.uniform(0.0, 0.6) + 0.25 * fractal(rng, (height, width), 2.0, 3), 0.0, 0.85)[
            ..., None
        ]
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


def film(rng: np.random.Generator, scene: Canvas, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The picture as recorded, uint8 of the same shape: blur, border, interlaced rows, noise, compression."""
    height, width = scene.shape[:2]
    scene = np.asarray(cv2.GaussianBlur(scene, (0, 0), rng.uniform(0.3, 1.6) * width / 350), np.float32)
    if rng.random() < 0.2:
        length = int(rng.integers(3, max(4, width // 30)))
        kernel = np.zeros((length, length), np.float32)
        end = (length - 1) / 2 * (1 + np.array([np.cos(a := rng.uniform(0, 2 * np.pi)), np.sin(a)]))
        first, last = np.rint(end).astype(int), length - 1 - np.rint(end).astype(int)
        cv2.line(kernel, first.tolist(), last.tolist(), 1.0)
        scene = np.asarray(cv2.filter2D(scene, -1, kernel / kernel.sum()), np.float32)
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
        quality = int(rng.integers(20, 96))
        _, coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        image = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)
    return image

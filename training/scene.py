"""Random pictures with exact labels, each made from a seed: layers of a scene, light, camera and video link.

They are drawn once to two files, which training then reads as often as it likes.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import cv2
import numpy as np

from training import instruments
from training.instruments import OTHER, TISSUE, Array, Size, fractal

WIDTH, HEIGHT = 256, 192
"""The network's input in px. Pictures of any aspect are stretched to it, as `method = "onnx"` does."""
MIDDLE = 127.5  # its pixels are (level - MIDDLE) / MIDDLE
ASPECTS = (4 / 3, 4 / 3, 5 / 4, 16 / 9, 16 / 9, 1.0, 1.5)
BORDERS = ("none", "circle", "rectangle", "cut circle")
BORDER_WEIGHTS = (0.45, 0.24, 0.14, 0.17)
VALIDATION_SEED = 10_000_000  # seeds from here on are never trained on


def layers(rng: np.random.Generator, size: Size, count: int | None = None) -> tuple[Array, Array]:
    """Draw background, shadows, `count` instruments (else 0 to 3), blood and a suture.

    Gives the picture, shape (h, w, 3), before light and camera, and the class of each pixel, shape (h, w).
    """
    scene, is_tissue = instruments.background(rng, size)
    count = int(rng.choice(4, p=[0.1, 0.42, 0.38, 0.1])) if count is None else count
    if rng.random() < 0.35:
        instruments.draw(scene, np.zeros(size, np.uint8), instruments.cords(rng, size))
    labels = np.where(is_tissue, TISSUE, OTHER).astype(np.uint8)
    around = np.asarray(scene.mean((0, 1)), np.float32)
    for _ in range(count):
        parts = instruments.instrument(rng, size, around)
        if rng.random() < 0.6:  # its shadow on what is behind it, beside it, soft or hard
            half = parts[0].end_half
            outline = np.zeros(size, np.uint8)
            for part in parts:
                cv2.fillConvexPoly(outline, np.rint(part.corners).astype(np.int32), 255)
            aside = [rng.normal(0.0, 1.2) * half, rng.normal(0.3, 1.2) * half]
            shift = np.column_stack([np.eye(2), aside]).astype(np.float32)
            moved = cv2.warpAffine(outline, shift, size[::-1])
            soft = cv2.GaussianBlur(moved, (0, 0), rng.uniform(0.5, 1.0 + 0.6 * half)).astype(np.float32)
            scene *= 1.0 - rng.uniform(0.1, 0.75) * soft[..., None] / 255.0
        instruments.draw(scene, labels, parts)
        if rng.random() < 0.45:  # blood, or what is like it, on instruments: they stay what they are
            spots = fractal(rng, size, rng.uniform(6.0, 25.0), 3) - rng.uniform(0.3, 1.8)
            share = np.clip(4.0 * spots, 0.0, 1.0) * (labels > TISSUE) * rng.uniform(0.4, 1.0)
            blood = rng.uniform(35, 170) * np.array([rng.uniform(0.05, 0.4), rng.uniform(0.05, 0.35), 1.0])
            scene += (share[..., None] * (blood - scene)).astype(np.float32)
    if rng.random() < 0.3:  # a suture or a needle: thin, of any colour, and no instrument
        colour = rng.uniform(0, 255, 3).tolist()
        cv2.polylines(scene, [instruments.wandering(rng, size, 0.3)], False, colour, 1, cv2.LINE_AA)
    return scene, labels


def render(seed: int) -> tuple[Array, Array]:
    """A seed's picture, shape (HEIGHT, WIDTH, 3) in BGR, and the class of each pixel, shape (HEIGHT, WIDTH)."""
    rng = np.random.default_rng(seed)
    height = int(rng.integers(200, 290))
    size = (height, round(height * float(rng.choice(ASPECTS))))
    scene, labels = layers(rng, size)
    picture = _picture_area(rng, size)
    image = _film(rng, _light_and_colour(rng, scene), picture)
    labels = np.where(picture > 0, labels, OTHER).astype(np.uint8)
    if rng.random() < 0.15:  # recorded small, and enlarged
        less = rng.uniform(0.4, 0.9)
        image = cv2.resize(image, None, fx=less, fy=less, interpolation=cv2.INTER_AREA)
    how = cv2.INTER_AREA if image.shape[1] >= WIDTH and image.shape[0] >= HEIGHT else cv2.INTER_LINEAR
    shown = cv2.resize(image, (WIDTH, HEIGHT), interpolation=how)
    return shown, cv2.resize(labels, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST_EXACT)


def _picture_area(rng: np.random.Generator, size: Size) -> Array:
    """Where the picture is inside of its black border: 255, else 0; shape (h, w)."""
    height, width = size
    border = rng.choice(BORDERS, p=BORDER_WEIGHTS)
    mask = np.full(size, 255 if border == "none" else 0, np.uint8)
    if border == "rectangle":
        left, right = rng.uniform(0.0, 0.2, 2) * width * (rng.random() < 0.8)
        top, bottom = rng.uniform(0.0, 0.12, 2) * height * (rng.random() < 0.5)
        mask[int(top) : height - int(bottom), int(left) : width - int(right)] = 255
    elif border != "none":
        centre = np.array([width, height]) * (0.5 + rng.normal(0.0, 0.02, 2))
        radius = height * (rng.uniform(0.42, 0.52) if border == "circle" else rng.uniform(0.5, 0.68))
        cv2.circle(mask, np.rint(centre).astype(int).tolist(), int(radius), 255, cv2.FILLED)
    return mask


def _light_and_colour(rng: np.random.Generator, scene: Array) -> Array:
    """The lamp's cone, exposure and contrast, the balance of colours, and smoke."""
    height, width = scene.shape[:2]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    at = (np.array([width, height]) * (0.5 + rng.normal(0.0, 0.1, 2))).astype(np.float32)
    r2 = ((x - at[0]) ** 2 + (y - at[1]) ** 2) / (width / 2) ** 2
    scene = scene * (1.0 / (1.0 + rng.exponential(0.5) * r2))[..., None]
    if rng.random() < 0.3:
        plume = rng.uniform(0.0, 0.6) + 0.25 * fractal(rng, (height, width), 2.0, 3)
        smoke = np.clip(plume, 0.0, 0.85)[..., None]
        haze = rng.uniform(90, 230) * np.array([rng.uniform(0.9, 1.15), 1.0, rng.uniform(0.85, 1.05)])
        scene = (1.0 - smoke) * scene + smoke * haze.astype(np.float32)
    grey = (scene @ np.array([0.11, 0.59, 0.3], np.float32))[..., None]
    scene = grey + float(np.clip(rng.normal(1.0, 0.25), 0.3, 1.6)) * (scene - grey)  # saturation
    cast = np.exp(rng.normal(0.0, 0.1 if rng.random() < 0.8 else 0.25, 3))
    if rng.random() < 0.12:  # a strong blue to violet cast
        cast *= np.array([rng.uniform(1.2, 2.2), rng.uniform(0.6, 1.0), rng.uniform(0.5, 1.0)])
    cast = cast / cast.mean() * np.exp(rng.normal(0.05, 0.3))
    levels = np.clip(scene * cast.astype(np.float32) / 255.0, 0.0, 1.0)
    return np.asarray(255.0 * levels ** float(np.exp(rng.normal(0.0, 0.25))) + rng.uniform(0, 14), np.float32)


def _film(rng: np.random.Generator, scene: Array, picture: Array) -> Array:
    """The picture as recorded, uint8 of the same shape: blur, sharpening, border, interlaced rows, noise, JPEG."""
    height, width = scene.shape[:2]
    scene = cv2.GaussianBlur(scene, (0, 0), rng.uniform(0.3, 1.6) * width / 350)
    if rng.random() < 0.2:
        length = int(rng.integers(3, max(4, width // 30)))
        kernel = np.zeros((length, length), np.float32)
        ends = np.rint(rng.uniform(0, length - 1, 2)).astype(int)
        cv2.line(kernel, ends.tolist(), (length - 1 - ends).tolist(), 1.0)
        scene = cv2.filter2D(scene, -1, kernel / kernel.sum())
    if rng.random() < 0.3:  # cameras sharpen, which leaves halos
        scene = scene + rng.uniform(0.3, 1.5) * (scene - cv2.GaussianBlur(scene, (0, 0), 1.5))
    edge = cv2.GaussianBlur(picture, (0, 0), rng.uniform(0.4, 1.5)).astype(np.float32)[..., None] / 255.0
    scene = edge * scene + (1.0 - edge) * rng.uniform(0, 12, 3).astype(np.float32)
    if rng.random() < 0.1:
        scene[1::2] = np.roll(scene[1::2], int(rng.integers(-3, 4)), axis=1)
    scene = scene + rng.exponential(2.5) * rng.standard_normal((height, width, 1), np.float32)
    image = np.clip(scene, 0, 255).astype(np.uint8)
    if rng.random() < 0.6:
        _, coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(20, 96))])
        image = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)
    return image


def rendered(first_seed: int, count: int, folder: Path, processes: int = 1) -> tuple[Array, Array]:
    """Pictures (n, h, w, 3) in BGR and labels (n, h, w) of `count` seeds, drawn where `folder` does not have them."""
    folder.mkdir(parents=True, exist_ok=True)
    images_path, labels_path = (folder / f"{first_seed}-{count}-{kind}.npy" for kind in ("images", "labels"))
    if not labels_path.exists():
        shape = (count, HEIGHT, WIDTH)
        images = np.lib.format.open_memmap(images_path, mode="w+", dtype=np.uint8, shape=(*shape, 3))
        labels = np.empty(shape, np.uint8)
        with ProcessPoolExecutor(processes, initializer=cv2.setNumThreads, initargs=(1,)) as pool:
            pairs = pool.map(render, range(first_seed, first_seed + count), chunksize=25)
            for number, (image, label) in enumerate(pairs):
                images[number], labels[number] = image, label
        images.flush()
        np.save(labels_path, labels)  # last: it says that both are complete
    return np.load(images_path, mmap_mode="r"), np.load(labels_path, mmap_mode="r")


def augmented(rng: np.random.Generator, images: Array, labels: Array) -> tuple[Array, Array]:
    """Flipped, and with each channel brighter or darker: a picture that is read twice is not the same twice."""
    out_images, out_labels = images.copy(), labels.copy()
    for number, (image, label) in enumerate(zip(images, labels, strict=True)):
        across, up = (1 if rng.random() < 0.5 else -1 for _ in range(2))
        table = np.clip(np.arange(256)[:, None] * np.exp(rng.normal(0.0, 0.08, 3)), 0, 255).astype(np.uint8)
        out_images[number] = table[image[::up, ::across], range(3)]
        out_labels[number] = label[::up, ::across]
    return out_images, out_labels


def halved(images: Array, labels: Array) -> tuple[Array, Array]:
    """Half as wide and half as high: pixels averaged, labels taken from one of four."""
    count, height, width = labels.shape
    means = images.reshape(count, height // 2, 2, width // 2, 2, 3).mean((2, 4))
    return means.astype(np.uint8), np.ascontiguousarray(labels[:, ::2, ::2])


def iou(found: Array, truth: Array) -> float:
    """Intersection over union of two masks of one shape; 1 of two that are empty."""
    either = int((found | truth).sum())
    return float((found & truth).sum()) / either if either else 1.0

"""Pictures drawn once to two files, which training then reads as often as it likes, and the overlap of masks."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from training.instruments import DISTAL
from training.scene import HEIGHT, WIDTH, render
from training.textures import Array

VALIDATION_SEED = 10_000_000
"""Seeds from here on are never trained on."""


@dataclass(frozen=True)
class Pictures:
    """`images`, shape (n, h, w, 3) in BGR, and `labels`, shape (n, h, w); both uint8."""

    images: Array
    labels: Array


def rendered(first_seed: int, count: int, folder: Path, processes: int = 1) -> Pictures:
    """The pictures of `count` seeds from `first_seed` on; drawn where `folder` does not have them."""
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
    return Pictures(np.load(images_path, mmap_mode="r"), np.load(labels_path, mmap_mode="r"))


def augmented(rng: np.random.Generator, images: Array, labels: Array) -> tuple[Array, Array]:
    """Flipped, and with each channel brighter or darker: a picture that is read twice is not the same twice."""
    out_images, out_labels = images.copy(), labels.copy()
    for number, (image, label) in enumerate(zip(images, labels, strict=True)):
        across, up = (1 if rng.random() < 0.5 else -1 for _ in range(2))
        table = np.clip(np.arange(256)[:, None] * np.exp(rng.normal(0.0, 0.08, 3)), 0, 255).astype(np.uint8)
        flipped = image[::up, ::across]
        out_images[number] = np.stack([table[flipped[..., c], c] for c in range(3)], -1)
        out_labels[number] = label[::up, ::across]
    return out_images, out_labels


def halved(images: Array, labels: Array) -> tuple[Array, Array]:
    """Half as wide and half as high: pixels averaged, labels taken from one of four."""
    count, height, width = labels.shape
    fours = images.reshape(count, height // 2, 2, width // 2, 2, 3)
    return fours.mean((2, 4)).astype(np.uint8), np.ascontiguousarray(labels[:, ::2, ::2])


def iou(found: Array, truth: Array) -> float:
    """Intersection over union of two masks of one shape; 1 of two that are empty."""
    either = int((found | truth).sum())
    return float((found & truth).sum()) / either if either else 1.0


def union_ious(found: Array, labels: Array) -> Array:
    """The IoU of the union of instruments in each picture that has one."""
    pairs = zip(found >= DISTAL, labels >= DISTAL, strict=True)
    return np.array([iou(one, two) for one, two in pairs if two.any()], np.float64)

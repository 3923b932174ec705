"""Pictures rendered once to two files, which training then reads as often as it likes."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from training.instruments import DISTAL, Labels
from training.scene import HEIGHT, WIDTH, render

VALIDATION_SEED = 10_000_000
"""Seeds from here on are never trained on."""


@dataclass(frozen=True)
class Pictures:
    """`images`, shape (n, h, w, 3) in BGR, and `labels`, shape (n, h, w); both uint8."""

    images: NDArray[np.uint8]
    labels: Labels


def rendered(first_seed: int, count: int, folder: Path, processes: int = 1) -> Pictures:
    """The pictures of seeds `first_seed` to `first_seed + count - 1`; rendered where `folder` has not got them.

    Files bear a fingerprint of the renderer: pictures of an older one are not taken for this one's.
    """
    folder.mkdir(parents=True, exist_ok=True)
    name = f"{first_seed}-{count}-{fingerprint()}"
    images_path, labels_path = (folder / f"{name}-{kind}.npy" for kind in ("images", "labels"))
    if not labels_path.exists():
        images = np.lib.format.open_memmap(
            images_path, mode="w+", dtype=np.uint8, shape=(count, HEIGHT, WIDTH, 3)
        )
        labels = np.empty((count, HEIGHT, WIDTH), np.uint8)
        for number, (image, label) in enumerate(_many(range(first_seed, first_seed + count), processes)):
            images[number], labels[number] = image, label
            if number % 1000 == 999:
                print(f"rendered {number + 1} of {count}", flush=True)
        images.flush()
        np.save(labels_path, labels)  # last: it says that both are whole
    return Pictures(np.load(images_path, mmap_mode="r"), np.load(labels_path, mmap_mode="r"))


def augmented(
    rng: np.random.Generator, images: NDArray[np.uint8], labels: Labels
) -> tuple[NDArray[np.uint8], Labels]:
    """Flipped, and with each channel brighter or darker: a picture that is read twice is not the same twice."""
    out_images, out_labels = images.copy(), labels.copy()
    for number, (image, label) in enumerate(zip(images, labels, strict=True)):
        across, up = (1 if rng.random() < 0.5 else -1 for _ in range(2))
        table = np.clip(np.arange(256)[:, None] * np.exp(rng.normal(0.0, 0.08, 3)), 0, 255).astype(np.uint8)
        flipped = image[::up, ::across]
        out_images[number] = np.stack([table[flipped[..., c], c] for c in range(3)], -1)
        out_labels[number] = label[::up, ::across]
    return out_images, out_labels


def halved(images: NDArray[np.uint8], labels: Labels) -> tuple[NDArray[np.uint8], Labels]:
    """Half as wide and half as high: pixels averaged, labels taken from one of four."""
    count, height, width = labels.shape
    fours = images.reshape(count, height // 2, 2, width // 2, 2, 3)
    return fours.mean((2, 4)).astype(np.uint8), np.ascontiguousarray(labels[:, ::2, ::2])


def iou(found: NDArray[np.bool_], truth: NDArray[np.bool_]) -> float:
    """Intersection over union of two masks of one shape; 1 of two that are empty."""
    either = int((found | truth).sum())
    return float((found & truth).sum()) / either if either else 1.0


def union_ious(found: NDArray[np.uint8], labels: Labels) -> NDArray[np.float64]:
    """The IoU of the union of instruments in each picture that has one."""
    pairs = zip(found >= DISTAL, labels >= DISTAL, strict=True)
    return np.array([iou(one, two) for one, two in pairs if two.any()], np.float64)


def fingerprint() -> str:
    """A digest of eight pictures: changes with whatever changes any of them."""
    digest = sha256()
    for seed in range(8):
        for part in render(seed):
            digest.update(part.tobytes())
    return digest.hexdigest()[:12]


def _many(seeds: range, processes: int) -> Iterator[tuple[NDArray[np.uint8], Labels]]:
    if processes == 1:
        yield from map(_one, seeds)
        return
    with ProcessPoolExecutor(processes) as pool:
        yield from pool.map(_one, seeds, chunksize=25)


def _one(seed: int) -> tuple[NDArray[np.uint8], Labels]:
    cv2.setNumThreads(1)
    return render(seed)

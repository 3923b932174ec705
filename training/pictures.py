"""Real pictures, with outlines or masks by people, and what training makes of them and of rendered ones."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from svmdist.vision.instruments.evidence import picture_of
from svmdist.vision.network import OnnxSegmenter
from training.backgrounds import TISSUES, colour
from training.instruments import DISTAL, INSTRUMENT, NO_INSTRUMENT, OTHER, SHAFT, TISSUE, UNKNOWN
from training.parts import Array, Size, fractal
from training.scene import HEIGHT, IN_VIEW, WIDTH, Rendered, filmed, seen, spoilt, toned

OUTLINES = Path(__file__).with_name("outlines.json")
"""By repository and file: what it shows, outlines of instruments and of what may be one, in permille of its sides."""
MASKED = "TransUNet-single/datasets/*/*[Tt]raining/Grayscale/*/*.png"
"""Grey pictures of instruments in WeianWang-OvO/EB-GS-DualNet, beside masks of the same numbers."""
BAND = np.ones((9, 9), np.uint8)  # over an edge, where a hand is not sure
DRAWN_SHARE, PASTED = 0.5, 0.5  # of the pictures of a step; of the real ones, with instruments of others
GREY_SHARE, TINTED = 0.22, 0.75  # of the real ones that are grey; of these, that get the colours of tissue
NEAR = 1 / 64  # of the width: how near to a keypoint a pixel counts as on it
Outlined = tuple[Array, Array]
"""A picture (HEIGHT, WIDTH, 3) in BGR, and its labels (HEIGHT, WIDTH)."""
HELD_OUT = ("images/00002-", "images/00027-")  # two operations, to measure on


def outlined(folders: Sequence[Path]) -> list[Outlined]:
    """The pictures with outlines in checked-out repositories, cropped to what the endoscope shows."""
    known = json.loads(OUTLINES.read_text("utf-8"))
    pictures = [(folder / name, one) for folder in folders for name, one in known.get(folder.name, {}).items()]
    return [_outlined(path, **one) for path, one in pictures if not any(held in str(path) for held in HELD_OUT)]


def _outlined(path: Path, shows: str, outlines: Sequence[Sequence[list[int]]] = ((), ())) -> Outlined:
    video = cv2.VideoCapture(str(path))  # reads a single picture, too
    video.set(cv2.CAP_PROP_POS_FRAMES, int(0.7 * video.get(cv2.CAP_PROP_FRAME_COUNT)))
    if (image := video.read()[1]) is None:
        raise SystemExit(f"{path}: expected a picture")
    masks = np.zeros((2, *image.shape[:2]), np.uint8)
    for mask, of_it in zip(masks, outlines, strict=True):
        for outline in of_it:
            corners = np.reshape(outline, (-1, 2)) / 1000.0 * image.shape[1::-1] - 0.5
            cv2.fillPoly(mask, [np.rint(16.0 * corners).astype(np.int32)], 1, shift=4)
    return _labelled(image, masks, {"tissue": TISSUE, "room": OTHER, "": NO_INSTRUMENT}[shows])


def masked(folders: Sequence[Path]) -> list[Outlined]:
    """The grey pictures with masks in checked-out repositories, each once, cropped alike."""
    found: dict[bytes, Outlined] = {}
    for path in sorted(one for folder in folders for one in folder.glob(MASKED)):
        there = path.parents[2] / "Masks" / path.parent.name / path.name.replace("Grayscale Image", "Mask")
        image, mask = cv2.imread(str(path)), cv2.imread(str(there), cv2.IMREAD_GRAYSCALE)
        if image is not None and mask is not None:
            masks = np.stack([mask > 127, mask < 0]).astype(np.uint8)
            found[cv2.resize(image, (24, 16)).tobytes()] = _labelled(image, masks, NO_INSTRUMENT)
    return list(found.values())


def _labelled(image: Array, masks: Array, around: int) -> Outlined:
    """The view at the size of rendered ones, and its labels: open at edges of instruments, and in the second mask."""
    x, y, width, height = OnnxSegmenter.view(image)
    in_view = np.s_[y : y + height, x : x + width]
    image = np.asarray(cv2.resize(image[in_view], (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA), np.uint8)
    own, doubtful = (cv2.resize(one[in_view], (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST) for one in masks)
    is_open = (cv2.morphologyEx(own, cv2.MORPH_GRADIENT, BAND) > 0) | (doubtful > own)
    labels = np.where((picture_of(image) > 0) | (around == NO_INSTRUMENT), around, OTHER)  # dark tissue is no border
    return image, np.where(is_open, UNKNOWN, np.where(own > 0, INSTRUMENT, labels)).astype(np.uint8)


@dataclass(frozen=True)
class Shown:
    """What training shows: rendered, real and grey pictures."""

    rendered: Sequence[Rendered]
    real: Sequence[Outlined] = ()
    grey: Sequence[Outlined] = ()

    def sample(self, rng: np.random.Generator, size: Size) -> tuple[Array, Array, Array, bool]:
        """A picture, its labels and `near_keypoints`, at `size` = (h, w), and whether it is rendered, all of it."""
        over, its, points = self.rendered[int(rng.integers(len(self.rendered)))]
        if not self.real or rng.random() < DRAWN_SHARE:
            image, label, points = augmented(rng, over, its, points, size)
            return image, label, near_keypoints(points, size), True
        (image, label), nowhere, how = self._one(rng, GREY_SHARE), np.full_like(points, np.nan), rng.random()
        if how < PASTED / 2:
            over, its, points = augmented(rng, *self._one(rng, 0.5), nowhere, (HEIGHT, WIDTH))
        if how < PASTED:  # the instruments of a rendered or of another real one
            own = _instruments(its)
            share = cv2.GaussianBlur(own.astype(np.float32), (0, 0), 1.0)[..., None]
            image = (image + share * (over.astype(np.float32) - image)).astype(np.uint8)
            label = np.where(own, its, np.where(cv2.dilate(own, BAND), UNKNOWN, label)).astype(np.uint8)
        image, label, points = augmented(rng, image, label, points if how < PASTED else nowhere, size)
        if rng.random() < 0.3:  # glare, as wet tissue has: long, ragged, bright and without colour, and no instrument
            line = np.exp(-((fractal(rng, size, 2.0, 3) / rng.uniform(0.03, 0.15)) ** 2))
            shine = 255.0 * line * np.clip(4.0 * fractal(rng, size, 4.0) - 2.0, 0.0, 1.0)
            image = np.maximum(image, shine.astype(np.uint8)[..., None])
        image = filmed(rng, spoilt(rng, image, IN_VIEW)) if rng.random() < 0.5 else image
        return image, label, near_keypoints(points, size), False

    def _one(self, rng: np.random.Generator, grey_share: float) -> Outlined:
        """A real picture and its labels; of the grey ones some get the colours of tissue."""
        kind = self.grey if self.grey and rng.random() < grey_share else self.real
        image, label = kind[int(rng.integers(len(kind)))]
        return _tinted(rng, image, label) if kind is self.grey and rng.random() < TINTED else image, label


def _instruments(label: Array) -> Array:
    return np.isin(label, (DISTAL, SHAFT, INSTRUMENT)).astype(np.uint8)


def _tinted(rng: np.random.Generator, image: Array, label: Array) -> Array:
    """A grey picture with the colours of two tissues, white in highlights; instruments reflect a little of them."""
    grey, mix = image[..., :1] / np.float32(255.0), fractal(rng, label.shape, 2.0, 2)[..., None]
    one, other = (bgr / bgr.max() for bgr in (colour(rng, TISSUES), colour(rng, TISSUES)))
    tint = other + (one - other) / (1.0 + np.exp(-2.0 * mix))
    own = cv2.GaussianBlur(_instruments(label).astype(np.float32), (0, 0), 1.0)[..., None]
    tint += np.maximum(own * rng.uniform(0.6, 1.0), np.clip(3.2 * grey - 2.4, 0.0, 0.8)) * (1.0 - tint)
    return np.asarray(np.clip(280.0 * grey * tint, 0.0, 255.0), np.uint8)


def augmented(rng: np.random.Generator, image: Array, label: Array, points: Array, size: Size) -> Rendered:
    """One picture flipped, turned, nearer or farther, brighter or darker, at `size` = (h, w): not twice the same."""
    scale, middle = np.array(size[::-1]) / (WIDTH, HEIGHT), 0.5 * np.array([WIDTH - 1, HEIGHT - 1])
    much = rng.exponential(0.5) if rng.random() < 0.2 else 0.0  # a part of it, in which a shaft is wide
    nearer = np.exp(rng.normal(0.06, 0.2) + rng.normal(0.0, 0.06, 2) + much)
    cosine, sine = np.cos(angle := rng.normal(0.0, 0.25)), np.sin(angle)
    turn = scale[:, None] * [[cosine, -sine], [sine, cosine]] * nearer * rng.choice([-1, 1], 2)
    aside = rng.normal(0.0, 0.05, 2) + rng.uniform(-1.0, 1.0, 2) * (np.exp(much) - 1.0)
    shift = scale * (middle + aside * middle) - turn @ middle
    matrix, beyond = np.column_stack([turn, shift]), rng.uniform(0, 15, 3).tolist()
    image = cv2.warpAffine(image, matrix, size[::-1], flags=cv2.INTER_LINEAR, borderValue=beyond)
    label = cv2.warpAffine(label, matrix, size[::-1], flags=cv2.INTER_NEAREST, borderValue=OTHER)
    points = seen((points @ turn.T + shift).astype(np.float32), np.ones(size, np.uint8))
    return toned(rng, image, 0.5).astype(np.uint8), label, points


def near_keypoints(points: Array, size: Size) -> Array:
    """1 where a pixel of half the resolution is near to an entry, end, hinge or tip, shape (4, h / 2, w / 2)."""
    maps, radius = np.zeros((4, size[0] // 2, size[1] // 2), np.uint8), round(8 * NEAR * size[1])  # in sixteenths
    for item in points:
        for number in np.flatnonzero(np.isfinite(item[:, 0])).tolist():
            at = np.rint(8 * item[number] - 4).astype(int).tolist()
            cv2.circle(maps[min(number, 3)], at, radius, 1, cv2.FILLED, shift=4)
    return maps

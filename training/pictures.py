"""Real pictures, with outlines or masks by people, and what training makes of them and of rendered ones."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from svmdist.vision.instruments.evidence import picture_of
from svmdist.vision.network import OnnxSegmenter
from training.backgrounds import Array, Size, colour_of_tissue, fractal
from training.instruments import DISTAL, INSTRUMENT, NO_INSTRUMENT, OTHER, SHAFT, TISSUE, UNKNOWN
from training.scene import HEIGHT, WIDTH, Rendered, filmed, seen

OUTLINES = Path(__file__).with_name("outlines.json")
"""By repository and file: what it shows, outlines of instruments and of what may be one, in permille of its sides."""
MASKED = "TransUNet-single/datasets/*/*[Tt]raining/Grayscale/*/*.png"
"""Grey pictures of instruments in WeianWang-OvO/EB-GS-DualNet, beside masks of the same numbers."""
BAND_PX = 5  # to either side of an outline, where a hand is not sure
BACKGROUNDS = {"tissue": TISSUE, "room": OTHER, "": NO_INSTRUMENT}
DRAWN_SHARE, PASTED = 0.5, 0.5  # of the pictures of a step; of the real ones, with instruments of others
GREY_SHARE, TINTED = 0.22, 0.75  # of the real ones that are grey; of these, that get the colours of tissue
NEAR = 1 / 64  # of the width: how near to a keypoint a pixel counts as on it
Outlined = tuple[Array, Array]
"""Pictures (n, HEIGHT, WIDTH, 3) in BGR, and their labels (n, HEIGHT, WIDTH)."""
Sample = tuple[Array, Array, Array, bool]
HELD_OUT = re.compile("images/000(02|27)-")  # two operations, to measure on


def outlined(folders: Sequence[Path]) -> Outlined | None:
    """The pictures with outlines in checked-out repositories, cropped to what the endoscope shows; None of none."""
    known = json.loads(OUTLINES.read_text("utf-8"))
    pictures = [(folder / name, one) for folder in folders for name, one in known.get(folder.name, {}).items()]
    found = [_outlined(path, **one) for path, one in pictures if not HELD_OUT.search(str(path))]
    return _stacked(found)


def masked(folders: Sequence[Path]) -> Outlined | None:
    """The grey pictures with masks in checked-out repositories, each once; None of none."""
    found: dict[bytes, Outlined] = {}
    for path in sorted(one for folder in folders for one in folder.glob(MASKED)):
        image = cv2.imread(str(path))
        there = path.parents[2] / "Masks" / path.parent.name / path.name.replace("Grayscale Image", "Mask")
        mask = cv2.imread(str(there), cv2.IMREAD_GRAYSCALE)
        if image is None or mask is None:
            continue
        own = (cv2.resize(mask, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST) > 127).astype(np.uint8)
        edge = cv2.morphologyEx(own, cv2.MORPH_GRADIENT, np.ones((7, 7), np.uint8)) > 0
        labels = np.where(edge, UNKNOWN, np.where(own, INSTRUMENT, NO_INSTRUMENT)).astype(np.uint8)
        shown = np.asarray(cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA), np.uint8)
        found[cv2.resize(image, (24, 16)).tobytes()] = shown, labels
    return _stacked(list(found.values()))


def _stacked(found: list[Outlined]) -> Outlined | None:
    images, labels = zip(*found, strict=True) if found else ((), ())
    return (np.stack(images), np.stack(labels)) if found else None


def _outlined(path: Path, shows: str, outlines: Sequence[Sequence[list[int]]] = ((), ())) -> Outlined:
    video = cv2.VideoCapture(str(path))  # reads a single picture, too
    video.set(cv2.CAP_PROP_POS_FRAMES, int(0.7 * video.get(cv2.CAP_PROP_FRAME_COUNT)))
    there, read = video.read()
    if not there:
        raise SystemExit(f"{path}: expected a picture")
    image, masks = np.asarray(read, np.uint8), np.zeros((2, HEIGHT, WIDTH), np.uint8)
    x, y, width, height = OnnxSegmenter.view(image)
    for mask, of_it in zip(masks, outlines, strict=True):
        for outline in of_it:
            corners = np.reshape(outline, (-1, 2)) / 1000.0 * image.shape[1::-1] - (x, y)
            corners = np.rint(16.0 * (corners * (WIDTH / width, HEIGHT / height) - 0.5))
            cv2.fillPoly(mask, [corners.astype(np.int32)], 1, shift=4)
    view = image[y : y + height, x : x + width]
    view = np.asarray(cv2.resize(view, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA), np.uint8)
    labels = np.full((HEIGHT, WIDTH), BACKGROUNDS[shows], np.uint8)
    labels[picture_of(view) == 0] = OTHER
    labels[masks[0] > 0] = INSTRUMENT
    band = np.ones((2 * BAND_PX + 1, 2 * BAND_PX + 1), np.uint8)
    labels[(masks[1] > masks[0]) | (cv2.morphologyEx(masks[0], cv2.MORPH_GRADIENT, band) > 0)] = UNKNOWN
    return view, labels


@dataclass(frozen=True)
class Shown:
    """What training shows: rendered, real and grey pictures."""

    rendered: Rendered
    real: Outlined | None = None
    grey: Outlined | None = None

    def sample(self, rng: np.random.Generator, size: Size) -> Sample:
        """A picture, its labels and keypoints, at `size` = (h, w), and whether it is rendered, all of it."""
        n = int(rng.integers(len(self.rendered[0])))
        image, label, points = (kind[n] for kind in self.rendered)
        if self.real is None or rng.random() < DRAWN_SHARE:
            return *augmented(rng, image, label, points, size), True
        over, its, nowhere, how = image, label, np.full_like(points, np.nan), rng.random()
        image, label = self._one(rng, self.real, GREY_SHARE)
        if how >= PASTED:
            points = nowhere
        elif how < PASTED / 2:
            over, its, points = augmented(rng, *self._one(rng, self.real, 0.5), nowhere, (HEIGHT, WIDTH))
        if how < PASTED:  # the instruments of a rendered or of another real one
            own = _instruments(its)
            beside = cv2.dilate(own, np.ones((9, 9), np.uint8))
            share = cv2.GaussianBlur(own.astype(np.float32), (0, 0), 1.0)[..., None]
            image = (image + share * (over.astype(np.float32) - image)).astype(np.uint8)
            label = np.where(own > 0, its, np.where(beside > 0, UNKNOWN, label)).astype(np.uint8)
        image, label, points = augmented(rng, image, label, points, size)
        image = _shining(rng, image) if rng.random() < 0.3 else image
        image = filmed(rng, image) if rng.random() < 0.5 else image
        return image, label, points, False

    def _one(self, rng: np.random.Generator, real: Outlined, grey_share: float) -> Outlined:
        """A real picture and its labels; of the grey ones some get the colours of tissue."""
        grey = self.grey if rng.random() < grey_share else None
        images, labels = real if grey is None else grey
        n = int(rng.integers(len(images)))
        is_tinted = grey is not None and rng.random() < TINTED
        return _tinted(rng, images[n], labels[n]) if is_tinted else images[n], labels[n]


def _instruments(label: Array) -> Array:
    return np.isin(label, (DISTAL, SHAFT, INSTRUMENT)).astype(np.uint8)


def _tinted(rng: np.random.Generator, image: Array, label: Array) -> Array:
    """A grey picture with the colours of two tissues, white in highlights; instruments reflect a little of them."""
    grey, mix = image[..., :1] / np.float32(255.0), fractal(rng, label.shape, 2.0, 2)[..., None]
    one, other = (colour / colour.max() for colour in (colour_of_tissue(rng), colour_of_tissue(rng)))
    colour = other + (one - other) / (1.0 + np.exp(-2.0 * mix))
    colour += (1.0 - colour) * 0.8 * np.clip(4.0 * grey - 3.0, 0.0, 1.0)
    own = cv2.GaussianBlur(_instruments(label).astype(np.float32), (0, 0), 1.0)[..., None]
    colour += own * (1.0 - rng.uniform(0.0, 0.4)) * (1.0 - colour)
    return np.asarray(np.clip(280.0 * grey * colour, 0.0, 255.0), np.uint8)


def _shining(rng: np.random.Generator, image: Array) -> Array:
    """With a ragged band of glare, as wet tissue has: long, bright and without colour, and no instrument."""
    shine, width = np.zeros(image.shape[:2], np.uint8), image.shape[1]
    begin, end = rng.uniform(-0.1, 1.1, (2, 2)) * image.shape[1::-1]
    for share in np.arange(0.0, rng.uniform(0.1, 1.0), 0.01):
        at = begin + share * (end - begin) + rng.normal(0.0, width / 80, 2)
        axes = np.maximum(1, rng.uniform(0.25, 1.2, 2) * width / 40).astype(int).tolist()
        cv2.ellipse(shine, at.astype(int).tolist(), axes, rng.uniform(0, 180), 0, 360, 255, cv2.FILLED)
    return np.maximum(image, cv2.GaussianBlur(shine, (0, 0), rng.uniform(0.4, 1.6))[..., None])


def augmented(rng: np.random.Generator, image: Array, label: Array, points: Array, size: Size) -> Rendered:
    """One picture flipped, turned, nearer or farther, brighter or darker, at `size` = (h, w): not twice the same."""
    scale, middle = np.array(size[::-1]) / (WIDTH, HEIGHT), 0.5 * np.array([WIDTH - 1, HEIGHT - 1])
    much = rng.exponential(0.5) if rng.random() < 0.2 else 0.0  # a part of it, in which a shaft is wide
    angle, nearer = rng.normal(0.0, 0.25), np.exp(rng.normal(0.06, 0.2) + rng.normal(0.0, 0.06, 2) + much)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turn = scale[:, None] * turn * nearer * rng.choice([-1, 1], 2)
    aside = rng.normal(0.0, 0.05, 2) + rng.uniform(-1.0, 1.0, 2) * (np.exp(much) - 1.0)
    shift = scale * (middle + aside * middle) - turn @ middle
    matrix, beyond = np.column_stack([turn, shift]), rng.uniform(0, 15, 3).tolist()
    if rng.random() < 0.5:  # pixels are areas
        image = cv2.GaussianBlur(image, (0, 0), 0.45 / float(scale.mean() * nearer.mean()))
    image = cv2.warpAffine(image, matrix, size[::-1], flags=cv2.INTER_LINEAR, borderValue=beyond)
    label = cv2.warpAffine(label, matrix, size[::-1], flags=cv2.INTER_NEAREST, borderValue=OTHER)
    gamma, gain = np.exp(rng.normal(0.0, 0.15)), np.exp(rng.normal(0.0, 0.1, 3) + rng.normal(0.0, 0.12))
    table = np.clip(255.0 * (np.arange(256)[:, None] / 255.0) ** gamma * gain, 0, 255).astype(np.uint8)
    moved = (points @ turn.T + shift).astype(np.float32)
    return table[image, range(3)], label, seen(moved, np.ones(size, np.uint8))


def near_keypoints(points: Array, size: Size) -> Array:
    """1 where a pixel of half the resolution is near to an entry, end, hinge or tip, shape (4, h / 2, w / 2)."""
    maps, radius = np.zeros((4, size[0] // 2, size[1] // 2), np.uint8), round(8 * NEAR * size[1])
    for item in points:
        for number in np.flatnonzero(np.isfinite(item[:, 0])).tolist():
            at = np.rint(8 * item[number] - 4).astype(int).tolist()  # in sixteenths
            cv2.circle(maps[min(number, 3)], at, radius, 1, cv2.FILLED, shift=4)
    return maps

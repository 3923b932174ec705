"""Which colours are instrument and which are not, learnt from images: a table of log-likelihood ratios.

Background and instrument are histograms of colour ratios and brightness (Jones and Rehg 2002 tell skin so). What is
as achromatic as the instruments seen counts as instrument at any brightness: glare is brighter than a shaft, and steel
is brighter than both.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.samples import Image
from svmdist.vision.instruments.working import Floats, WorkingImage

BINS = (20, 20, 12)
LOWEST = np.array([-0.7, -0.9, 2.0], np.float32)
HIGHEST = np.array([1.5, 1.0, 5.6], np.float32)
"""Bounds of log(R/G), log(G/B) and the mean logarithm: what lies outside counts with the nearest bin."""
ACHROMATIC_SHARE = 0.3
"""How much of an instrument is steel and glare that no image before has shown."""
ACHROMATIC_STD = 0.15
"""How far the colour ratio of steel is from that of the instruments seen: light that tissue has reflected."""
UNKNOWN_SHARE = 0.02
"""How much of anything has a colour not seen before: it speaks for neither."""
MOST_RATIO = 4.0
"""One pixel's colour says no more than this, as the logarithm of a likelihood ratio."""


@dataclass(frozen=True)
class Appearance:
    """log(P(colour | instrument) / P(colour | background)), shape `BINS`."""

    ratios: Floats

    def of(self, image: WorkingImage) -> Floats:
        """How much the colours of an image speak for an instrument, shape (h, w), neighbours averaged."""
        ratio = self.ratios.reshape(-1)[_bins_of(image.colours)]
        return np.asarray(cv2.GaussianBlur(ratio, (0, 0), 1.2), np.float32)


@dataclass(frozen=True)
class Example:
    """An image with masks, shape (h, w), of what is instrument and of what is background for sure."""

    image: WorkingImage
    instrument: Image
    background: Image


def learnt_from(examples: Iterable[Example]) -> Appearance | None:
    """Learn from examples, all alike in weight for each pixel; None where they show no instrument or no background."""
    inside, outside = np.zeros(BINS, np.float64), np.zeros(BINS, np.float64)
    ratios: list[Floats] = []
    for example in examples:
        colours = example.image.colours
        own = colours[example.instrument > 0]
        inside += _counts(own)
        outside += _counts(colours[example.background > 0])
        ratios.append(np.asarray(own[:, :2], np.float32))
    if not inside.any() or not outside.any():
        return None
    neutral = np.median(np.vstack(ratios), axis=0)
    instrument = (1.0 - ACHROMATIC_SHARE) * _smooth(inside) + ACHROMATIC_SHARE * _achromatic(neutral)
    unknown = UNKNOWN_SHARE / float(np.prod(BINS))
    ratio = np.log((instrument + unknown) / (_smooth(outside) + unknown))
    return Appearance(np.clip(ratio, -MOST_RATIO, MOST_RATIO).astype(np.float32))


def _bins_of(colours: Floats) -> NDArray[np.int32]:
    """The bin of each colour, shape (...,), of colours, shape (..., 3)."""
    scaled = (colours - LOWEST) * (np.array(BINS, np.float32) / (HIGHEST - LOWEST))
    at = np.clip(scaled, 0, np.array(BINS, np.float32) - 1).astype(np.int32)
    return np.asarray((at[..., 0] * BINS[1] + at[..., 1]) * BINS[2] + at[..., 2], np.int32)


def _counts(colours: Floats) -> NDArray[np.float64]:
    return np.bincount(_bins_of(colours), minlength=int(np.prod(BINS))).reshape(BINS).astype(np.float64)


def _smooth(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Counts as probabilities, shape `BINS`, each shared with its neighbours: noise is wider than a bin."""
    for axis in range(3):
        padded = np.pad(counts, [(2, 2) if other == axis else (0, 0) for other in range(3)])
        length = counts.shape[axis]
        taps = (1 / 16, 4 / 16, 6 / 16, 4 / 16, 1 / 16)
        counts = sum(
            (tap * np.take(padded, range(at, at + length), axis=axis) for at, tap in enumerate(taps)),
            np.zeros_like(counts),
        )
    return np.asarray(counts / counts.sum())


def _achromatic(neutral: Floats) -> NDArray[np.float64]:
    """Probabilities, shape `BINS`, of what has about the colour ratios `neutral`, shape (2,), at any brightness."""
    density = np.ones(BINS)
    for axis in range(2):
        step = float(HIGHEST[axis] - LOWEST[axis]) / BINS[axis]
        centres = LOWEST[axis] + step * (np.arange(BINS[axis]) + 0.5)
        bell = np.exp(-0.5 * ((centres - neutral[axis]) / ACHROMATIC_STD) ** 2)
        density = density * np.expand_dims(bell, [other for other in range(3) if other != axis])
    return np.asarray(density / density.sum())

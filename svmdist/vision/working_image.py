"""The working image of `auto`: small, with colours as logarithms of ratios, and which of them are instrument."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.profile.settings import AutoSettings
from svmdist.samples import Image
from svmdist.vision.colour import field_of_view

# A black border differs from the darkest thing in the image by no more: noise and compression
BORDER_LEVELS = 6.0
BORDER_FLOOR_LEVEL = 10.0  # what is darker than this is border, whatever the darkest thing is
BORDER_FRACTION = 0.4  # of the picture's median; a border is darker, though haze may lift it
# Added to levels before their logarithm is taken: noise of one or two levels must not be a colour
LEVEL_OFFSET = 8.0

Floats = NDArray[np.float32]
Hint = Callable[[Image], Floats]  # gives log odds of instrument, shape (h, w), of an image, shape (h, w, 3)

SQUARE_3 = np.ones((3, 3), np.uint8)
SQUARE_5 = np.ones((5, 5), np.uint8)
SQUARE_9 = np.ones((9, 9), np.uint8)


@dataclass(frozen=True)
class WorkingImage:
    """A small BGR image (h, w, 3), the mask of what is picture, its scale, and log odds of instrument on demand."""

    bgr: Image
    picture: Image
    scale: float
    settings: AutoSettings
    hinting: Hint | None = None

    @classmethod
    def of(cls, bgr: Image, settings: AutoSettings, hinting: Hint | None = None) -> WorkingImage:
        """Make it of an image of any size."""
        height, width = bgr.shape[:2]
        scale = settings.working_px / max(width, height)
        size = (round(scale * width), round(scale * height))
        how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
        small = np.asarray(cv2.resize(bgr, size, interpolation=how), np.uint8)
        return cls(small, picture_of(small), scale, settings, hinting)

    @cached_property
    def hint(self) -> Floats:
        """Log odds of instrument that are known beside colours, shape (h, w); 0 without `hinting`."""
        if self.hinting is None or self.settings.network_weight == 0.0:
            return np.zeros(self.picture.shape, np.float32)
        return np.asarray(self.settings.network_weight * self.hinting(self.bgr), np.float32)

    @cached_property
    def core(self) -> Image:
        """The picture without its outermost 2 px, where the optics fade."""
        return np.asarray(cv2.erode(self.picture, SQUARE_5, borderValue=0), np.uint8)

    @cached_property
    def rim(self) -> Image:
        """The outermost pixels of the core, through which instruments come in."""
        return np.asarray(cv2.subtract(self.core, cv2.erode(self.core, SQUARE_3, borderValue=0)), np.uint8)

    @cached_property
    def inner(self) -> NDArray[np.bool_]:
        """What is so far from the rim that an outline there is a thing's own."""
        return np.asarray(cv2.erode(self.core, SQUARE_5, borderValue=0), np.uint8) > 0

    @cached_property
    def area_px(self) -> int:
        """Pixels of the core."""
        return max(int(cv2.countNonZero(self.core)), 1)

    @cached_property
    def colours(self) -> Floats:
        """log(R/G), log(G/B) and the mean of all three logarithms, shape (h, w, 3): light scales only the last."""
        return self._logs(LEVEL_OFFSET)

    @cached_property
    def warmth(self) -> Floats:
        """log(R/√(GB)), shape (h, w): high in tissue and blood, low in steel."""
        return np.asarray(self.colours[..., 0] + 0.5 * self.colours[..., 1], np.float32)

    @cached_property
    def channels(self) -> tuple[Floats, ...]:
        """What instruments may be low in, shape (h, w) each: warmth, twice, chroma, light, and darkness."""
        keen, blunt = (self._logs(factor * LEVEL_OFFSET) for factor in (0.5, 3.0))
        chroma, light = np.hypot(blunt[..., 0], blunt[..., 1]), self.colours[..., 2]
        return *(logs[..., 0] + 0.5 * logs[..., 1] for logs in (keen, blunt)), chroma, light, -light

    def _logs(self, offset: float) -> Floats:
        """log(R/G), log(G/B) and the mean logarithm of the softened image with `offset` levels added to each."""
        softened = cv2.GaussianBlur(self.bgr, (0, 0), 0.8)
        table = np.log(np.arange(256, dtype=np.float32) + np.float32(offset))
        blue, green, red = (np.asarray(cv2.LUT(level, table), np.float32) for level in cv2.split(softened))
        return np.asarray(cv2.merge([red - green, green - blue, (red + green + blue) / 3.0]), np.float32)


def picture_of(bgr: Image) -> Image:
    """Mask, shape (h, w), of the picture inside its border, whatever its shape; all of an image without a border."""
    value = bgr.max(axis=2)
    floor = float(np.percentile(value, 0.5))
    level = max(floor + BORDER_LEVELS, BORDER_FLOOR_LEVEL)
    above = value[value > level]
    whole = np.full(bgr.shape[:2], 255, np.uint8)
    if not len(above) or floor > BORDER_FRACTION * float(np.median(above)):
        return whole
    view = field_of_view(np.asarray(255 * (value <= level), np.uint8))
    return view if view.any() else whole


BINS = (20, 20, 12)
LOWEST = np.array([-0.7, -0.9, 2.0], np.float32)
HIGHEST = np.array([1.5, 1.0, 5.6], np.float32)
"""Bounds of log(R/G), log(G/B) and the mean logarithm: what lies outside counts with the nearest bin."""
ACHROMATIC_SHARE = 0.3  # how much of an instrument is steel and glare that no image before has shown
ACHROMATIC_STD = 0.15
"""How far the colour ratio of steel is from that of the instruments seen: light that tissue has reflected."""
UNKNOWN_SHARE = 0.02  # how much of anything has a colour not seen before: it speaks for neither
MOST_RATIO = 4.0  # one pixel's colour says no more than this, as the logarithm of a likelihood ratio


@dataclass(frozen=True)
class Appearance:
    """log(P(colour | instrument) / P(colour | background)), shape `BINS`."""

    ratios: Floats

    def of(self, image: WorkingImage) -> Floats:
        """How much the colours of an image speak for an instrument, shape (h, w), neighbours averaged."""
        ratio = self.ratios.reshape(-1)[_bins_of(image.colours)]
        return np.asarray(cv2.GaussianBlur(ratio, (0, 0), 1.2), np.float32)


Example = tuple[Floats, Floats]
"""Colours, shape (n, 3) each, of what is instrument and of what is background for sure."""


def learnt_from(examples: Sequence[Example]) -> Appearance | None:
    """Learn from examples, all alike in weight for each pixel; None where they show no instrument or no background."""
    inside = sum((_counts(own) for own, _ in examples), np.zeros(BINS))
    outside = sum((_counts(other) for _, other in examples), np.zeros(BINS))
    if not inside.any() or not outside.any():
        return None
    neutral = np.median(np.vstack([own[:, :2] for own, _ in examples]), axis=0)
    instrument = (1.0 - ACHROMATIC_SHARE) * _smooth(inside) + ACHROMATIC_SHARE * _achromatic(neutral)
    unknown = UNKNOWN_SHARE / float(np.prod(BINS))
    ratio = np.log((instrument + unknown) / (_smooth(outside) + unknown))
    return Appearance(np.clip(ratio, -MOST_RATIO, MOST_RATIO).astype(np.float32))


def _bins_of(colours: Floats) -> NDArray[np.int32]:
    bins = np.array(BINS, np.float32)
    at = np.clip((colours - LOWEST) * (bins / (HIGHEST - LOWEST)), 0, bins - 1).astype(np.int32)
    return np.asarray((at[..., 0] * BINS[1] + at[..., 1]) * BINS[2] + at[..., 2], np.int32)


def _counts(colours: Floats) -> NDArray[np.float64]:
    return np.bincount(_bins_of(colours), minlength=int(np.prod(BINS))).reshape(BINS).astype(np.float64)


TAPS = (1 / 16, 4 / 16, 6 / 16, 4 / 16, 1 / 16)


def _smooth(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Counts as probabilities, shape `BINS`, each shared with its neighbours: noise is wider than a bin."""
    for axis, length in enumerate(BINS):
        padded = np.pad(counts, [(2, 2) if other == axis else (0, 0) for other in range(3)])
        shifted = [np.take(padded, range(at, at + length), axis=axis) for at in range(5)]
        counts = sum((tap * part for tap, part in zip(TAPS, shifted, strict=True)), np.zeros(BINS))
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


DISTINCT_SHARE = 0.7
"""Of the variance of warmth that is between the redder part and the rest, not within: less is one kind of tissue."""
DISTINCT_WARMTH = 0.4
"""How much redder the one must be than the other, as a logarithm: organ on a drape, not fat beside muscle."""


def tissue_of(image: WorkingImage) -> Image:
    """Mask, shape (h, w), of what may be tissue; instruments are not yet taken out of it."""
    warmth = image.warmth
    values = warmth[image.core > 0]
    if not len(values):
        return image.picture
    low, high = np.percentile(values, (1, 99))
    if high - low < DISTINCT_WARMTH:
        return image.picture
    levels = np.clip((warmth - low) * (255.0 / (high - low)), 0, 255).astype(np.uint8)
    inside = levels[image.core > 0].reshape(-1, 1)
    threshold, _ = cv2.threshold(inside, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    red = inside > threshold
    share = float(np.mean(red))
    if not 0.0 < share < 1.0:
        return image.picture
    shown = inside.astype(np.float64)
    apart = float(shown[red].mean() - shown[~red].mean())
    between = share * (1.0 - share) * apart**2 / max(float(shown.var()), 1e-9)
    if between < DISTINCT_SHARE or apart * (high - low) / 255.0 < DISTINCT_WARMTH:
        return image.picture
    return np.asarray(np.where(levels > threshold, image.picture, 0), np.uint8)

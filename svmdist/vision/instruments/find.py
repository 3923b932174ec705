"""Finding the instruments of an image: bars in what looks like instrument, and what belongs to each of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.samples import Image
from svmdist.vision.instruments.appearance import Appearance, Example, learnt_from
from svmdist.vision.instruments.bars import Bar, bars_in
from svmdist.vision.instruments.belonging import belonging, with_missed_parts
from svmdist.vision.instruments.evidence import JudgedBar, judged
from svmdist.vision.instruments.sharpen import sharpened
from svmdist.vision.instruments.working import SQUARE_3, SQUARE_5, Floats, WorkingImage
from svmdist.vision.instruments.zones import Zones

PERCENTILES = (4, 8, 13, 19, 26, 34)
"""Of each channel in the picture: thresholds under which instruments are sought. They cover 3 to 40 % of a picture."""
RATIO_LEVELS = (0.0, 1.0, 2.0)
"""Of the log ratio: at higher ones a shaft parts from a shadow beside it, at lower ones all of it is there."""
ROUND_7 = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
SQUARE_9 = np.ones((9, 9), np.uint8)


@dataclass(frozen=True)
class Found:
    """An instrument in a working image: its bar from the border inwards, its mask, shape (h, w), and the evidence."""

    bar: Bar
    mask: NDArray[np.bool_]
    evidence: float


def learnt_appearance(images: Sequence[WorkingImage]) -> Appearance | None:
    """What instruments look like in images of one log; None where none of them shows one for sure.

    First from bars in whatever channel they are straightest in; then once more from all of what those colours show.
    """
    bars = [search_bars(image) for image in images]
    first = learnt_from(
        example for image, sought in zip(images, bars, strict=True) if (example := _of_bars(image, sought))
    )
    if first is None:
        return None
    examples = []
    for image, sought in zip(images, bars, strict=True):
        found = find_instruments(image, first, sought)
        if found:
            mask = np.asarray(np.any([one.mask for one in found], axis=0), np.uint8) * 255
            inside, near = cv2.erode(mask, SQUARE_3), cv2.dilate(mask, SQUARE_9)
            examples.append(
                Example(
                    image, np.asarray(inside, np.uint8), np.asarray(cv2.subtract(image.core, near), np.uint8)
                )
            )
    return learnt_from(examples) or first


def search_bars(image: WorkingImage) -> list[JudgedBar]:
    """Bars of an image of which nothing is known, the surest first: none overlaps a surer one by much."""
    sought: list[JudgedBar] = []
    for channel in image.channels:
        values = channel[image.core > 0]
        for level in np.percentile(values, PERCENTILES) if len(values) else ():
            low = np.asarray(255 * ((channel < level) & (image.core > 0)), np.uint8)
            sought += _judged_bars(
                np.asarray(cv2.morphologyEx(low, cv2.MORPH_OPEN, SQUARE_3), np.uint8), image, 1
            )
    return _apart(sought, image)


def find_instruments(
    image: WorkingImage, appearance: Appearance | None, sought: Sequence[JudgedBar] = ()
) -> list[Found]:
    """The instruments of an image, the surest first. `sought` are bars that are known without their colours.

    Without an appearance, only what else is known of its pixels tells where to look.
    """
    ratio = image.hint if appearance is None else appearance.of(image) + image.hint
    settings = image.settings
    likely = _above(ratio, 0.0, image)
    bars = [
        one
        for level in RATIO_LEVELS
        for one in _judged_bars(_above(ratio, level, image) if level else likely, image, 3, ratio)
    ]
    bars += [one for one in sought if one.evidence > settings.sure_evidence]
    bars.sort(key=lambda one: -one.evidence)
    bars = [JudgedBar(sharpened(one.bar, image), one.evidence) for one in bars]
    taken = np.zeros(image.core.shape, bool)
    found: list[Found] = []
    for one in bars:
        zones = Zones.of(one.bar, image)
        size = max(int(np.count_nonzero(zones.middle)), 1)
        if np.count_nonzero(zones.middle & taken) > 0.3 * size:
            continue
        if np.count_nonzero(zones.middle & (likely > 0)) < 0.6 * size:
            continue
        mask = belonging(zones, likely, ratio, image)
        if np.count_nonzero(mask & ~taken) < settings.least_area * image.area_px:
            continue
        taken |= mask
        found.append(Found(one.bar, mask, one.evidence))
        if len(found) >= settings.most_instruments:
            break
    masks = with_missed_parts([one.mask for one in found], ratio, image)
    return [replace(one, mask=mask) for one, mask in zip(found, masks, strict=True)]


def _above(ratio: Floats, level: float, image: WorkingImage) -> Image:
    """What speaks for an instrument by more than a level, without specks and gaps, shape (h, w)."""
    mask = np.asarray(255 * ((ratio > level) & (image.core > 0)), np.uint8)
    mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, SQUARE_3), np.uint8)
    return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, ROUND_7), np.uint8) & image.core


def _judged_bars(
    mask: Image, image: WorkingImage, most_bars: int, ratio: Floats | None = None
) -> list[JudgedBar]:
    settings = image.settings
    every = (
        judged(bar, part, image, ratio) for bar, part in bars_in(mask, image, settings.most_area, most_bars)
    )
    return [one for one in every if one is not None and one.evidence > settings.least_evidence]


def _apart(sought: list[JudgedBar], image: WorkingImage) -> list[JudgedBar]:
    shape = image.core.shape[0], image.core.shape[1]
    taken = np.zeros(shape, np.uint8)
    kept: list[JudgedBar] = []
    for one in sorted(sought, key=lambda one: -one.evidence):
        strip = one.bar.filled(shape)
        if cv2.countNonZero(strip & taken) <= 0.3 * cv2.countNonZero(strip):
            taken |= strip
            kept.append(one)
    return kept[: image.settings.most_instruments + 1]


def _of_bars(image: WorkingImage, sought: Sequence[JudgedBar]) -> Example | None:
    """What the sure bars of an image teach; what is near to any bar may be either, and teaches nothing."""
    if not sought or sought[0].evidence < image.settings.teaching_evidence:
        return None
    shape = image.core.shape[0], image.core.shape[1]
    least = min(0.6 * sought[0].evidence, image.settings.sure_evidence)
    inside, near = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    for one in sought:
        strip = one.bar.filled(shape)
        reach: NDArray[np.uint8] = SQUARE_5
        if one.evidence >= least:
            inside |= np.asarray(cv2.erode(strip, SQUARE_3), np.uint8)
            size = int(2.0 * one.bar.width_px) | 1
            reach = np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), np.uint8)
        near |= np.asarray(cv2.dilate(strip, reach), np.uint8)
    return Example(image, inside, np.asarray(cv2.subtract(image.core, near), np.uint8))

"""What of an image belongs to an instrument whose bar is known: pixels that are likely, in reach, and hang together."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.samples import Image
from svmdist.vision.instruments.working import SQUARE_3, SQUARE_5, Floats, WorkingImage
from svmdist.vision.instruments.zones import Zones

RATIO_SURE = 1.5
"""A colour that speaks for an instrument by more belongs to the one that it touches."""
RATIO_DOUBT = 2.0
"""A colour that speaks against an instrument by no more may be that of a wrist."""
FAR_D2 = 16.0
"""Squared deviation from the colours around, of three numbers, that one in a thousand exceeds."""
MOST_GOING_ON_PX = 3
"""Pixels of a part beside a bar that may touch what goes on beyond."""
MOST_CUT_FRACTION = 0.08
"""Of the border of where wrist and jaws can be: where more of it is likely on both sides, they end elsewhere."""
MOST_ELSEWHERE = 0.05
"""Of the instruments' pixels: with more that looks like them apart from them, likeness says little."""
LEAST_MISSED_PART = 0.2
"""Of an instrument's pixels: smaller parts beside it are shadows and reflections, which parts of a shaft are not."""
SQUARE_9 = np.ones((9, 9), np.uint8)


def belonging(zones: Zones, likely: Image, ratio: Floats, image: WorkingImage) -> NDArray[np.bool_]:
    """What of the likely pixels belongs to the instrument of these zones: what hangs together with its bar.

    `likely`, shape (h, w), is what looks like an instrument, and `ratio` how much.
    """
    likely = likely | _unlike_nearby(zones, ratio, image)
    sure = ratio > RATIO_SURE
    distal = zones.distal & (likely > 0)
    if _is_cut_off(distal, zones, likely):
        distal = zones.narrow & (likely > 0)
    beside = _ending_there(zones.beside & sure & (image.core > 0) & ~zones.strip, zones, likely)
    mine = distal | (zones.strip & (likely > 0)) | beside | zones.middle
    _, labels = cv2.connectedComponents(mine.astype(np.uint8))
    names = np.unique(labels[zones.middle])
    mask = np.isin(labels, names[names > 0]) & (image.core > 0)
    mask = _without_holes(mask, 0.003 * image.area_px)
    # Where the optics fade, colours tell nothing; the instrument goes on to the border of the picture.
    outside = zones.strip & (image.picture > 0) & (image.core == 0)
    return np.asarray(mask | (outside & (cv2.dilate(mask.astype(np.uint8), SQUARE_5) > 0)))


def with_missed_parts(
    masks: Sequence[NDArray[np.bool_]], ratio: Floats, image: WorkingImage
) -> list[NDArray[np.bool_]]:
    """The instruments' masks with large parts that look like them and touch them: a shaft found by its narrow wrist.

    Only where next to nothing else in the picture looks so: then it is no colour of the background's.
    """
    mask = np.any(masks, axis=0) if masks else np.zeros(image.core.shape, bool)
    rest = np.asarray(((ratio > RATIO_SURE) & image.inner & ~mask).astype(np.uint8))
    rest = np.asarray(cv2.morphologyEx(rest, cv2.MORPH_OPEN, SQUARE_3), np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(rest)
    touching = [np.bincount(labels[_grown(one)], minlength=count) > 0 for one in masks]
    size = stats[:, cv2.CC_STAT_AREA]
    parts = range(1, count)
    apart = sum(int(size[part]) for part in parts if not any(near[part] for near in touching))
    if apart > MOST_ELSEWHERE * np.count_nonzero(mask):
        return list(masks)
    completed = []
    for one, near in zip(masks, touching, strict=True):
        least = LEAST_MISSED_PART * np.count_nonzero(one)
        missed = [part for part in parts if near[part] and size[part] > least]
        completed.append(np.asarray(one | np.isin(labels, missed)) if missed else one)
    return completed


def _unlike_nearby(zones: Zones, ratio: Floats, image: WorkingImage) -> Image:
    """What in the distal zone has not the colours around it, shape (h, w): wrists are reddish by tissue's reflection.

    The colours around are one normal distribution; a pixel far outside of it is not of what lies there.
    """
    near = cv2.dilate(zones.distal.astype(np.uint8), SQUARE_9) > 0
    around = near & ~zones.distal & ~zones.strip & (image.core > 0) & (ratio < 0.0)
    inside = zones.distal & (image.core > 0) & (ratio > -RATIO_DOUBT)
    if np.count_nonzero(around) < 50 or not inside.any():
        return np.zeros_like(image.core)
    sample = image.colours[around].astype(np.float64)
    centre = np.median(sample, axis=0)
    spread = np.cov(sample.T) + np.diag([0.03, 0.03, 0.1]) ** 2
    off = image.colours[inside] - centre
    far = np.einsum("ni,ij,nj->n", off, np.linalg.inv(spread), off) > FAR_D2
    mask = np.zeros_like(image.core)
    mask[inside] = 255 * far
    return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, SQUARE_3), np.uint8)


def _ending_there(beside: NDArray[np.bool_], zones: Zones, likely: Image) -> NDArray[np.bool_]:
    """The parts beside a bar that end within what a shaft takes up; what goes on is a thing beside the shaft."""
    count, labels, _, _ = cv2.connectedComponentsWithStats(beside.astype(np.uint8))
    if count < 2:
        return beside
    outside = (likely > 0) & ~zones.beside & ~zones.distal
    near = cv2.dilate(outside.astype(np.uint8), SQUARE_3) > 0
    goes_on = np.bincount(labels[near & beside], minlength=count) > MOST_GOING_ON_PX
    goes_on[0] = True
    return np.asarray(~goes_on[labels])


def _is_cut_off(distal: NDArray[np.bool_], zones: Zones, likely: Image) -> bool:
    """Whether what looks like wrist and jaws goes on beyond what those can reach: then it is a thing behind them."""
    around = (cv2.dilate(zones.distal.astype(np.uint8), SQUARE_3) > 0) & ~zones.distal & ~zones.beside
    beyond = around & (likely > 0) & (cv2.dilate(distal.astype(np.uint8), SQUARE_3) > 0)
    return int(np.count_nonzero(beyond)) > MOST_CUT_FRACTION * int(np.count_nonzero(around))


def _without_holes(mask: NDArray[np.bool_], most_px: float) -> NDArray[np.bool_]:
    """The mask with its small holes filled: glare and blood; through a large one tissue is seen."""
    solid = mask.astype(np.uint8)
    contours, _ = cv2.findContours(solid, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    whole = np.zeros_like(solid)
    cv2.drawContours(whole, contours, -1, 1, cv2.FILLED)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(cv2.subtract(whole, solid))
    small = [label for label in range(1, count) if stats[label, cv2.CC_STAT_AREA] < most_px]
    return np.asarray(mask | np.isin(labels, small))


def _grown(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.asarray(cv2.dilate(mask.astype(np.uint8), SQUARE_5) > 0)

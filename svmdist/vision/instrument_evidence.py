"""What speaks for a bar being an instrument, and which pixels belong to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.instrument_bars import BRIGHTNESS_STEP, COLOUR_STEP, Bar, Zones
from svmdist.vision.working_image import SQUARE_3, SQUARE_5, SQUARE_9, Floats, WorkingImage

LEAST_LENGTH_WIDTHS = 0.8  # of both sides, over the width: less is any blob that has been cut off
LEAST_LENGTH_PX = 12.0  # the same in px: shorter edges of tissue are straight by chance
REACH_PX = 2.5  # colours beside a side are compared this far inside and outside of it
LEAST_STEP_FRACTION = 0.6  # part of each side along which there is a step; shadows have none of that height
LEAST_RATIO_STEP = 1.0  # a step in the log ratio of colour likelihoods, once they are known
LEAST_COOLER = 0.05  # how much less red an instrument is than what is on either side of it, as a logarithm
LEAST_DARKER = 0.25  # how much darker, where it is not less red: dark steel on grey paper
MOST_WARMER = 0.08  # how much redder it may then be, where it has a colour
GREY_CHROMA = 0.15  # less chroma is no colour: paper in bluish light makes grey steel look redder
MOST_YELLOWER = 0.15  # than either side: fat is less red than muscle, and no instrument
YELLOW_FROM = 0.3  # log(G/B) of something yellow: beside purple tissue steel is more yellow, and is not

Value = TypeVar("Value", bound=np.uint8 | np.float32)


def judged(bar: Bar, part: Image, image: WorkingImage, ratio: Floats | None = None) -> Bar | None:
    """A bar on the outline of a part, shape (h, w), from the border inwards with its evidence; None of no instrument.

    `ratio`, shape (h, w), is how much each pixel's colour speaks for an instrument, where that is known.

    An instrument is straight over most of its length and comes in through the border. Across both of its sides colour
    or brightness changes at once, where a shadow's fade; and it is less red than what is on either side, or darker
    and no redder.
    """
    if bar.length_px < max(LEAST_LENGTH_WIDTHS * bar.width_px, LEAST_LENGTH_PX):
        return None
    inwards = _from_border(bar, part, image)
    if inwards is None:
        return None
    sides = [_steps(inwards, side, image, ratio) for side in (0, 1)]
    if None in sides:
        return None
    steps = np.array(sides)
    fraction, cooler, darker, likelier = (float(value) for value in steps.min(0)[:4])
    chroma, yellower, yellow = steps.max(0)[4:]
    is_cooler = cooler > LEAST_COOLER
    is_darker = darker > LEAST_DARKER and (cooler > -MOST_WARMER or chroma < GREY_CHROMA)
    if yellow > YELLOW_FROM and yellower > MOST_YELLOWER:
        return None
    is_known = likelier > LEAST_RATIO_STEP
    if fraction < LEAST_STEP_FRACTION or not (is_cooler or is_darker or is_known):
        return None
    lengths = np.linalg.norm(inwards.sides[:, 1] - inwards.sides[:, 0], axis=1)
    straight = min(1.0, float((inwards.support / np.maximum(lengths, 1.0)).min()))
    straight *= min(1.0, inwards.length_px / (1.2 * inwards.width_px))
    long = min(1.0, inwards.length_px / (0.25 * image.settings.working_px)) ** 0.5
    mean_cooler = max(0.5 * float(steps[0, 1] + steps[1, 1]), -MOST_WARMER)
    distinct = 0.4 + 2.0 * min(mean_cooler, 0.3) + 0.4 * max(darker, 0.0) + 0.1 * max(likelier, 0.0)
    return replace(inwards, evidence=float(fraction * straight * long * np.clip(distinct, 0.0, 1.0)))


def _from_border(bar: Bar, part: Image, image: WorkingImage) -> Bar | None:
    """The bar with its first end towards the border, None where its part does not go on to there."""
    longest_px = 5.0 * bar.width_px
    before = _way_out(bar.middles[0], -bar.axis, part, image, longest_px)
    behind = _way_out(bar.middles[1], bar.axis, part, image, longest_px)
    if before is None and behind is None:
        return None
    if behind is None or (before is not None and before <= behind):
        return bar
    return replace(bar, sides=np.ascontiguousarray(bar.sides[:, ::-1]))


def _way_out(start: Array, along: Array, part: Image, image: WorkingImage, longest_px: float) -> float | None:
    """How far it is from a point along a direction, each of shape (2,), to the picture's border inside of a part."""
    steps = np.arange(0.0, longest_px + 1.0)
    places = np.rint(start + steps[:, None] * along).astype(int)
    inside = _values(image.core, places) > 0
    if inside.all():
        return None
    length = int(np.argmin(inside))
    if length > 4 and np.mean(_values(part, places[:length]) > 0) < 0.8:
        return None
    return float(length)


def _steps(bar: Bar, side: int, image: WorkingImage, ratio: Floats | None) -> list[float] | None:
    """Along one side: the part with a step; how much cooler, darker, likelier, chromatic, yellower; how yellow."""
    inside = np.rint(bar.places(side, REACH_PX)).astype(int)
    outside = np.rint(bar.places(side, -REACH_PX)).astype(int)
    seen = (_values(image.core, inside) > 0) & (_values(image.core, outside) > 0)
    if np.count_nonzero(seen) < 6:
        return None
    own = _values(image.colours, inside[seen])
    step = _values(image.colours, outside[seen]) - own
    steps = np.linalg.norm(step / [COLOUR_STEP, COLOUR_STEP, BRIGHTNESS_STEP], axis=1) > 1.0
    likelier = 0.0
    if ratio is not None:
        rise = _values(ratio, inside[seen]) - _values(ratio, outside[seen])
        steps |= rise > LEAST_RATIO_STEP
        likelier = float(np.median(rise))
    cooler, darker, yellower = step[:, 0] + 0.5 * step[:, 1], step[:, 2], -step[:, 1]
    medians = [np.median(part) for part in (cooler, darker, np.hypot(*own[:, :2].T), yellower, own[:, 1])]
    return [float(value) for value in (np.mean(steps), *medians[:2], likelier, *medians[2:])]


def _values(field: NDArray[Value], places: NDArray[np.int_]) -> NDArray[Value]:
    """A field's values, shape (n, ...), at pixels (x, y), shape (n, 2); 0 outside of it."""
    height, width = field.shape[:2]
    x, y = places.T
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    values = field[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)].copy()
    values[~inside] = 0
    return np.asarray(values)


RATIO_SURE = 1.5  # A colour that speaks for an instrument by more belongs to the one that it touches
RATIO_DOUBT = 2.0  # A colour that speaks against an instrument by no more may be that of a wrist
FAR_D2 = 16.0  # squared deviation from the colours around, of three numbers, that one in a thousand exceeds
MOST_GOING_ON_PX = 3  # pixels of a part beside a bar that may touch what goes on beyond
MOST_CUT_FRACTION = 0.08
"""Of the border of where wrist and jaws can be: where more of it is likely on both sides, they end elsewhere."""
MOST_ELSEWHERE = 0.05
"""Of the instruments' pixels: with more that looks like them apart from them, likeness says little."""
LEAST_MISSED_PART = 0.2
"""Of an instrument's pixels: smaller parts beside it are shadows and reflections, which parts of a shaft are not."""


def belonging(zones: Zones, likely: Image, ratio: Floats, image: WorkingImage) -> NDArray[np.bool_]:
    """What of the likely pixels belongs to the instrument of these zones: what hangs together with its bar."""
    is_likely = (likely | _unlike_nearby(zones, ratio, image)) > 0
    distal = zones.distal & is_likely
    if _is_cut_off(distal, zones, is_likely):
        distal = zones.narrow & is_likely
    beside = zones.beside & (ratio > RATIO_SURE) & (image.core > 0) & ~zones.strip
    mine = distal | (zones.strip & is_likely) | _ending_there(beside, zones, is_likely) | zones.middle
    _, labels = cv2.connectedComponents(mine.astype(np.uint8))
    mask = np.isin(labels, np.unique(labels[zones.middle])) & (image.core > 0)
    mask = _without_holes(mask, 0.003 * image.area_px)
    # Where the optics fade, colours tell nothing; the instrument goes on to the border of the picture.
    outside = zones.strip & (image.picture > 0) & (image.core == 0)
    return np.asarray(mask | (outside & _grown(mask, SQUARE_5)))


def with_missed_parts(
    masks: Sequence[NDArray[np.bool_]], ratio: Floats, image: WorkingImage
) -> list[NDArray[np.bool_]]:
    """The instruments' masks with large parts that look like them and touch them: a shaft found by its narrow wrist."""
    mask = np.any(masks, axis=0) if masks else np.zeros(image.core.shape, bool)
    rest = np.asarray(((ratio > RATIO_SURE) & image.inner & ~mask).astype(np.uint8))
    rest = np.asarray(cv2.morphologyEx(rest, cv2.MORPH_OPEN, SQUARE_3), np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(rest)
    touching = [np.bincount(labels[_grown(one, SQUARE_5)], minlength=count) > 0 for one in masks]
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
    """What in the distal zone has not the colours around it, (h, w): wrists are reddish by tissue's reflection."""
    near = _grown(zones.distal, SQUARE_9)
    around = near & ~zones.distal & ~zones.strip & (image.core > 0) & (ratio < 0.0)
    inside = zones.distal & (image.core > 0) & (ratio > -RATIO_DOUBT)
    mask = np.zeros_like(image.core)
    if np.count_nonzero(around) < 50 or not inside.any():
        return mask
    sample = image.colours[around].astype(np.float64)
    centre = np.median(sample, axis=0)
    spread = np.cov(sample.T) + np.diag([0.03, 0.03, 0.1]) ** 2
    off = image.colours[inside] - centre
    mask[inside] = 255 * (np.einsum("ni,ij,nj->n", off, np.linalg.inv(spread), off) > FAR_D2)
    return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, SQUARE_3), np.uint8)


def _ending_there(beside: NDArray[np.bool_], zones: Zones, is_likely: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The parts beside a bar that end within what a shaft takes up; what goes on is a thing beside the shaft."""
    count, labels, _, _ = cv2.connectedComponentsWithStats(beside.astype(np.uint8))
    near = _grown(is_likely & ~zones.beside & ~zones.distal, SQUARE_3)
    goes_on = np.bincount(labels[near & beside], minlength=count) > MOST_GOING_ON_PX
    goes_on[0] = True
    return np.asarray(~goes_on[labels])


def _is_cut_off(distal: NDArray[np.bool_], zones: Zones, is_likely: NDArray[np.bool_]) -> bool:
    """Whether what looks like wrist and jaws goes on beyond what those can reach: then it is a thing behind them."""
    around = _grown(zones.distal, SQUARE_3) & ~zones.distal & ~zones.beside
    beyond = around & is_likely & _grown(distal, SQUARE_3)
    return int(np.count_nonzero(beyond)) > MOST_CUT_FRACTION * int(np.count_nonzero(around))


def _grown(mask: NDArray[np.bool_], kernel: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return np.asarray(cv2.dilate(mask.astype(np.uint8), kernel) > 0)


def _without_holes(mask: NDArray[np.bool_], most_px: float) -> NDArray[np.bool_]:
    """The mask with its small holes filled: glare and blood; through a large one tissue is seen."""
    solid = mask.astype(np.uint8)
    contours, _ = cv2.findContours(solid, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    whole = np.zeros_like(solid)
    cv2.drawContours(whole, contours, -1, 1, cv2.FILLED)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(cv2.subtract(whole, solid))
    small = [label for label in range(1, count) if stats[label, cv2.CC_STAT_AREA] < most_px]
    return np.asarray(mask | np.isin(labels, small))

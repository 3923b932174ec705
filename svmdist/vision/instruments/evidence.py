"""What speaks for a bar being an instrument: steps of colour along both sides, and a way to the picture's border."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.instruments.bars import Bar
from svmdist.vision.instruments.working import Floats, WorkingImage

Value = TypeVar("Value", bound=np.uint8 | np.float32)


@dataclass(frozen=True)
class JudgedBar:
    """A bar that runs from the picture's border inwards, and the evidence, from 0 to 1, that it is an instrument's."""

    bar: Bar
    evidence: float


def judged(bar: Bar, part: Image, image: WorkingImage, ratio: Floats | None = None) -> JudgedBar | None:
    """Judge a bar on the outline of a part, shape (h, w); None where it is no instrument's.

    `ratio`, shape (h, w), is how much each pixel's colour speaks for an instrument, where that is known.

    An instrument is straight over most of its length and comes in through the border. Across both of its sides colour
    or brightness changes at once, where a shadow's fade; and it is less red than what is on either side, or darker
    and no redder.
    """
    settings = image.settings
    if bar.length_px < max(settings.least_length_widths * bar.width_px, settings.least_length_px):
        return None
    inwards = _from_border(bar, part, image)
    if inwards is None:
        return None
    first, second = _steps(inwards, 0, image, ratio), _steps(inwards, 1, image, ratio)
    if first is None or second is None:
        return None
    fraction = min(first.fraction, second.fraction)
    cooler, darker = min(first.cooler, second.cooler), min(first.darker, second.darker)
    is_cooler = cooler > settings.least_cooler
    is_grey = max(first.chroma, second.chroma) < settings.grey_chroma
    is_darker = darker > settings.least_darker and (cooler > -settings.most_warmer or is_grey)
    is_yellow = max(first.yellow, second.yellow) > settings.yellow_from
    if is_yellow and max(first.yellower, second.yellower) > settings.most_yellower:
        return None
    is_known = min(first.likelier, second.likelier) > settings.least_ratio_step
    if fraction < settings.least_step_fraction or not (is_cooler or is_darker or is_known):
        return None
    lengths = np.linalg.norm(inwards.sides[:, 1] - inwards.sides[:, 0], axis=1)
    straight = min(1.0, float((np.array(inwards.support) / np.maximum(lengths, 1.0)).min()))
    straight *= min(1.0, inwards.length_px / (1.2 * inwards.width_px))
    long = min(1.0, inwards.length_px / (0.25 * settings.working_px)) ** 0.5
    mean_cooler = max(0.5 * (first.cooler + second.cooler), -settings.most_warmer)
    likelier = max(min(first.likelier, second.likelier), 0.0)
    distinct = min(1.0, 0.4 + 2.0 * min(mean_cooler, 0.3) + 0.4 * max(darker, 0.0) + 0.1 * likelier)
    return JudgedBar(inwards, float(fraction * straight * long * max(distinct, 0.0)))


def _from_border(bar: Bar, part: Image, image: WorkingImage) -> Bar | None:
    """The bar with its first end towards the border, None where its part does not go on to there."""
    longest_px = 5.0 * bar.width_px
    before = _way_out(bar.middles[0], -bar.axis, part, image, longest_px)
    behind = _way_out(bar.middles[1], bar.axis, part, image, longest_px)
    if before is None and behind is None:
        return None
    is_first = behind is None or (before is not None and before <= behind)
    return bar if is_first else bar.turned()


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


@dataclass(frozen=True)
class _Steps:
    """Along one side: the part of it with a step, and what the inside is.

    How much less red and how much darker than the outside, how coloured, how much likelier an instrument's, and how
    much more yellow; and how yellow it is itself.
    """

    fraction: float
    cooler: float
    darker: float
    chroma: float
    likelier: float
    yellower: float
    yellow: float


def _steps(bar: Bar, side: int, image: WorkingImage, ratio: Floats | None) -> _Steps | None:
    settings = image.settings
    inside = np.rint(bar.places(side, settings.reach_px)).astype(int)
    outside = np.rint(bar.places(side, -settings.reach_px)).astype(int)
    seen = (_values(image.core, inside) > 0) & (_values(image.core, outside) > 0)
    if np.count_nonzero(seen) < 6:
        return None
    own = _values(image.colours, inside[seen])
    step = _values(image.colours, outside[seen]) - own
    scaled = step / np.array([settings.colour_step, settings.colour_step, settings.brightness_step])
    steps = np.linalg.norm(scaled, axis=1) > 1.0
    likelier = 0.0
    if ratio is not None:
        rise = _values(ratio, inside[seen]) - _values(ratio, outside[seen])
        steps |= rise > settings.least_ratio_step
        likelier = float(np.median(rise))
    fraction = float(np.mean(steps))
    cooler = float(np.median(step[:, 0] + 0.5 * step[:, 1]))
    chroma = float(np.median(np.hypot(own[:, 0], own[:, 1])))
    return _Steps(
        fraction,
        cooler,
        float(np.median(step[:, 2])),
        chroma,
        likelier,
        yellower=-float(np.median(step[:, 1])),
        yellow=float(np.median(own[:, 1])),
    )


def _values(field: NDArray[Value], places: NDArray[np.int_]) -> NDArray[Value]:
    """A field's values, shape (n, ...), at pixels (x, y), shape (n, 2); 0 outside of it."""
    height, width = field.shape[:2]
    x, y = places.T
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    values = field[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)].copy()
    values[~inside] = 0
    return np.asarray(values)

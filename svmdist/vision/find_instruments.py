"""Segmentation without colours from the user: bars in what looks like instrument, and what belongs to each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.profile.segmentation import INSTRUMENTS, SHIPPED, OnnxSegmentation
from svmdist.profile.settings import AutoSettings
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.instrument_bars import Bar, Zones, bars_in, sharpened, unit
from svmdist.vision.instrument_evidence import belonging, judged, with_missed_parts
from svmdist.vision.network import OnnxSegmenter
from svmdist.vision.working_image import (
    SQUARE_3,
    SQUARE_5,
    SQUARE_9,
    Appearance,
    Example,
    Floats,
    WorkingImage,
    learnt_from,
    tissue_of,
)

LEAST_EVIDENCE = 0.2  # evidence, from 0 to 1, of two straight edges: what has less is tissue
TEACHING_EVIDENCE = 0.44  # of the surest bar of an image from which anything is to be learnt
SURE_EVIDENCE = 0.4  # evidence from which on a bar's colours are learnt
PERCENTILES = (4, 8, 13, 19, 26, 34)
"""Of each channel in the picture: thresholds under which instruments are sought. They cover 3 to 40 % of a picture."""
RATIO_LEVELS = (0.0, 1.0, 2.0)
"""Of the log ratio: at higher ones a shaft parts from a shadow beside it, at lower ones all of it is there."""
ROUND_7 = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))

Found = tuple[Bar, NDArray[np.bool_]]
"""An instrument in a working image: its bar from the border inwards, and its mask, shape (h, w)."""


def learnt_appearance(images: Sequence[WorkingImage]) -> Appearance | None:
    """What instruments look like in images of one log; None where none of them shows one for sure."""
    bars = [search_bars(image) for image in images]
    sure = [_of_bars(image, sought) for image, sought in zip(images, bars, strict=True) if sought]
    first = learnt_from([example for example in sure if example is not None])
    if first is None:
        return None
    examples = []
    for image, sought in zip(images, bars, strict=True):
        found = find_instruments(image, first, sought)
        if found:
            mask = np.asarray(np.any([mask for _, mask in found], axis=0), np.uint8)
            inside, near = cv2.erode(mask, SQUARE_3) > 0, cv2.dilate(mask, SQUARE_9) > 0
            examples.append((image.colours[inside], image.colours[(image.core > 0) & ~near]))
    return learnt_from(examples) or first


def search_bars(image: WorkingImage) -> list[Bar]:
    """Bars of an image of which nothing is known, the surest first: none overlaps a surer one by much."""
    sought: list[Bar] = []
    for channel in image.channels:
        values = channel[image.core > 0]
        for level in np.percentile(values, PERCENTILES) if len(values) else ():
            low = np.asarray(255 * ((channel < level) & (image.core > 0)), np.uint8)
            low = np.asarray(cv2.morphologyEx(low, cv2.MORPH_OPEN, SQUARE_3), np.uint8)
            sought += _judged_bars(low, image, 1)
    taken = np.zeros_like(image.core)
    kept: list[Bar] = []
    for bar in sorted(sought, key=lambda bar: -bar.evidence):
        strip = bar.filled(taken)
        if cv2.countNonZero(strip & taken) <= 0.3 * cv2.countNonZero(strip):
            taken |= strip
            kept.append(bar)
    return kept[: image.settings.most_instruments + 1]


def find_instruments(
    image: WorkingImage, appearance: Appearance | None, sought: Sequence[Bar] = ()
) -> list[Found]:
    """The instruments of an image, the surest first. `sought` are bars that are known without their colours."""
    ratio = image.hint if appearance is None else appearance.of(image) + image.hint
    levels = {level: _above(ratio, level, image) for level in RATIO_LEVELS}
    likely = levels[0.0]
    bars = [bar for mask in levels.values() for bar in _judged_bars(mask, image, 3, ratio)]
    bars += [bar for bar in sought if bar.evidence > SURE_EVIDENCE]
    taken = np.zeros(image.core.shape, bool)
    found: list[Found] = []
    for rough in sorted(bars, key=lambda bar: -bar.evidence):
        bar = sharpened(rough, image)
        zones = Zones.of(bar, image)
        size = max(int(np.count_nonzero(zones.middle)), 1)
        if np.count_nonzero(zones.middle & taken) > 0.3 * size:
            continue
        if np.count_nonzero(zones.middle & (likely > 0)) < 0.6 * size:
            continue
        mask = belonging(zones, likely, ratio, image)
        if np.count_nonzero(mask & ~taken) < image.settings.least_area * image.area_px:
            continue
        taken |= mask
        found.append((bar, mask))
        if len(found) >= image.settings.most_instruments:
            break
    masks = with_missed_parts([mask for _, mask in found], ratio, image)
    return [(bar, mask) for (bar, _), mask in zip(found, masks, strict=True)]


def _above(ratio: Floats, level: float, image: WorkingImage) -> Image:
    """What speaks for an instrument by more than a level, without specks and gaps, shape (h, w)."""
    mask = np.asarray(255 * ((ratio > level) & (image.core > 0)), np.uint8)
    mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, SQUARE_3), np.uint8)
    return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, ROUND_7), np.uint8) & image.core


def _judged_bars(mask: Image, image: WorkingImage, most_bars: int, ratio: Floats | None = None) -> list[Bar]:
    every = (judged(bar, part, image, ratio) for bar, part in bars_in(mask, image, most_bars))
    return [bar for bar in every if bar is not None and bar.evidence > LEAST_EVIDENCE]


def _of_bars(image: WorkingImage, sought: Sequence[Bar]) -> Example | None:
    """What the sure bars of an image teach; what is near to any bar may be either, and teaches nothing."""
    if sought[0].evidence < TEACHING_EVIDENCE:
        return None
    least = min(0.6 * sought[0].evidence, SURE_EVIDENCE)
    inside, near = np.zeros_like(image.core), np.zeros_like(image.core)
    for bar in sought:
        strip, reach = bar.filled(near), SQUARE_5
        if bar.evidence >= least:
            inside |= np.asarray(cv2.erode(strip, SQUARE_3), np.uint8)
            size = int(2.0 * bar.width_px) | 1
            reach = np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), np.uint8)
        near |= np.asarray(cv2.dilate(strip, reach), np.uint8)
    return image.colours[inside > 0], image.colours[(image.core > 0) & (near == 0)]


OFF_SIDE = 0.1
"""How far, over the shaft's width, an outline may be off the sides of a cylinder, beside a pixel and a half."""
LONGEST_GAP = 0.5
"""Of an outline off its sides, over the width: glare and blood at an edge are shorter, wrists are longer."""


@dataclass(frozen=True)
class SeenInstrument:
    """An instrument that comes in from the picture's border, in pixels of the image it was found in.

    `mask` (h, w) is all of it; `shaft` (h, w) its part between two straight sides, `distal` (h, w) wrist and jaws.
    `sides`, shape (2, 2, 2), holds the ends of both sides as (x, y), at the border first. `end_px` (2,) is the middle
    of the shaft's end, where the outline stops being that of a cylinder, and `tip_px` (2,) what of the instrument is
    farthest along the axis from there. `evidence`, from 0 to 1, says how sure it is that this is an instrument.
    """

    mask: Image
    shaft: Image
    distal: Image
    sides: Array
    end_px: Array
    tip_px: Array
    evidence: float

    @property
    def entry_px(self) -> Array:
        """The middle between both sides at the border, shape (2,)."""
        return np.asarray(self.sides[:, 0].mean(axis=0))

    @property
    def axis(self) -> Array:
        """Unit vector from the border inwards, shape (2,)."""
        return unit(self.end_px - self.entry_px)

    @property
    def width_px(self) -> float:
        """Distance of both sides at the shaft's end."""
        return float(np.linalg.norm(self.sides[0, 1] - self.sides[1, 1]))


def seen_instrument(found: Found, scale: float, size: tuple[int, int]) -> SeenInstrument:
    """An instrument of a working image of a scale in the pixels of the image of `size` = (h, w) that it was made of."""
    bar, rough_mask = found
    mask = _enlarged(rough_mask.astype(np.uint8) * 255, size)
    # The middle of a pixel is a whole number, in either image.
    rough = _outline_geometry(rough_mask, bar.sides)
    sides, end_px, tip_px = (np.asarray((points + 0.5) / scale - 0.5) for points in rough)
    x, y = np.arange(size[1], dtype=np.float32)[None, :], np.arange(size[0], dtype=np.float32)[:, None]
    end, along = end_px.astype(np.float32), unit(end_px - sides[:, 0].mean(axis=0)).astype(np.float32)
    shaft = np.where((x - end[0]) * along[0] + (y - end[1]) * along[1] < 0, mask, 0).astype(np.uint8)
    distal = np.asarray(cv2.subtract(mask, shaft), np.uint8)
    return SeenInstrument(mask, shaft, distal, sides, end_px, tip_px, bar.evidence)


def _outline_geometry(mask: NDArray[np.bool_], sides: Array) -> tuple[Array, Array, Array]:
    """Both sides from where they begin to where the outline leaves them, shape (2, 2, 2), the end and the tip, (2,)."""
    start = sides[:, 0].mean(axis=0)
    axis = unit(sides[:, 1].mean(axis=0) - start)
    normal = np.array([-axis[1], axis[0]])
    y, x = np.nonzero(mask)
    points = np.stack([x, y], axis=1) - start
    along, across = points @ axis, points @ normal
    tip = start + axis * along.max() + normal * float(np.median(across[along > along.max() - 2.0]))
    first, last = int(np.floor(along.min(initial=0.0))), int(np.ceil(along.max(initial=0.0)))
    steps = np.arange(first, last + 1)
    low, high = np.full(len(steps), np.inf), np.full(len(steps), -np.inf)
    at = np.rint(along).astype(int) - first
    np.minimum.at(low, at, across - 0.5)
    np.maximum.at(high, at, across + 0.5)
    lines = np.stack([_offsets(side, start, axis, normal, steps) for side in sides])
    lower, upper = np.minimum(lines[0], lines[1]), np.maximum(lines[0], lines[1])
    width = np.maximum(upper - lower, 1.0)
    within = OFF_SIDE * width + 1.5
    is_cylinder = (np.abs(low - lower) < within) & (np.abs(high - upper) < within)
    end = _last_of_run(steps, is_cylinder, LONGEST_GAP * float(np.median(width)))
    cut = [_at(side, start, axis, end) for side in sides]
    cut_sides = np.stack([np.stack([side[0], inner]) for side, inner in zip(sides, cut, strict=True)])
    return cut_sides, np.mean(cut, axis=0), tip


def _offsets(side: Array, start: Array, axis: Array, normal: Array, steps: NDArray[np.int_]) -> Array:
    along = side[1] - side[0]
    slope = float(along @ normal) / max(abs(float(along @ axis)), 1e-9)
    return np.asarray(float((side[0] - start) @ normal) + slope * (steps - float((side[0] - start) @ axis)))


def _at(side: Array, start: Array, axis: Array, end: float) -> Array:
    along = side[1] - side[0]
    share = (end - float((side[0] - start) @ axis)) / max(float(along @ axis), 1e-9)
    return np.asarray(side[0] + along * share)


def _last_of_run(steps: NDArray[np.int_], good: NDArray[np.bool_], longest_gap: float) -> float:
    """The last good step before a gap that is longer than allowed; the gaps before the first good one do not count."""
    places = steps[good]
    if not len(places):
        return float(steps[-1])
    gaps = np.flatnonzero(np.diff(places) > longest_gap)
    # A gap near the border is where the outline joins what else is dark there.
    gaps = gaps[places[gaps] > 0]
    return float(places[gaps[0]] if len(gaps) else places[-1])


def _enlarged(mask: Image, size: tuple[int, int]) -> Image:
    large = cv2.resize(mask, size[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.threshold(large, 127, 255, cv2.THRESH_BINARY)[1], np.uint8)


DEFAULT = AutoSettings()
MOST_RATIO = 4.0  # one pixel's texture says no more than its colour may, as a logarithm of odds


def network_hint(bgr: Image) -> Floats:
    """Log odds of instrument against all else, shape (h, w), of an image, shape (h, w, 3)."""
    scores = _network().scores(bgr)
    instrument = np.zeros(len(scores), np.bool_)
    for part in ("instrument", "shaft"):
        instrument[list(INSTRUMENTS[part]["class_ids"])] = True
    odds = np.logaddexp.reduce(scores[instrument]) - np.logaddexp.reduce(scores[~instrument])
    odds = np.clip(odds, -MOST_RATIO, MOST_RATIO).astype(np.float32)
    return np.asarray(cv2.resize(odds, bgr.shape[1::-1], interpolation=cv2.INTER_LINEAR), np.float32)


@lru_cache(maxsize=1)
def _network() -> OnnxSegmenter:
    return OnnxSegmenter(OnnxSegmentation.model_validate({"method": "onnx", "model": SHIPPED}))


class AutoMasks:
    """The masks of one image, shape (h, w) with 0 or 255, made when they are first asked for."""

    def __init__(self, bgr: Image, appearance: Appearance | None, settings: AutoSettings) -> None:
        self._size = bgr.shape[0], bgr.shape[1]
        self._image = WorkingImage.of(bgr, settings, network_hint)
        self._appearance = appearance

    @cached_property
    def seen(self) -> tuple[SeenInstrument, ...]:
        """The instruments, the surest first."""
        if self._appearance is None:  # no image that was learnt from shows one: this may
            appearance, sought = learnt_appearance([self._image]), search_bars(self._image)
        else:
            appearance, sought = self._appearance, []
        found = find_instruments(self._image, appearance, sought)
        return tuple(seen_instrument(one, self._image.scale, self._size) for one in found)

    @cached_property
    def picture(self) -> Image:
        """What of the image is picture: not the black border around it."""
        return _enlarged(self._image.picture, self._size)

    @cached_property
    def tissue(self) -> Image:
        """What of the picture is no instrument, or the red part of that where it is distinct."""
        tissue = _enlarged(tissue_of(self._image), self._size)
        return tissue & ~self._union([one.mask for one in self.seen])

    @cached_property
    def instrument(self) -> Image:
        """Wrists and jaws of all instruments: what is beyond the end of each shaft."""
        return self._union([one.distal for one in self.seen])

    @cached_property
    def shaft(self) -> Image | None:
        """The shafts of all instruments, of any brightness."""
        return self._union([one.shaft for one in self.seen])

    @cached_property
    def black(self) -> Image | None:
        """What is not picture."""
        return np.asarray(cv2.bitwise_not(self.picture), np.uint8)

    def _union(self, masks: Sequence[Image]) -> Image:
        return np.asarray(np.bitwise_or.reduce([np.zeros(self._size, np.uint8), *masks]))


class AutoSegmenter:
    """Finds instruments by straight edges, tells them from tissue by learnt colours and the network that ships."""

    uses_colours = False

    def __init__(self, settings: AutoSettings = DEFAULT, appearance: Appearance | None = None) -> None:
        self._settings = settings
        self._appearance = appearance

    @property
    def adapting_frames(self) -> int:
        """How many moments of a log it wants to learn from."""
        return self._settings.adapting_frames

    def adapted_to(self, images: Sequence[Image]) -> AutoSegmenter:
        """One that knows what instruments look like in these images, shape (h, w, 3) in BGR each."""
        working = [WorkingImage.of(image, self._settings, network_hint) for image in images]
        return AutoSegmenter(self._settings, learnt_appearance(working))

    def masks(self, bgr: Image, /) -> AutoMasks:
        """The masks of an image, shape (h, w, 3) in BGR as recorded."""
        return AutoMasks(bgr, self._appearance, self._settings)

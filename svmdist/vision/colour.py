"""Colours of an image: HSV masks (paper, sec. III.A), what the endoscope shows, exposure, and distinct marks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from svmdist.profile.segmentation import ColourRegion, HsvSegmentation
from svmdist.profile.settings import ExposureSettings
from svmdist.samples import Image

if TYPE_CHECKING:
    from svmdist.vision.instruments.find_instruments import SeenInstrument

SAMPLING_PX = 4  # levels are counted on every n-th row and column, enough for a percentile
BORDER_FRACTION = 0.2  # of the bright level; what is darker may be the endoscope's black border
BLACK_PERCENTILE = 0.5  # the darkest things in view. A shaft's short segment is half a percent of the view
MIDDLE_PERCENTILE = 50.0  # the middle of the scene, by which automatic exposure goes
DISTINCT_FRACTION = 0.7  # of the median; with a brighter darkest part nothing dark is in view
NOISY_GAIN = 1.5  # dim light comes with shot noise: from this gain on, neighbouring pixels are averaged
NOISE_SIGMA_PX = 1.0  # width of that average


@dataclass(frozen=True, slots=True)
class Masks:
    """What is what in one image: masks of shape (h, w), uint8, 0 or 255; they may be combined by `&`.

    `instrument` is its distal part, about the tool's origin; `shaft` is None where the profile knows none. `black` may
    be border around the endoscope's view, None where the shaft's mask holds it already; `picture` is surely not border,
    None if unknown. `seen` are whole instruments, the surest first, None where they are not separated.
    """

    tissue: Image
    instrument: Image
    shaft: Image | None
    black: Image | None = None
    picture: Image | None = None
    seen: tuple[SeenInstrument, ...] | None = None

    def without(self, others: Image) -> Masks:
        """The masks for one of several instruments: without the pixels of the others, shape (h, w).

        What may be border has the other shafts in it: they cut the view no less than its own.
        """
        count, shaft, black, seen, rest = cv2.countNonZero, self.shaft, self.black, self.seen, ~others
        if seen is not None:
            seen = tuple(one for one in seen if 2 * count(one.mask & rest) > count(one.mask))
        own_shaft = None if shaft is None else shaft & rest
        black = shaft if shaft is None or black is None else shaft | black
        return Masks(self.tissue, self.instrument & rest, own_shaft, black, self.picture, seen)


def masks_by_colours(rules: HsvSegmentation, image_hsv: Image) -> Masks:
    """`method = "hsv"`: the masks of an image as HSV, shape (h, w, 3), by a box of colours for each part."""
    channels = cv2.split(image_hsv)
    shaft = None if rules.shaft is None else _mask(channels, rules.shaft)
    return Masks(_mask(channels, rules.tissue), _mask(channels, rules.instrument), shaft)


def to_hsv(bgr: Image) -> Image:
    """Convert BGR, shape (h, w, 3), to OpenCV's 8-bit HSV: H in 0–179 (half degrees), S and V in 0–255."""
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV), np.uint8)


def to_grey(bgr: Image) -> Image:
    """Convert BGR, shape (h, w, 3), to grey, shape (h, w)."""
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), np.uint8)


def colour_mask(image_hsv: Image, region: ColourRegion) -> Image:
    """Mask, shape (h, w) with 0 or 255, of the pixels inside an HSV box whose hue may wrap around 0."""
    return _mask(cv2.split(image_hsv), region)


def _mask(channels: Sequence[cv2.typing.MatLike], region: ColourRegion) -> Image:
    """Channel by channel: a test of one channel takes an eighth of what one of three channels at once takes."""

    def inside(number: int, first: int, last: int) -> Image:
        return np.asarray(cv2.inRange(channels[number], first, last), np.uint8)

    first, last = region.hue
    mask = inside(2, *region.value)
    if tuple(region.saturation) != (0, 255):
        mask &= inside(1, *region.saturation)
    if first <= last and (first, last) != (0, 179):
        mask &= inside(0, first, last)
    elif last + 1 < first:  # else the two ends meet, and every hue is inside
        mask &= ~inside(0, last + 1, first - 1)
    return mask


BRIGHT_PART_FRACTION = 0.005  # bright parts below this fraction of the image are letters on a black border, not scene


def field_of_view(dark: Image) -> Image:
    """Mask, shape (h, w), of what the endoscope shows: the convex hull of the larger parts that are not dark."""
    height, width = dark.shape
    bright = cv2.erode(cv2.bitwise_not(dark), np.ones((3, 3), np.uint8), borderValue=255)
    contours, _ = cv2.findContours(bright, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    large = [part for part in contours if cv2.contourArea(part) > BRIGHT_PART_FRACTION * height * width]
    view = np.zeros_like(dark)
    if large:
        cv2.fillConvexPoly(view, cv2.convexHull(np.concatenate(large)), 255)
    return view


def normalised(bgr: Image, settings: ExposureSettings) -> Image:
    """The image at normalised exposure, shape (h, w, 3); the same array where it is well exposed already."""
    # NumPy's maximum along the short axis takes twenty times as long.
    blue, green, red = cv2.split(np.ascontiguousarray(bgr[::SAMPLING_PX, ::SAMPLING_PX]))
    value = np.asarray(cv2.max(cv2.max(blue, green), red), np.uint8)
    bright = np.percentile(value, 90.0)
    view = field_of_view(np.asarray(255 * (value <= BORDER_FRACTION * bright), np.uint8))
    if not view.any():
        return bgr
    black, middle = np.percentile(value[view > 0], (BLACK_PERCENTILE, MIDDLE_PERCENTILE)).tolist()
    veil = max(0.0, black - settings.dark_level) if black < DISTINCT_FRACTION * middle else 0.0
    gain = max(1.0, settings.fair_level / max(middle - veil, 1.0))
    if veil == 0.0 and gain == 1.0:
        return bgr
    if gain > NOISY_GAIN:
        bgr = np.asarray(cv2.GaussianBlur(bgr, (0, 0), NOISE_SIGMA_PX), np.uint8)
    levels = gain * (np.arange(256) - veil)
    return np.asarray(cv2.LUT(bgr, np.clip(np.rint(levels), 0, 255).astype(np.uint8)), np.uint8)


HALF_WIDTH = 10  # A mark's hue varies by this much with light and shade
MIN_SATURATION, MIN_VALUE = 100, 60
SMALLEST, LARGEST = 1e-4, 1e-2  # share of the image that a joint's ring or cap covers: no speck, no tissue
MIN_SHARE = 0.8  # how much of a hue's pixels must belong to the marks: else something else has the hue
MIN_FRAMES = 0.8
MIN_MOTION = 0.01  # what instruments carry moves, over the image's width


@dataclass(frozen=True, slots=True)
class DistinctColour:
    """A box in OpenCV's HSV, bounds included (a hue whose first is above its last wraps), and a mark's area in px."""

    hue: tuple[int, int]
    saturation: tuple[int, int]
    value: tuple[int, int]
    area_px: float


def find_distinct_colour(images: Sequence[Image], mark_count: int = 1) -> DistinctColour | None:
    """The colour of the largest distinct marks of `mark_count` instruments in a log's BGR images; None without."""
    if len(images) < 3:
        return None
    hsv = [to_hsv(image) for image in images]
    found = [marks for hue in range(0, 180, 10) if (marks := _marks(hsv, hue, mark_count)) is not None]
    return max(found, key=lambda marks: marks.area_px, default=None)


def _marks(images: Sequence[Image], hue: int, mark_count: int) -> DistinctColour | None:
    areas, places, pixels = [], [], []
    for hsv in images:
        off = np.abs((hsv[..., 0].astype(np.int16) - hue + 90) % 180 - 90)
        mask = (off <= HALF_WIDTH) & (hsv[..., 1] >= MIN_SATURATION) & (hsv[..., 2] >= MIN_VALUE)
        _, labels, statistics, centres = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
        order = 1 + np.argsort(statistics[1:, cv2.CC_STAT_AREA])[::-1][:mark_count]
        if len(order) < mark_count:
            continue
        sizes = statistics[order, cv2.CC_STAT_AREA]
        fits = SMALLEST * mask.size <= sizes.min() and sizes.max() <= LARGEST * mask.size
        if fits and sizes.sum() >= MIN_SHARE * mask.sum():
            areas.append(float(sizes.mean()))
            places.append(centres[order][np.argsort(centres[order, 0])].ravel())
            pixels.append(hsv[np.isin(labels, order)])
    if len(areas) < MIN_FRAMES * len(images):
        return None
    motion_px = float(np.linalg.norm(np.std(places, axis=0))) / np.sqrt(mark_count)
    if motion_px < MIN_MOTION * images[0].shape[1]:
        return None
    hues, *others = np.concatenate(pixels).astype(np.float64).T
    low, high = np.percentile((hues - hue + 90.0) % 180.0, [2, 98]) - 90.0 + hue
    saturation, value = ((max(0, round(float(np.percentile(one, 2)) - 20)), 255) for one in others)
    return DistinctColour((round(low - 3) % 180, round(high + 3) % 180), saturation, value, float(np.median(areas)))

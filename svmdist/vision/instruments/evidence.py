"""Evidence: each pixel's log-odds of being instrument, by the network that ships."""

from __future__ import annotations

from functools import cached_property, lru_cache, reduce

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.profile.segmentation import INSTRUMENTS, SHIPPED, OnnxSegmentation
from svmdist.profile.settings import AutoSettings
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.colour import field_of_view
from svmdist.vision.network import OnnxSegmenter

BORDER_LEVELS = 6.0  # a black border differs from the darkest thing in the image by no more: noise and compression
LIT_LEVELS = 14.0  # the same of what light reaches: in the dark before a border a shaft is as dark as all else
BORDER_FLOOR_LEVEL = 10.0  # what is darker than this is border, whatever the darkest thing is
BORDER_SHARE = 0.005  # of all pixels, that are no brighter than the darkest things
BORDER_FRACTION = 0.4  # of the picture's median; a border is darker, though haze may lift it
LEVEL_OFFSET = 8.0  # added to levels before their logarithm is taken: noise of one or two must not be a colour
MOST_ODDS = 4.0  # of one pixel, as a logarithm: neither its texture nor its colour is ever surer
MOST_AGAINST = 2.0  # of the network's odds: it misses dark instruments more often than it invents one
RIM_PX = 3  # width of the rim
CORRELATION_PX = 3.5  # the network's pixel is 2 of the working image or more: neighbours within err alike
DISTINCT_SHARE = 0.7  # of redness' variance, between the redder part and the rest: less is one kind of tissue
DISTINCT_REDNESS = 0.4  # by how much, as a logarithm, the one is redder: organ on a drape, not fat beside muscle

DISTAL, SHAFT = (INSTRUMENTS[part]["class_ids"][0] for part in ("instrument", "shaft"))
Floats = NDArray[np.float32]
SQUARE_3 = np.ones((3, 3), np.uint8)
SQUARE_5 = np.ones((5, 5), np.uint8)


class Evidence:
    """Log-odds of instrument against all else in a working image, made of an image of any size, (h, w, 3) in BGR.

    What is `hidden`, shape (h, w), is taken for nothing: neither its colours nor its borders count. The middle of a
    pixel is a whole number in either image: q = scale (p + 0.5) - 0.5.
    """

    def __init__(self, bgr: Image, settings: AutoSettings, hidden: Image | None = None) -> None:
        self.settings, self._image = settings, bgr
        self.size = height, width = bgr.shape[:2]
        self.scale = settings.working_px / max(width, height)
        size = (max(1, round(self.scale * width)), max(1, round(self.scale * height)))
        how = cv2.INTER_AREA if self.scale < 1.0 else cv2.INTER_LINEAR
        self.bgr = np.asarray(cv2.resize(bgr, size, interpolation=how), np.uint8)
        self.bgr_float: Floats = self.bgr.astype(np.float32)
        self.picture = picture_of(self.bgr)
        self.hidden = np.zeros_like(self.picture)
        if hidden is not None:
            self.hidden[cv2.resize(hidden, size, interpolation=cv2.INTER_AREA) > 0] = 255

    @cached_property
    def core(self) -> Image:
        """What light reaches of the picture, without its outermost 2 px, where the optics fade."""
        lit = picture_of(self.bgr, LIT_LEVELS) & self.picture
        return np.asarray(cv2.erode(lit, SQUARE_5, borderValue=0), np.uint8)

    def seen_at(self, places: Array) -> NDArray[np.bool_]:
        """Whether light reaches places (x, y), shape (..., 2), of the picture."""
        return sampled(self.core, places, nearest=True) > 0

    @cached_property
    def scores(self) -> Floats:
        """The network's log-odds of instrument, and of shaft against distal part, shape (2, h, w)."""
        x, y, width, height = cv2.boundingRect(self.picture)
        left, top, right, bottom = (round(at / self.scale) for at in (x, y, x + width, y + height))
        scores = _network().scores(np.ascontiguousarray(self._image[top:bottom, left:right]))
        likely = np.exp(np.maximum(scores - scores.max(0), -50.0))
        odds = np.log(likely[[DISTAL, SHAFT]].sum(0) / np.delete(likely, (DISTAL, SHAFT), 0).sum(0))
        both = np.stack([odds, scores[SHAFT] - scores[DISTAL]], -1)
        both = np.clip(both, -MOST_AGAINST, MOST_ODDS).astype(np.float32)
        padded = np.zeros((*self.picture.shape, 2), np.float32)
        padded[y : y + height, x : x + width] = cv2.resize(both, (width, height))
        return np.ascontiguousarray(np.moveaxis(padded, 2, 0))

    @cached_property
    def colours(self) -> Floats:
        """log(R/G), log(G/B) and the mean of all three logarithms, shape (h, w, 3): light scales only the last."""
        table = np.log(np.arange(256, dtype=np.float32) + np.float32(LEVEL_OFFSET))
        levels = cv2.LUT(cv2.GaussianBlur(self.bgr, (0, 0), 0.8), table)
        blue, green, red = (np.asarray(level, np.float32) for level in cv2.split(levels))
        return np.asarray(cv2.merge([red - green, green - blue, (red + green + blue) / 3.0]), np.float32)

    @cached_property
    def odds(self) -> Floats:
        """Log-odds of instrument, shape (h, w); lowest where no light reaches, 0 where it is hidden."""
        odds = np.where(self.core > 0, self.scores[0], -MOST_ODDS).astype(np.float32)
        odds[self.hidden > 0] = 0.0
        return odds

    @cached_property
    def rim(self) -> Image:
        """The outermost pixels of what light reaches, shape (h, w), where instruments come in."""
        inner = cv2.erode(self.core, SQUARE_3, iterations=RIM_PX, borderValue=0)
        return np.asarray(cv2.subtract(self.core, inner), np.uint8)

    @cached_property
    def parts(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Labels, shape (h, w), of connected regions that are likely instrument, 0 for the rest, and their areas."""
        likely = np.asarray(((self.odds > 0.0) | (self.hidden > 0)) & (self.core > 0), np.uint8)
        likely = np.asarray(cv2.morphologyEx(likely, cv2.MORPH_OPEN, SQUARE_3), np.uint8)
        _, labels, statistics, _ = cv2.connectedComponentsWithStats(likely)
        return np.asarray(labels, np.int32), np.asarray(statistics[:, cv2.CC_STAT_AREA], np.int32)


def sampled(field: Image | Floats, places: Array, nearest: bool = False) -> NDArray[np.float32]:
    """A field's values at places (x, y), shape (..., 2), linearly; 0 outside of it."""
    flat = np.ascontiguousarray(places.reshape(-1, places.shape[-2], 2), np.float32)
    how = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
    values = cv2.remap(field, flat, None, how, borderMode=cv2.BORDER_CONSTANT, borderValue=0)  # type: ignore[call-overload]
    return np.asarray(values.reshape(*places.shape[:-1], *field.shape[2:]), np.float32)


def strongest(change: Floats) -> Floats:
    """The largest of three channels, shape (..., 3): NumPy's own maximum along a short axis takes ten times longer."""
    return reduce(np.maximum, np.moveaxis(change, -1, 0))


@lru_cache(maxsize=1)
def _network() -> OnnxSegmenter:
    return OnnxSegmenter(OnnxSegmentation.model_validate({"method": "onnx", "model": SHIPPED}))


def picture_of(bgr: Image, border_levels: float = BORDER_LEVELS) -> Image:
    """Mask, shape (h, w), of the picture inside its border, whatever its shape; all of an image without a border."""
    blue, green, red = cv2.split(bgr)  # NumPy's maximum along the short axis takes twenty times as long
    value = np.asarray(cv2.max(cv2.max(blue, green), red), np.uint8)
    counts = np.cumsum(np.bincount(value.ravel(), minlength=256))
    floor = int(np.searchsorted(counts, BORDER_SHARE * counts[-1]))
    level = min(max(floor + border_levels, BORDER_FLOOR_LEVEL), 255.0)
    dark = counts[int(level)]
    median = int(np.searchsorted(counts, 0.5 * (dark + counts[-1])))
    if dark < counts[-1] and floor <= BORDER_FRACTION * median:
        view = field_of_view(np.asarray(255 * (value <= level), np.uint8))
        if view.any():
            return view
    return np.full(bgr.shape[:2], 255, np.uint8)


def tissue_of(image: Evidence) -> Image:
    """Mask, shape (h, w), of what may be tissue; instruments are not yet taken out of it."""
    redness = image.colours[..., 0] + 0.5 * image.colours[..., 1]  # log(R/√(GB)): high in tissue, low in steel
    values = redness[image.core > 0]
    if not len(values):
        return image.picture
    low, high = np.percentile(values, (1, 99))
    if high - low < DISTINCT_REDNESS:
        return image.picture
    levels = np.clip((redness - low) * (255.0 / (high - low)), 0, 255).astype(np.uint8)
    inside = levels[image.core > 0]
    threshold, _ = cv2.threshold(inside, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    red, rest = inside[inside > threshold], inside[inside <= threshold]
    share, apart = len(red) / len(inside), float(red.mean() - rest.mean())
    between = share * (1.0 - share) * apart**2 / float(inside.var())
    if between < DISTINCT_SHARE or apart * (high - low) / 255.0 < DISTINCT_REDNESS:
        return image.picture
    return np.asarray(np.where(levels > threshold, image.picture, 0), np.uint8)

"""Segmentation without colours from the user: shafts whose outlines the evidence supports, and their instance masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.least_squares import median
from svmdist.profile.settings import AutoSettings
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.colour import Masks
from svmdist.vision.instruments.evidence import SQUARE_3, Evidence, sampled, tissue_of
from svmdist.vision.instruments.outline import LEAST_RIM_PX, STATIONS, Outline
from svmdist.vision.instruments.outline_search import LONGEST_WRIST, MIDDLE, outline_score, rough_outlines, sharpened

MOST_OVERLAP = 0.3  # of the smaller of two strips: those of more are one instrument
DISTAL_WIDTHS = 4.5  # how far wrist and jaws reach beyond the end of the shaft, over its width there
DISTAL_HALF_WIDTHS = 1.3  # how far they reach to either side of its axis, over its width
BESIDE_WIDTHS = 0.08  # how far evidence beside a side is still that of the shaft, over its width
ENTERING = np.linspace(0.05, 0.5, STATIONS // 2)  # along a shaft: what comes in, before anything else begins
LEAST_ENTERING, SURE_ENTERING = 0.0, 1.5  # log-odds of a shaft against wrist and jaws, of what comes in
WRIST_NARROWER = 0.3  # by how much of the width a wrist is narrower, which may come in instead
LIKELY = 0.7  # mean odds of what shows no straight shaft
ENTRY_WIDTHS = 2.0  # about its axis, over its width, where an instrument itself comes in
DEFAULT = AutoSettings()

Mask = NDArray[np.bool_]


def find_instruments(evidence: Evidence) -> list[SeenInstrument]:
    """The instruments of an image, the surest first."""
    shafts, strips = list[tuple[Outline, float]](), list[Image]()
    for rough in rough_outlines(evidence):
        outline = None if _is_taken(rough, strips) else sharpened(rough, evidence)
        if outline is None or _is_taken(outline, strips):
            continue
        if score := outline_score(outline, evidence):
            shafts.append((outline, score))
            strips.append(_filled(outline, evidence.core))
        if len(shafts) == evidence.settings.most_instruments:
            break
    found, taken = list[SeenInstrument](), np.zeros(evidence.core.shape, np.bool_)
    least_px = evidence.settings.least_area * max(cv2.countNonZero(evidence.core), 1)
    away = [cv2.distanceTransform(cv2.bitwise_not(strip), cv2.DIST_L2, 3) for strip in strips]
    for (outline, score), own in zip(shafts, away, strict=True):
        # Where instruments touch, what belongs to one reaches into the other's: each has what its strip is nearest to.
        nearest = np.all([own <= other for other in away], axis=0)
        mask = _instance_mask(outline, evidence, nearest & ~taken)
        if np.count_nonzero(mask) >= least_px:
            taken |= mask
            found.append(_seen_instrument(outline, mask, score, evidence))
    return sorted(found, key=lambda one: -one.evidence)


def _filled(outline: Outline, like: Image) -> Image:
    strip, (first, second) = np.zeros_like(like), outline.sides
    corners = np.rint([first[0], first[1], second[1], second[0]]).astype(np.int32)
    cv2.fillConvexPoly(strip, corners, 255)
    return strip


def _is_taken(outline: Outline, strips: Sequence[Image]) -> bool:
    if not strips:
        return False
    own, count = _filled(outline, strips[0]), cv2.countNonZero
    return any(count(own & strip) > MOST_OVERLAP * min(count(own), count(strip)) for strip in strips)


def _instance_mask(outline: Outline, evidence: Evidence, free: Mask) -> Mask:
    """What is `free`, (h, w), of all between a shaft's sides, and of evidence that is connected with it."""
    outline = outline.whole
    height, width = evidence.core.shape
    x, y = np.arange(width, dtype=np.float32)[None, :], np.arange(height, dtype=np.float32)[:, None]
    depth = np.full((height, width), np.inf, np.float32)
    for side, inward in zip(outline.sides, (1.0, -1.0), strict=True):
        u = side[1] - side[0]
        normal = inward * np.array([-u[1], u[0]]) / max(float(np.linalg.norm(u)), 1e-9)
        off_x, off_y = x - float(side[0, 0]), y - float(side[0, 1])
        depth = np.minimum(depth, off_x * float(normal[0]) + off_y * float(normal[1]))
    end, (ux, uy), width_px = outline.sides[:, 1].mean(0), outline.axis.tolist(), outline.end_width_px
    off_x, off_y = x - float(end[0]), y - float(end[1])
    along, across = off_x * ux + off_y * uy, np.abs(off_y * ux - off_x * uy)
    likely = ((evidence.odds > 0.0) | (evidence.hidden > 0)) & (evidence.core > 0)
    strip = (along < 0.0) & (depth > 0.0)
    beside = (along < 0.0) & (depth > -BESIDE_WIDTHS * outline.width_px - 1.0) & likely
    distal = (along >= -0.3 * width_px) & (along < DISTAL_WIDTHS * width_px) & likely
    distal &= across < DISTAL_HALF_WIDTHS * width_px + 0.1 * np.maximum(along, 0.0)
    mine = (strip | beside | distal) & (evidence.picture > 0) & free
    opened = cv2.morphologyEx(mine.astype(np.uint8), cv2.MORPH_OPEN, SQUARE_3)
    _, labels = cv2.connectedComponents(opened)
    own = np.bincount(labels[strip & (opened > 0)], minlength=1)
    return np.asarray(labels == int(own.argmax()) if own.any() else strip & free)


@dataclass(frozen=True)
class SeenInstrument:
    """An instrument that comes in from the picture's border, in pixels of the image it was found in."""

    small_mask: Mask  # in the working image
    size: tuple[int, int]  # (h, w) of the image
    sides: Array  # the ends of both sides as (x, y), at the border first, shape (2, 2, 2)
    end_px: Array  # the middle of the shaft's end, shape (2,)
    evidence: float  # how sure it is that this is an instrument, from 0 to 1
    side_covariance: Array = field(default_factory=lambda: np.zeros((2, 2, 2)))  # of sides' offsets at both ends, px²
    end_std_px: float = np.inf  # of the end along the axis; infinite where the shaft goes on to the border
    ends_dark: bool = False  # whether it is the end of a part and not of the outline
    pixel_px: float = 2.0  # the width of a pixel of the working image
    other_px: float = 0.0  # how much further along the other one of both is
    other_share: float = 0.0  # the probability that that is the shaft's end
    near_widths: float = 0.0  # from the border to an end too near for the sides to be the shaft's, over its width
    near_share: float = 0.0  # the probability of that one
    shows_shaft: bool = True  # whether what comes in is not a wrist already
    wrist_std: float = 0.0  # where it may be one: by how much the shaft's width is off, over it
    touches_another: bool = False  # what is connected with it comes in elsewhere, too
    knows_tip: bool = True  # False where the tip may be at either end

    @property
    def entry_px(self) -> Array:
        """The middle between both sides at the border, shape (2,)."""
        return np.asarray(self.sides[:, 0].mean(axis=0))

    @property
    def width_px(self) -> float:
        """Distance of both sides at the shaft's end."""
        return float(np.linalg.norm(self.sides[0, 1] - self.sides[1, 1]))

    @property
    def axis(self) -> Array:
        """Unit vector from the border to the end, shape (2,)."""
        along = self.end_px - self.entry_px
        return np.asarray(along / max(float(np.linalg.norm(along)), 1e-9))

    @cached_property
    def mask(self) -> Image:
        """All of it, shape (h, w)."""
        return _enlarged(255 * self.small_mask.astype(np.uint8), self.size)

    @cached_property
    def shaft(self) -> Image:
        """What of it is before the shaft's end, shape (h, w)."""
        x, y = (np.arange(count, dtype=np.float32) for count in self.size[::-1])
        across, down = (x - float(self.end_px[0])) * float(self.axis[0]), y - float(self.end_px[1])
        return self.mask * (across[None, :] < -(down * float(self.axis[1]))[:, None])

    @cached_property
    def distal(self) -> Image:
        """Wrist and jaws, shape (h, w)."""
        return np.asarray(cv2.subtract(self.mask, self.shaft), np.uint8)

    @cached_property
    def tip_px(self) -> Array:
        """What of it is farthest along the axis beyond the end, shape (2,)."""
        rows, columns = np.nonzero(self.small_mask)
        places = (np.stack([columns, rows], axis=1) + 0.5) * self.pixel_px - 0.5 - self.end_px
        ahead = places @ self.axis
        if (farthest := ahead.max(initial=0.0)) <= 0.0:
            return self.end_px
        return np.asarray(self.end_px + places[ahead > farthest - 2.0 * self.pixel_px].mean(0))


def part_entering(outline: Outline, evidence: Evidence) -> float:
    """The network's log-odds of a shaft against wrist and jaws, of what comes in."""
    reach_px = outline.length_px if outline.end_px is None else outline.end_px
    places = outline.across(ENTERING * reach_px, MIDDLE)
    shown = evidence.seen_at(places) & (sampled(evidence.hidden, places, nearest=True) == 0)
    return median(sampled(evidence.scores[1], places)[shown]) if shown.any() else -np.inf


def _seen_instrument(outline: Outline, mask: Mask, score: float, evidence: Evidence) -> SeenInstrument:
    """An instrument of a working image in the pixels of the image that it was made of."""
    sides, end_px = (np.asarray((one + 0.5) / evidence.scale - 0.5) for one in (outline.sides, outline.end))
    pixel_px = 1.0 / evidence.scale
    known = pixel_px**2 * outline.covariance, pixel_px * outline.end_std_px, outline.ends_dark, pixel_px
    other = pixel_px * outline.other_px, outline.other_share
    near = outline.near_px / outline.width_px, outline.near_share
    # What comes in may be a wrist, which is never as long as many shafts are.
    entering = part_entering(outline, evidence)
    length = float(np.linalg.norm(outline.end - outline.start)) / max(outline.end_width_px, 1e-9)
    may_be_wrist = float(np.clip(SURE_ENTERING - entering, 0.0, 1.0) * np.clip(LONGEST_WRIST - length, 0.0, 1.0))
    # Where what is connected with it comes in at another place, too, another instrument touches it.
    parts, _ = evidence.parts
    own = np.bincount(parts[mask & (parts > 0)], minlength=1)
    beside = np.zeros_like(evidence.core)
    line = np.rint([outline.start - outline.length_px * outline.axis, outline.end]).astype(np.int32)
    cv2.polylines(beside, [line], False, 255, max(1, round(ENTRY_WIDTHS * outline.width_px)))
    rim = (parts == int(own.argmax())) & (evidence.rim > 0) & (beside == 0)
    touches = bool(own.any() and np.count_nonzero(rim) >= LEAST_RIM_PX)
    of_part = entering > LEAST_ENTERING, WRIST_NARROWER * may_be_wrist, touches
    of_image = sides, end_px, score, *known, *other, *near
    return SeenInstrument(mask, evidence.size, *of_image, *of_part)


def _enlarged(mask: Image, size: tuple[int, int]) -> Image:
    large = cv2.resize(mask, size[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.threshold(large, 127, 255, cv2.THRESH_BINARY)[1], np.uint8)


def auto_masks(bgr: Image, settings: AutoSettings = DEFAULT, hidden: Image | None = None) -> Masks:
    """`method = "auto"`: the masks of an image, shape (h, w, 3), of which what is `hidden`, (h, w), counts nothing."""
    evidence = Evidence(bgr, settings, hidden)
    seen = tuple(find_instruments(evidence))
    nothing = np.zeros(evidence.size, np.uint8)
    whole, shafts, distal = (
        reduce(np.bitwise_or, masks, nothing)
        for masks in ([one.mask for one in seen], [one.shaft for one in seen], [one.distal for one in seen])
    )
    # Connected parts that are likely instrument, whatever their shape: without a straight shaft all of it is distal.
    parts, area = evidence.parts
    mean = np.bincount(parts.ravel(), evidence.odds.ravel(), len(area)) / np.maximum(area, 1)
    kept = (mean > LIKELY) & (area > settings.least_area * cv2.countNonZero(evidence.core))
    kept[0] = False
    others = _enlarged(255 * kept[parts].astype(np.uint8), evidence.size) & ~whole
    picture, tissue = (_enlarged(mask, evidence.size) for mask in (evidence.picture, tissue_of(evidence)))
    return Masks(tissue & ~(others | whole), others | distal, shafts, ~picture, picture, seen)

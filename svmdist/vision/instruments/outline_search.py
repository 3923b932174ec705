"""From where evidence comes in to the outlines of shafts: how far each goes on, and whether it is one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from svmdist.least_squares import median
from svmdist.transforms import Array
from svmdist.vision.instruments.evidence import CORRELATION_PX, Evidence, Floats, sampled, strongest
from svmdist.vision.instruments.outline import EDGE_LEVELS, STATIONS, Outline, fitted, from_border, starts

SCALES = ((0.45, 1.0), (0.25, 1.0), (0.12, 0.4), (0.07, 0.05))
"""Reach of the profiles over the width, and the region's weight: where the evidence is, then where the edge is."""
MARGINS = np.array([0.08, 0.14, 0.20, 0.26, 0.74, 0.80, 0.86, 0.92])  # over the width, where wrists are narrower
MIDDLE = np.linspace(0.2, 0.8, 5)
WITHIN = np.linspace(0.06, 0.94, 9)
INSIDE_OF_SIDES = (np.linspace(0.04, 0.25, 4), np.linspace(0.75, 0.96, 4))
BESIDE = np.array([0.1, 0.2, 0.3])  # off a side, over the width, or over that of a narrow shaft
NARROW_PX = 20.0  # of which the network's own blur reaches as far beyond the sides
ALONG = np.linspace(0.03, 0.97, STATIONS)  # over the length: where an outline is scored
LEAST_LENGTH = 0.8  # over the width, that a fit keeps of a shaft
MOST_MARGIN = 3.0  # odds of a margin
LONGEST_WRIST = 6.0  # of wrist and jaws as wide as the shaft, over its width: closed ones of 20 mm on 5 mm
WRIST_SHARE = 0.6  # of instruments whose outline goes on beyond the shaft's end
MOST_PART, PART_WIDTHS = 2.0, 0.5  # odds of a pixel's part, and over how many widths they err alike
STEP_WIDTHS = 0.4  # over which colour is averaged before and after a change
LEAST_STEP_PX = 3  # the same next to the border, where less is in view
MATERIAL_STEP, MATERIAL_WEIGHT = 0.15, 2.5
"""Changes of log(R/G), log(G/B) and of light along a shaft itself; they are so sure as two that are independent."""
MOST_MATERIAL = 5.0  # odds of the clearest change: bands, plates, blood and parts of the wrist are as clear
LONGEST_CLEVIS = 1.5  # of an outline beyond the shaft's end that has straight sides, too
LEAST_SHARE = 1e-3  # of an end that is worth a thought
STILL_OUTLINE = 0.3  # of the width: an end so far before that of the outline is that of a part
LEAST_WIDTHS = 0.6  # of a shaft's length, over its width
LEAST_ROUGH_EVIDENCE = 0.05  # of an outline whose sides are not yet on their edges
LEAST_EVIDENCE = 0.43  # nearly all real instruments have more, and of glare, fat, cables and shadows few
STEP_REACH_PX = 4  # from a side, where the steepest step across it is sought
STRAIGHT_PX, STRAIGHT_WIDTHS = 1.5, 0.05
"""Of those steps off a common line, in px or over the width: of glare's jagged edge few are that near."""
MOST_OF_BEYOND = 0.7
"""Of the places inside of a side whose colour is nearer to what lies beyond it than to the rest of the instrument."""
LEAST_STRIP = -0.5  # mean odds of a strip: what becomes a shaft has more, half of the rest less
LEAST_LENGTH_PX = 16.0  # of a shaft: shorter edges of tissue are straight by chance


def _ended(outline: Outline, evidence: Evidence) -> Outline:
    """The outline as far as its sides go, with the end of the shaft, and how far that is spread along the axis.

    Both margins say where the outline ends; the shaft ends there, or anywhere a wrist's length before. Where in that
    stretch, say what it is made of and the parts' classes: both are log-odds of places along the axis. The likelier of
    both is the end, and the other one is kept beside it.
    """
    along = np.arange(0.5, 1.2 * float(np.hypot(*evidence.core.shape)))
    places = outline.across(along, MARGINS)
    seen = sampled(evidence.core, places) == 255  # whole: between light and none, log-odds are half those of the dark
    in_view = seen.mean(1) >= 0.5
    first = int(np.argmax(in_view))  # where it comes in at a slant, less of it is in view
    last = first + int(np.argmin(np.append(in_view[first:], False)))
    if last < 4:
        return outline
    along, places, seen = along[:last], places[:last], seen[:last]
    odds = np.clip(sampled(evidence.odds, places), -MOST_MARGIN, MOST_MARGIN)
    # What comes in is surely the instrument: half of its own log-odds are its border, however the network blurs it.
    odds -= 0.5 * max(median(_weaker_side(odds, seen)[: int(outline.width_px) + 1]), 0.0)
    odds[sampled(evidence.hidden, places, nearest=True) > 0] = 0.0
    outline_ends = _probabilities(np.cumsum(_weaker_side(odds, seen)) / CORRELATION_PX)
    wrist_px = max(1, round(LONGEST_WRIST * outline.width_px))
    total = np.concatenate([np.cumsum(outline_ends[::-1])[::-1], np.zeros(wrist_px)])
    possible = (1.0 - WRIST_SHARE) * outline_ends + WRIST_SHARE / wrist_px * (total[:last] - total[wrist_px:])

    middle = outline.across(along, MIDDLE)
    is_instrument = 1.0 / (1.0 + np.exp(-sampled(evidence.odds, middle).mean(1)))
    # What comes in is surely shaft: half of its own log-odds are no more than the image's.
    part = sampled(evidence.scores[1], middle).mean(1)
    part -= 0.5 * max(median(part[: 1 + int(0.5 * (outline_ends @ along))]), 0.0)
    hidden = sampled(evidence.hidden, middle, nearest=True).max(1) > 0
    part[hidden] = 0.0
    parts = np.cumsum(is_instrument * np.clip(part, -MOST_PART, MOST_PART)) / (PART_WIDTHS * outline.width_px)
    log_p = np.log(possible + 1e-30) + parts + _material(outline, middle, hidden, evidence)
    is_near = along < min(LEAST_LENGTH * outline.width_px, along[-1] - 2.0)
    near = _probabilities(log_p) * is_near
    near_share = float(near.sum())
    log_p[is_near] = -np.inf
    p = _probabilities(log_p)
    whole = float(outline_ends @ along)
    of_part = along < whole - STILL_OUTLINE * outline.width_px
    is_part = float(p[of_part].sum()) > 0.5
    own, other = (p * of_part, p * ~of_part) if is_part else (p * ~of_part, p * of_part)
    other_share = float(other.sum())
    mean = float(own @ along) / float(own.sum())
    goes_out = not is_part and whole > along[-1] - 2.5
    std_px = np.inf if goes_out else float(np.sqrt(own @ (along - mean) ** 2 / own.sum())) + 1.0
    # A collar or clevis is as wide as the shaft; what is longer are jaws, which narrow as it seems to.
    sides_px = max(mean, whole) if whole - mean < LONGEST_CLEVIS * outline.width_px else mean
    other_px = float(other @ along) / max(other_share, 1e-9) - mean if other_share > LEAST_SHARE else 0.0
    near_px = float(near @ along) / max(near_share, 1e-9)
    outline = outline.cut(0.0, sides_px)
    outline = replace(outline, end_px=mean, whole_px=whole, end_std_px=std_px, ends_dark=is_part)
    return replace(outline, other_px=other_px, other_share=other_share, near_px=near_px, near_share=near_share)


def _probabilities(log_p: Array) -> Array:
    """Of places by their log-odds, shape (n,): they add to 1."""
    p = np.exp(np.maximum(log_p - log_p.max(), -50.0))
    return np.asarray(p / p.sum())


def _weaker_side(odds: Floats, seen: NDArray[np.bool_]) -> Array:
    """The mean of margins' log-odds, (n, 8), at the weaker of both sides, (n,), of those that are `seen`, (n, 8)."""
    # A shaft leaves the picture at a slant: where one side is out of view, the other one says whether it goes on.
    shown = seen.reshape(-1, 2, 4).sum(2)
    mean = (odds * seen).reshape(-1, 2, 4).sum(2) / np.maximum(shown, 1)
    return np.where(shown.any(1), np.where(shown > 0, mean, np.inf).min(1), 0.0)


def _material(outline: Outline, middle: Array, hidden: NDArray[np.bool_], evidence: Evidence) -> Array:
    """Log-odds of a shaft's end by changes of colour and light at places along the axis, (n,), not at `hidden` ones."""
    colours = np.sort(sampled(evidence.colours, middle), axis=1)[:, middle.shape[1] // 2]  # their medians
    half, at = max(3, round(STEP_WIDTHS * outline.width_px)), np.arange(len(colours))
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(colours, axis=0)])
    before, after = np.maximum(at - half, 0), np.minimum(at + half, len(colours))
    step = (total[after] - total[at]) / np.maximum(after - at, 1)[:, None]
    step -= (total[at] - total[before]) / np.maximum(at - before, 1)[:, None]
    up_to = np.append(0, np.cumsum(hidden))
    is_hidden = up_to[after] > up_to[before]
    change = np.sqrt((step**2).sum(1))
    change[(at < LEAST_STEP_PX) | (at > len(colours) - half) | is_hidden] = 0.0
    odds = MATERIAL_WEIGHT * np.log1p((change / MATERIAL_STEP) ** 2)
    odds *= min(1.0, MOST_MATERIAL / max(float(odds.max()), 1e-9))
    return np.where(is_hidden, 0.5 * MOST_MATERIAL, odds)  # there may be a change, and there may be none


def rough_outlines(evidence: Evidence) -> list[Outline]:
    """Outlines where the evidence is, from every place where an instrument may come in, the most first."""
    found: list[tuple[float, Outline]] = []
    for strip in starts(evidence):
        if (outline := from_border(strip, evidence)) is None:
            continue
        places = outline.across(ALONG * outline.length_px, WITHIN)
        odds = sampled(evidence.odds, places)[evidence.seen_at(places)]
        if len(odds) and odds.mean() <= LEAST_STRIP:
            continue
        outline = fitted(_ended(outline, evidence), evidence, *SCALES[0])
        if outline is None:
            continue
        outline = _ended(outline, evidence)
        score = outline_score(outline, evidence, is_rough=True)
        area_px2 = outline.whole.length_px * outline.width_px  # of sides that cross it is no area
        if score > LEAST_ROUGH_EVIDENCE and area_px2 > 0.0:
            found.append((score * np.sqrt(area_px2), outline))
    return [outline for _, outline in sorted(found, key=lambda one: -one[0])]


def sharpened(outline: Outline, evidence: Evidence) -> Outline | None:
    """A rough outline where the edges are."""
    for scale in SCALES[1:]:
        if (moved := fitted(outline, evidence, *scale)) is None:
            return None
        outline = moved
    return _ended(outline, evidence)


def _likely(odds: Floats, seen: NDArray[np.bool_]) -> float:
    """The mean probability; 0 where nothing is seen."""
    return float((1.0 / (1.0 + np.exp(-odds[seen]))).mean()) if seen.any() else 0.0


def _of_beyond(colours: list[Floats], seen: NDArray[np.bool_]) -> float:
    """The share of places inside of a side that look rather like what lies beyond it than like the rest of the shaft.

    A cable beside a shaft may be as straight as its side, and the network take both for one. Colours (n, k, 3) are
    those within, inside of both sides and beyond both; of the worse side, of places that are `seen`, (n,). The rest is
    what lies between at that place, the other side, or the middle colour of all: lettering is of another one.
    """
    if not seen.any():
        return 0.0
    within = colours[0][seen][:, 3:-3]
    first, second, *beyond = (one[seen].mean(1) for one in colours[1:])
    between = within.mean(1), np.median(within, (0, 1))
    shares = []
    for own, other, out in ((first, second, beyond[0]), (second, first, beyond[1])):
        apart = [np.linalg.norm(own - one, axis=1) for one in (out, other, *between)]
        shares.append(float((np.argmin(apart, axis=0) == 0).mean()))
    return max(shares)


def outline_score(outline: Outline, evidence: Evidence, *, is_rough: bool = False) -> float:
    """An outline's score as far as it goes, from 0 to 1, by evidence and image: a part of anything may be straight.

    0 of what is no instrument; a rough outline has its score in any case, and its colours are not looked at.
    """
    outline = outline.whole
    along = ALONG * outline.length_px
    off = BESIDE * max(1.0, NARROW_PX / outline.width_px)
    shares = (WITHIN, *INSIDE_OF_SIDES, -off, 1.0 + off)
    places = outline.across(along, np.concatenate(shares))
    parts = np.cumsum([len(one) for one in shares])[:-1]
    seen, odds = evidence.seen_at(places), sampled(evidence.odds, places)
    within, _, _, *beside = zip(np.split(odds, parts, 1), np.split(seen, parts, 1), strict=True)
    free = [_likely(-odds, seen) for odds, seen in beside if np.count_nonzero(seen) > 6]
    points = outline.at(along)
    outward = outline.normal * np.array([-1.0, 1.0])[:, None]
    around = np.arange(-STEP_REACH_PX - 1.0, STEP_REACH_PX + 1.5)
    across_sides = points[:, :, None] + around[:, None] * outward[:, None, None]
    levels, is_seen = sampled(evidence.bgr_float, across_sides), evidence.seen_at(across_sides)
    step = strongest(np.abs(levels[:, :, 2:] - levels[:, :, :-2]))
    whole, steepest = is_seen.all(2), np.argmax(step, axis=2) - STEP_REACH_PX
    # The steepest step may be that of the limb's shade, but then it is that all along the side.
    off_px = np.abs(steepest - np.median(steepest, axis=1, keepdims=True))
    good = (step.max(2) > EDGE_LEVELS) & (off_px <= max(STRAIGHT_PX, STRAIGHT_WIDTHS * outline.width_px))
    stepped = float(good[whole].mean()) if whole.any() else 0.0
    length_widths = outline.length_px / outline.width_px
    sure = _likely(*within) * min(free, default=0.0) * float(np.sqrt(stepped))
    sure *= min(1.0, 0.5 + 0.25 * length_widths)
    if is_rough:
        return sure
    is_long = length_widths > LEAST_WIDTHS and outline.length_px > LEAST_LENGTH_PX
    # With what comes in at the border hidden, a wrist may pass for a shaft.
    shown = sampled(evidence.hidden, outline.across(along, MIDDLE), nearest=True) == 0
    comes_in = float(shown[: STATIONS // 3].mean()) > 0.5
    if not (is_long and comes_in and sure > LEAST_EVIDENCE):
        return 0.0
    colours = np.split(sampled(evidence.colours, places), parts, 1)
    return sure if _of_beyond(colours, seen.all(1) & shown.all(1)) < MOST_OF_BEYOND else 0.0

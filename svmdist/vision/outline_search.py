"""From where evidence comes in to the outlines of shafts: how far each goes on, and whether it is one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from svmdist.transforms import Array
from svmdist.vision.evidence import Evidence, Floats
from svmdist.vision.outline import (
    CORRELATION_PX,
    EDGE_LEVELS,
    STATIONS,
    Outline,
    fitted,
    from_border,
    sampled,
    starts,
)

SCALES = ((0.45, 1.0), (0.25, 1.0), (0.12, 0.4), (0.07, 0.05))
"""Reach of the profiles over the width, and the region's weight: where the evidence is, then where the edge is."""
MARGINS = np.array(
    [0.08, 0.14, 0.20, 0.26, 0.74, 0.80, 0.86, 0.92]
)  # over the width, where wrists are narrower
MIDDLE = np.linspace(0.2, 0.8, 5)
PART_WEIGHT = 1.5  # of what the network sees as wrist and jaws, while the sides are not yet known
LEAST_LENGTH = 0.8  # over the width, that a fit keeps of a shaft
MOST_MARGIN = 3.0  # odds of a margin


def ended(outline: Outline, evidence: Evidence, part_weight: float) -> Outline:
    """The outline up to where both its margins stop being instrument.

    With a weight for it, also where the network sees the distal part begin.
    """
    along = np.arange(0.5, 1.2 * float(np.hypot(*evidence.core.shape)))
    places = outline.across(along, MARGINS)
    seen = sampled(evidence.core, places, nearest=True).mean(1) > 127
    last = int(np.argmin(seen)) if not seen.all() else len(seen)
    if last < 4:
        return outline
    along, places = along[:last], places[:last]
    odds = np.clip(sampled(evidence.odds, places), -MOST_MARGIN, MOST_MARGIN)
    speaks = np.minimum(odds[:, :4].mean(1), odds[:, 4:].mean(1))
    if part_weight:
        part = sampled(evidence.scores[1], outline.across(along, MIDDLE)).mean(1)
        speaks = speaks + part_weight * np.clip(part, -2.0, 0.0)
    total = np.cumsum(speaks) / CORRELATION_PX
    total[along < min(LEAST_LENGTH * outline.width_px, along[-1] - 2.0)] = -np.inf
    p = np.exp(np.maximum(total - total.max(), -50.0))
    p /= p.sum()
    mean = float(p @ along)
    std_px = np.inf if mean > along[-1] - 2.5 else float(np.sqrt(p @ (along - mean) ** 2)) + 1.0
    return replace(outline.cut(0.0, mean), end_std_px=std_px)


def rough_outlines(evidence: Evidence) -> list[Outline]:
    """Outlines where the evidence is, from every place where an instrument may come in, the most of it first."""
    found: list[tuple[float, Outline]] = []
    for strip in starts(evidence):
        outline = from_border(strip, evidence)
        if outline is not None:
            outline = _fitted_at(ended(outline, evidence, PART_WEIGHT), evidence, SCALES[:1])
        if outline is not None:
            score = judged(outline, evidence).evidence
            if score > LEAST_ROUGH_EVIDENCE:
                found.append((score * np.sqrt(outline.length_px * outline.width_px), outline))
    return [outline for _, outline in sorted(found, key=lambda one: -one[0])]


def sharpened(outline: Outline, evidence: Evidence) -> Outline | None:
    """A rough outline where the edges are."""
    sharp = _fitted_at(outline, evidence, SCALES[1:])
    if sharp is None:
        return None
    whole = ended(sharp, evidence, 0.0)
    dark_px = dark_part_px(whole, evidence)
    if dark_px is None or whole.length_px - dark_px < LONGEST_CLEVIS * whole.width_px:
        return whole
    # Jaws that narrow as the shaft does: the outline goes on to their tips.
    return replace(whole.cut(0.0, dark_px), end_std_px=DARK_END_STD * whole.width_px, ends_dark=True)


def _fitted_at(outline: Outline, evidence: Evidence, scales: Sequence[tuple[float, float]]) -> Outline | None:
    for reach_widths, region_weight in scales:
        moved = fitted(outline, evidence, reach_widths, region_weight)
        if moved is None:
            return None
        outline = ended(moved, evidence, PART_WEIGHT)
        dark_px = dark_part_px(outline, evidence)
        outline = outline if dark_px is None else outline.cut(0.0, dark_px)
    return outline


STEP = 0.35  # of the logarithm of light from a dark shaft to a steel wrist; along a shaft it changes slowly
STEP_WIDTHS = 0.4  # over which the light is averaged before and after the step
LONGEST_CLEVIS = 1.5  # of an outline beyond the dark part, over the width: what is longer is wrist and jaws
DARK_END_STD = 0.3  # of the dark part's end, over the width


def dark_part_px(outline: Outline, evidence: Evidence) -> float | None:
    """How long the dark part of a shaft is, where it ends within the outline."""
    along = np.arange(0.5, outline.length_px)
    half = max(3, round(STEP_WIDTHS * outline.width_px))
    first = max(half, round(LEAST_LENGTH * outline.width_px))
    if len(along) < first + 2 * half:
        return None
    light = np.median(sampled(evidence.colours[..., 2], outline.across(along, MIDDLE)), axis=1)
    total = np.concatenate([[0.0], np.cumsum(light)])
    at = np.arange(first, len(along) - 2 * half + 1)
    before, after, beyond = (
        (total[at + high] - total[at + low]) / half for low, high in ((-half, 0), (0, half), (half, 2 * half))
    )
    step = np.minimum(after, beyond + 0.5 * STEP) - before
    best = int(np.argmax(step))
    return float(along[at[best]]) if step[best] > STEP else None


LEAST_WIDTHS = 0.6  # of a shaft's length, over its width
LEAST_ROUGH_EVIDENCE = 0.05  # of an outline whose sides are not yet on their edges
LEAST_EVIDENCE = 0.47  # nearly all real instruments have more, and of glare, fat and shadows few
STEP_REACH_PX = 4  # from a side, where the steepest step across it is sought
STRAIGHT_PX, STRAIGHT_WIDTHS = 1.5, 0.05
"""Of those steps off a common line, in px or over the width: of glare's jagged edge few are that near."""
LEAST_LENGTH_PX = 16.0  # of a shaft: shorter edges of tissue are straight by chance


@dataclass(frozen=True)
class Judged:
    """Shares from 0 to 1: of the strip that is evidence, of what is beside that is not, of both sides with a step."""

    inside: float
    beside: float
    stepped: float
    length_px: float
    length_widths: float

    @property
    def is_accepted(self) -> bool:
        """Whether this is an instrument."""
        is_shaft = self.length_widths > LEAST_WIDTHS and self.length_px > LEAST_LENGTH_PX
        return is_shaft and self.inside > 0.75 and self.beside > 0.5 and self.evidence > LEAST_EVIDENCE

    @property
    def evidence(self) -> float:
        """From 0 to 1, how sure it is that this is an instrument."""
        return (
            self.inside
            * self.beside
            * float(np.sqrt(self.stepped))
            * min(1.0, 0.5 + 0.25 * self.length_widths)
        )


def judged(outline: Outline, evidence: Evidence) -> Judged:
    """What evidence and image say of an outline."""
    share = np.linspace(0.03, 0.97, STATIONS)
    along = share * outline.length_px

    def odds_at(places: Array) -> tuple[Floats, NDArray[np.bool_]]:
        return sampled(evidence.odds, places), sampled(evidence.core, places, nearest=True) > 0

    odds, seen = odds_at(outline.across(along, np.linspace(0.06, 0.94, 9)))
    inside = float((odds > 0.0)[seen].mean()) if seen.any() else 0.0
    free = []
    for side in (np.array([-0.15, -0.25, -0.35]), np.array([1.15, 1.25, 1.35])):
        odds, seen = odds_at(outline.across(along, side))
        if np.count_nonzero(seen) > 6:
            free.append(float((odds < 0.0)[seen].mean()))
    points = outline.at(along)
    outward = outline.normal * np.array([-1.0, 1.0])[:, None]
    around = np.arange(-STEP_REACH_PX - 1.0, STEP_REACH_PX + 1.5)
    places = points[:, :, None] + around[:, None] * outward[:, None, None]
    levels, seen = sampled(evidence.bgr_float, places), sampled(evidence.core, places, nearest=True) > 0
    step = np.abs(levels[:, :, 2:] - levels[:, :, :-2]).max(3)
    whole, steepest = seen.all(2), np.argmax(step, axis=2) - STEP_REACH_PX
    # The steepest step may be that of the limb's shade, but then it is that all along the side.
    straight = np.abs(steepest - np.median(steepest, axis=1, keepdims=True)) <= max(
        STRAIGHT_PX, STRAIGHT_WIDTHS * outline.width_px
    )
    good = (step.max(2) > EDGE_LEVELS) & straight
    stepped = float(good[whole].mean()) if whole.any() else 0.0
    return Judged(
        inside,
        min(free, default=0.0),
        stepped,
        outline.length_px,
        outline.length_px / outline.width_px,
    )

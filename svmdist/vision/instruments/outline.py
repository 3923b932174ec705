"""A shaft's outline in evidence: where instruments come in, and two straight sides by each edge's posterior."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.instruments.evidence import CORRELATION_PX, SQUARE_3, Evidence, Floats, sampled, strongest

START_ODDS = 0.5  # from which on a pixel of the rim belongs to a place where an instrument comes in
UNSURE_ODDS = -1.5  # down to which an instrument may go on to the rim: in the dark of a corner none is seen
LEAST_RIM_PX = 6  # pixels of such a place
MOST_PLACES, STARTS_PER_PLACE = 5, 2
ANGLES = 60  # directions that are tried at each of them
ALONG_PX, ACROSS_PX = 3.0, 1.5  # between samples of such a strip
START_LENGTHS = (0.12, 0.25, 0.4)  # of the strip that is tried, over the working image's width
MARGIN = 0.10  # how far beside such a place the strip may lie, over the same
LEAST_TURN_RAD = 0.25  # of two starts at one place
LEAST_WIDTH_PX, MOST_WIDTH = 4.0, 0.5  # of a strip in px, and over the working image's width
CLIPPED = 2.0  # odds of a pixel of the strip: one that is very sure outweighs no more than its neighbour

STATIONS, SAMPLES = 28, 33
STATION_SHARES = np.linspace(0.02, 0.99, STATIONS)  # of the length, where profiles cross both sides
BY_ENDS = np.stack([1.0 - STATION_SHARES, STATION_SHARES], -1)  # a side's offsets there by those of its ends
WINDOWS = (0.5, 0.3, 0.3)  # about the line of each step, over the profiles' reach
LEAST_REACH_PX = 3.0
EDGE_LEVELS = 8.0  # of 255: steps of so much are as likely noise
EDGE_STD_PX = 0.4  # of a side in the working image: what all its points have in common
MOST_POINTS = 5.0  # points of a side that err independently, beside that
LEAST_AGREEMENT = 0.1  # of what stations vary by, over their own variance
MOST_DISAGREEMENT = 30.0  # the same of a side that is no line
CAUCHY = 2.5  # deviations at which a station counts half
END_CLEAR = 0.15  # of the width: what is nearer to the end may not be the shaft's side any more
FOCAL_WIDTHS = 1.1  # focal length over the image's width, as endoscopes have it
TAPER_STD = 0.02  # of both sides against each other beside that
TILT = (1.0, 0.6)  # tangent of the axis' angle to the image plane: mean and deviation of instruments


@dataclass(frozen=True)
class Outline:
    """Two straight sides in px, (2, 2, 2): side, border and inner end, (x, y)."""

    sides: Array
    covariance: Array = field(default_factory=lambda: np.zeros((2, 2, 2)))  # of each side's offsets at both its ends
    end_px: float | None = None  # of the shaft, along the axis from the border; None: at the sides' ends
    whole_px: float | None = None  # the same of the outline
    end_std_px: float = np.inf  # infinite where the shaft leaves the picture
    ends_dark: bool = False  # a part ends there, and the outline goes on
    other_px: float = 0.0  # how much further on the other one of both ends is
    other_share: float = 0.0  # the probability that that is the shaft's
    near_px: float = 0.0  # from the border to an end that is too near for the shaft to have sides
    near_share: float = 0.0  # the probability of that one

    @property
    def end(self) -> Array:
        """The middle of the shaft's end, shape (2,)."""
        along_px = self.length_px if self.end_px is None else self.end_px
        return np.asarray(self.at(np.array([along_px])).mean((0, 1)))

    @cached_property
    def start(self) -> Array:
        """The middle between both sides at the border, shape (2,)."""
        return np.asarray(0.5 * (self.sides[0, 0] + self.sides[1, 0]))

    @cached_property
    def _run(self) -> Array:
        return np.asarray(0.5 * (self.sides[0, 1] + self.sides[1, 1]) - self.start)

    @cached_property
    def axis(self) -> Array:
        """Unit vector inwards, shape (2,)."""
        return np.asarray(self._run / max(float(np.sqrt(self._run @ self._run)), 1e-9))

    @cached_property
    def normal(self) -> Array:
        """Unit vector from the first side to the second, across the axis, shape (2,)."""
        return np.array([-self.axis[1], self.axis[0]])

    @cached_property
    def length_px(self) -> float:
        """From border to end along the axis."""
        return float(self._run @ self.axis)

    @cached_property
    def width_px(self) -> float:
        """Mean distance of both sides."""
        return float(0.5 * (self.sides[1] - self.sides[0]).sum(0) @ self.normal)

    @property
    def end_width_px(self) -> float:
        """Distance of both sides at their inner ends."""
        return float(np.linalg.norm(self.sides[1, 1] - self.sides[0, 1]))

    def at(self, along_px: Array) -> Array:
        """Points on both sides at places along the axis from the start, shape (2, n, 2)."""
        first, u = self.sides[:, 0], self.axis
        direction = self.sides[:, 1] - first
        run = np.maximum(direction @ u, 1e-9)
        share = (along_px - ((first - self.start) @ u)[:, None]) / run[:, None]
        # As complex numbers: NumPy is slow along an axis of two.
        points = first.copy().view(np.complex128) + share * direction.view(np.complex128)
        return points.view(np.float64).reshape(*share.shape, 2)

    def cut(self, start_px: float, end_px: float) -> Outline:
        """The same lines between two other places along the axis."""
        ends = np.array([start_px, end_px])
        first, second = (ends / max(self.length_px, 1e-9)).tolist()
        J = np.array([[1.0 - first, first], [1.0 - second, second]])
        end, whole = (None if one is None else one - start_px for one in (self.end_px, self.whole_px))
        return replace(self, sides=self.at(ends), covariance=J @ self.covariance @ J.T, end_px=end, whole_px=whole)

    @cached_property
    def whole(self) -> Outline:
        """The same as far as the outline goes, beyond the shaft's end, too."""
        return self if self.whole_px is None else self.cut(0.0, self.whole_px)

    def across(self, along_px: Array, shares: Array) -> Array:
        """Points between both sides, 0 at the first and 1 at the second, shape (n, m, 2)."""
        first, second = self.at(along_px).view(np.complex128)
        between = np.asarray(first + shares * (second - first))
        return between.view(np.float64).reshape(*between.shape, 2)


def starts(evidence: Evidence) -> Iterator[Outline]:
    """Strips from every place of the rim where evidence comes in, for sure or not, the best direction first."""
    odds, core = evidence.odds, evidence.core
    likely = np.asarray(255 * ((odds > START_ODDS) & (core > 0)), np.uint8)
    likely = np.asarray(cv2.morphologyEx(likely, cv2.MORPH_OPEN, SQUARE_3), np.uint8)
    # What does not reach the rim goes on to it through what is not surely something else (hysteresis).
    count, parts = cv2.connectedComponents(np.asarray((odds > UNSURE_ODDS) & (core > 0), np.uint8))
    is_lost = np.zeros(count, np.bool_)
    is_lost[parts[likely > 0]], is_lost[parts[(likely & evidence.rim) > 0]] = True, False
    likely[is_lost[parts]] = 255
    _, labels, stats, _ = cv2.connectedComponentsWithStats(cv2.bitwise_and(likely, evidence.rim))
    clipped = np.where(core > 0, np.clip(odds, -CLIPPED, CLIPPED), 0).astype(np.float32)
    for label in (np.argsort(-stats[1:, 4], kind="stable") + 1)[:MOST_PLACES]:
        if stats[label, 4] < LEAST_RIM_PX:
            continue
        y, x = np.nonzero(labels == label)
        reach_px = 0.5 * float(np.hypot(np.ptp(x), np.ptp(y))) + 1.0 + MARGIN * core.shape[1]
        yield from _strips(clipped, core, np.array([x.mean(), y.mean()]), reach_px)


def _strips(clipped: Floats, core: Image, entry: Array, reach_px: float) -> Iterator[Outline]:
    height, width = core.shape
    angles = np.arange(ANGLES) * (2.0 * np.pi / ANGLES)
    u = np.stack([np.cos(angles), np.sin(angles)], -1)
    inner = np.rint(entry + 0.6 * START_LENGTHS[0] * width * u).astype(int)
    within = ((inner >= 0) & (inner < [width, height])).all(1)
    within &= core[np.clip(inner[:, 1], 0, height - 1), np.clip(inner[:, 0], 0, width - 1)] > 0
    u = u[within]
    if not len(u):
        return
    normal = np.stack([-u[:, 1], u[:, 0]], -1)
    along = np.arange(2.0, START_LENGTHS[-1] * width, ALONG_PX)
    off = np.arange(-reach_px, reach_px + 1.0, ACROSS_PX)
    lines = (entry + off[:, None] * normal[:, None]).astype(np.float32).view(np.complex64)  # (angles, off, 1)
    steps = (along[:, None] * u[:, None]).astype(np.float32).view(np.complex64)  # (angles, along, 1)
    places = (lines[:, None, :, 0] + steps).view(np.float32).reshape(*steps.shape[:2], -1, 2)
    total = np.cumsum(sampled(clipped, places), axis=1)  # (angles, along, off)
    best: list[tuple[float, int, int, int, int]] = []
    rows, columns = np.arange(len(u)), np.arange(len(off) + 1)
    for length in START_LENGTHS:
        last = min(int(length * width / ALONG_PX), len(along)) - 1
        profile = np.concatenate([np.zeros((len(u), 1)), np.cumsum(total[:, last], axis=1)], axis=1)
        low = np.minimum.accumulate(profile, axis=1)  # the best interval (Kadane 1984)
        begins = np.maximum.accumulate(np.where(profile == low, columns, 0), axis=1)
        last_at = np.argmax(profile - low, axis=1)
        inside, first_at = (profile - low)[rows, last_at], begins[rows, last_at]
        strip_px = ACROSS_PX * (last_at - first_at)
        score = (2.0 * inside - profile[:, -1]) / np.sqrt(last + 1.0)
        fits = np.flatnonzero((strip_px >= LEAST_WIDTH_PX) & (strip_px <= MOST_WIDTH * width))
        best += [(float(score[at]), int(at), int(first_at[at]), int(last_at[at]), last) for at in fits]
    kept: list[int] = []
    for _, at, low_at, high, last in sorted(best, reverse=True):
        if len(kept) < STARTS_PER_PLACE and all(u[at] @ u[other] < np.cos(LEAST_TURN_RAD) for other in kept):
            kept.append(at)
            edges, ends = off[0] + ACROSS_PX * (np.array([low_at, high]) - 0.5), np.array([0.0, along[last]])
            yield Outline(entry + ends[None, :, None] * u[at] + edges[:, None, None] * normal[at])


def from_border(outline: Outline, evidence: Evidence) -> Outline | None:
    """The outline from where its axis comes into the picture; None where that is not in view."""
    along = np.arange(outline.length_px, outline.length_px - 2.0 * max(evidence.core.shape), -1.0)
    seen = evidence.seen_at(outline.across(along, np.array([0.5])))[:, 0]
    first = int(np.argmax(seen))
    if not seen[first]:
        return None
    last = first + int(np.argmin(np.append(seen[first:], False))) - 1
    start_px, end_px = float(along[last]), float(along[first])
    return outline.cut(start_px, end_px) if end_px - start_px > LEAST_WIDTH_PX else None


def _before_end(outline: Outline, along_px: Array) -> Array:
    """How likely places along the axis, (n,), are well before the shaft's end, whichever of its two that is."""
    ends_px, shares, end_px = [outline.length_px], [1.0], outline.end_px
    if end_px is not None and (near_px := min(end_px, end_px + outline.other_px)) < outline.length_px:
        near = outline.other_share if outline.other_px < 0.0 else 1.0 - outline.other_share
        ends_px, shares = [outline.length_px, near_px], [1.0 - near, near]
    # Near the end the outline may not be the shaft's any more.
    clear_px = np.array(ends_px)[:, None] - along_px - END_CLEAR * outline.width_px
    clear = np.clip(clear_px / (0.05 * outline.width_px + 0.5), -50.0, 50.0)
    return np.asarray(np.array(shares) @ (1.0 / (1.0 + np.exp(-clear))))


def fitted(outline: Outline, evidence: Evidence, reach_widths: float, region_weight: float) -> Outline | None:
    """Both sides moved onto their edges, found along profiles; None where they leave the picture or meet."""
    length_px, width_px, J = outline.length_px, outline.width_px, BY_ENDS
    along_px, outward = STATION_SHARES * length_px, outline.normal * np.array([-1.0, 1.0])[:, None]
    half_px = max(reach_widths * width_px, LEAST_REACH_PX)
    offsets = np.linspace(-half_px, half_px, SAMPLES)
    places = outline.at(along_px)[:, :, None] + offsets[:, None] * outward[:, None, None]
    log_p, seen = _log_posterior(evidence, places, float(offsets[1] - offsets[0]), region_weight)
    before, usable = _before_end(outline, along_px), seen.mean(2) > 0.6
    weight_cap = min(1.0, length_px / STATIONS / CORRELATION_PX) * before * usable
    per_px = length_px * width_px / (FOCAL_WIDTHS * evidence.core.shape[1])
    narrowing = np.array([1.0, -1.0, 1.0, -1.0])  # of the width, by the offsets of all ends
    at_border, at_end = (outline.sides[1] - outline.sides[0]) @ outline.normal
    expected_px = TILT[0] * per_px - float(at_border - at_end)
    std_px = TILT[1] * per_px + TAPER_STD * length_px
    prior = np.outer(narrowing, narrowing) / std_px**2 + 1e-6 * np.eye(4)
    moved = np.zeros((2, 2))
    for window in WINDOWS:
        at = moved @ J.T
        mean, variance = _moments(log_p, offsets, at, window * half_px)
        std = np.sqrt(variance + EDGE_STD_PX**2)
        weight = weight_cap / (1.0 + ((at - mean) / std / CAUCHY) ** 2) / std**2
        total = np.maximum(weight.sum(1, keepdims=True), 1e-9)
        weight *= np.minimum(1.0, MOST_POINTS / EDGE_STD_PX**2 / total)
        A, b = prior.copy(), narrowing * expected_px / std_px**2
        for side in (0, 1):
            of_side = np.s_[2 * side : 2 * side + 2]
            A[of_side, of_side] += J.T @ (J * weight[side, :, None])
            b[of_side] += J.T @ (weight[side] * mean[side])
        moved = np.asarray(np.linalg.solve(A, b).reshape(2, 2), np.float64)
    # The posterior of one station is as wide as the edge's blur; their scatter about the line says more.
    agreement = (weight * (at - mean) ** 2).sum() / max(weight_cap.sum(), 1e-9)
    known = np.linalg.inv((A - prior) / float(np.clip(agreement, LEAST_AGREEMENT, MOST_DISAGREEMENT)) + prior)
    covariance = np.stack([known[:2, :2], known[2:, 2:]]) + EDGE_STD_PX**2 * np.eye(2)
    new = replace(outline, sides=outline.sides + moved[..., None] * outward[:, None], covariance=covariance)
    fits = LEAST_WIDTH_PX <= new.width_px <= MOST_WIDTH * evidence.core.shape[1]
    fits &= ((new.sides[1] - new.sides[0]) @ new.normal).min() > 1.0
    return from_border(new, evidence) if fits and new.axis @ outline.axis > 0.5 else None


def _moments(log_p: Array, offsets: Array, at: Array, window_px: float) -> tuple[Array, Array]:
    """Mean and variance (2, n) of edges of log p (2, n, m) at offsets (m,), in windows about `at` (2, n)."""
    windowed = log_p - 0.5 * ((offsets - at[..., None]) / window_px) ** 2
    p = np.exp(windowed - windowed.max(2, keepdims=True))
    p /= p.sum(2, keepdims=True)
    mean = p @ offsets
    variance = (p * (offsets - mean[..., None]) ** 2).sum(2) + 0.1
    # The window's own share is taken out.
    free = 1.0 / np.maximum(1.0 / variance - 1.0 / window_px**2, 0.15 / window_px**2)
    return at + (mean - at) * np.minimum(free / variance, 3.0), free


def _log_posterior(
    evidence: Evidence, places: Array, step_px: float, region_weight: float
) -> tuple[Array, NDArray[np.bool_]]:
    """log p of the edge at each of the places (2, n, m, 2), by what is inside of it and by the step; what is seen."""
    seen = sampled(evidence.core & ~evidence.hidden, places, nearest=True) > 0
    odds = np.where(seen, sampled(evidence.odds, places), 0.0) * (step_px / CORRELATION_PX)
    region = np.cumsum(odds, 2) - 0.5 * odds
    # Of linear brightness: in logarithms a blurred edge moves to its dark side.
    levels = sampled(evidence.bgr_float, places)
    apart = max(1, round(1.0 / step_px))
    step = np.zeros(seen.shape)
    step[..., apart:-apart] = strongest(np.abs(levels[:, :, 2 * apart :] - levels[:, :, : -2 * apart]))
    step[..., apart:-apart] *= seen[..., 2 * apart :] & seen[..., : -2 * apart]
    return np.where(seen, region_weight * region + np.log1p((step / EDGE_LEVELS) ** 2), -30.0), seen

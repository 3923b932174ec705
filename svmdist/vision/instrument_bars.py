"""Bars: two straight lines side by side on an outline, as a cylinder has them, and the strip between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.working_image import SQUARE_5, WorkingImage

MOST_AREA = 0.45  # what is larger is background that shares the instrument's colour
COLOUR_STEP = 0.12  # a difference of logarithms of two channels' ratio that is seen as a step of colour
BRIGHTNESS_STEP = 0.25  # the same of brightness, which shading changes more
LINE_WITHIN_PX = 1.3  # of points off a straight edge's line: rounding and the working image's blur
LEAST_SIDE_PX = 8.0  # points of an outline that must lie on a line for it to be a side
MOST_TAPER_COS = 0.92  # of the largest angle between both sides, 23°: a cylinder seen along its axis
USUAL_TAPER_RAD = 0.2  # standard deviation of that angle: a shaft's sides run more alike than those of jaws
# An instrument's least width, over the working image's: less is a thread or a vessel
LEAST_WIDTH_FRACTION = 0.02
MOST_WIDTH_FRACTION = 0.4  # an instrument's largest width, over the working image's
BESIDE_WIDTHS = 0.5  # how far an instrument goes beyond its bar's sides where its colours leave no doubt
DISTAL_WIDTHS = 4.5  # how far wrist and jaws reach beyond the end of the shaft, over its width there
DISTAL_HALF_WIDTHS = 1.3  # how far they reach to either side of its axis, over its width

CHORDS_PX = (10, 20, 40, 70)
"""Lengths of outline whose chords are tried as lines: sides of small and of large instruments."""
CHORD_STARTS = 60  # places of an outline at which chords begin
MOST_LINES = 14  # different lines of one outline that are paired
SAMPLES = 24  # places along a side at which colours are compared


def unit(along: Array) -> Array:
    """A vector at length 1; zeros stay."""
    return np.asarray(along / max(float(np.linalg.norm(along)), 1e-9))


@dataclass(frozen=True)
class Bar:
    """A strip between two straight sides of an outline.

    `sides`, shape (2, 2, 2), holds both sides' ends as (x, y), in the same direction along the axis; `support` (2,)
    counts the outline's points on each. `evidence`, from 0 to 1, says how sure it is that they are an instrument's.
    """

    sides: Array
    support: NDArray[np.int_]
    evidence: float = 0.0

    @property
    def middles(self) -> Array:
        """The middle between both sides at either end, shape (2, 2)."""
        return np.asarray(self.sides.mean(axis=0))

    @property
    def axis(self) -> Array:
        """Unit vector along it, shape (2,)."""
        return unit(self.middles[1] - self.middles[0])

    @property
    def width_px(self) -> float:
        """Mean distance of both sides."""
        normal = np.array([-self.axis[1], self.axis[0]])
        return abs(float((self.sides[0].mean(axis=0) - self.sides[1].mean(axis=0)) @ normal))

    @property
    def length_px(self) -> float:
        """Length of the shorter side."""
        return float(np.linalg.norm(self.sides[:, 1] - self.sides[:, 0], axis=1).min())

    def filled(self, like: Image) -> Image:
        """Mask of the strip, of the shape of another, (h, w)."""
        mask, (first, second) = np.zeros_like(like), self.sides
        corners = np.rint([first[0], first[1], second[1], second[0]]).astype(np.int32)
        cv2.fillConvexPoly(mask, corners, 255)
        return mask

    def inward(self, side: int) -> Array:
        """Unit normal of a side towards the other one, shape (2,)."""
        start, end = self.sides[side]
        x, y = unit(end - start)
        normal = np.array([-y, x])
        return normal if float(normal @ (self.sides[1 - side].mean(axis=0) - start)) >= 0.0 else -normal

    def places(self, side: int, inside_px: float) -> Array:
        """Points beside a side, `inside_px` towards the other one, shape (n, 2)."""
        start, end = self.sides[side]
        share = np.linspace(0.06, 0.94, SAMPLES)[:, None]
        return np.asarray(start + share * (end - start) + inside_px * self.inward(side))


def bars_in(mask: Image, image: WorkingImage, most_bars: int) -> Iterator[tuple[Bar, Image]]:
    """Bars on the outlines of a mask's parts that reach the picture's border, each with its part, shape (h, w)."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    for label in range(1, count):
        x, y, width, height, size = (int(value) for value in stats[label])
        if not image.settings.least_area * image.area_px <= size <= MOST_AREA * image.area_px:
            continue
        box = np.s_[y : y + height, x : x + width]
        own = labels[box] == label
        if np.count_nonzero(own & (image.rim[box] > 0)) < 4:
            continue
        part = np.zeros_like(mask)
        part[box] = 255 * own
        contours, _ = cv2.findContours(part, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        contour = np.asarray(max(contours, key=len).reshape(-1, 2), np.int32)
        free = image.inner[contour[:, 1], contour[:, 0]]
        for _ in range(most_bars):
            bar = _best_bar(contour, free, mask.shape[1])
            if bar is None:
                break
            yield bar, part
            used = cv2.dilate(bar.filled(mask), SQUARE_5)
            free = free & (used[contour[:, 1], contour[:, 0]] == 0)


def _best_bar(contour: NDArray[np.int32], free: NDArray[np.bool_], width_px: int) -> Bar | None:
    """The pair of opposite lines with the most points of a closed contour, shape (n, 2), on the lesser of both."""
    points = contour.astype(np.float64)
    if len(points) < 24 or np.count_nonzero(free) < 16:
        return None
    tangents = np.roll(points, -3, axis=0) - np.roll(points, 3, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True) + 1e-9
    points_free, tangents_free = points[free], tangents[free]
    starts, along = _chords(points, free)
    if len(starts) < 2:
        return None
    normals = np.stack([-along[:, 1], along[:, 0]], axis=1)
    off = points_free @ normals.T - (starts * normals).sum(axis=1)
    near = (np.abs(off) < LINE_WITHIN_PX) & (tangents_free @ along.T > 0.85)
    support = near.sum(axis=0)
    lines = _different_lines(starts, along, normals, support)
    best: tuple[float, int, int, Array] | None = None
    for place, first in enumerate(lines):
        for second in lines[place + 1 :]:
            cosine = -float(along[first] @ along[second])
            if cosine < MOST_TAPER_COS:
                continue
            taper = float(np.arccos(min(cosine, 1.0))) / USUAL_TAPER_RAD
            score = (float(support[second]) + 1e-3 * float(support[first])) * float(np.exp(-0.5 * taper**2))
            if best is not None and score <= best[0]:
                continue
            axis = along[first] - along[second]
            axis = axis / np.linalg.norm(axis)
            on_first, on_second = points_free[near[:, first]], points_free[near[:, second]]
            if _are_beside(on_first, on_second, axis, width_px):
                best = score, first, second, axis
    if best is None:
        return None
    _, first, second, axis = best
    sides = np.stack([_line_of(points_free[near[:, line]], axis) for line in (first, second)])
    return Bar(sides, support[[first, second]])


def _different_lines(starts: Array, along: Array, normals: Array, support: NDArray[np.int_]) -> list[int]:
    """Numbers of the lines with the most points, the best first, each of which is another line than those before it."""
    order = np.argsort(-support, kind="stable")
    order = order[support[order] >= LEAST_SIDE_PX]
    starts, along, normals = starts[order], along[order], normals[order]
    left = np.ones(len(order), np.bool_)
    lines: list[int] = []
    while left.any() and len(lines) < MOST_LINES:
        best = int(np.argmax(left))
        lines.append(int(order[best]))
        apart = np.abs(((starts - starts[best]) * normals[best]).sum(axis=1))
        left &= ~((along @ along[best] > 0.97) & (apart < 2.0 * LINE_WITHIN_PX))
        left[best] = False
    return lines


def _chords(points: Array, free: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Starts and unit directions, shape (m, 2) each, of chords along which the contour is straight."""
    count = len(points)
    begin = np.arange(0, count, max(1, count // CHORD_STARTS))
    starts, along = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for length in CHORDS_PX:
        if length > count // 2:
            break
        end = (begin + length) % count
        chord = points[end] - points[begin]
        long = np.linalg.norm(chord, axis=1)
        # 8-connected steps along a line are 0.71 to 1 long.
        good = (long > 0.78 * length) & free[begin] & free[end]
        starts.append(points[begin][good])
        along.append(chord[good] / long[good, None])
    return np.vstack(starts), np.vstack(along)


def _are_beside(first: Array, second: Array, axis: Array, width_px: int) -> bool:
    a, b = first @ axis, second @ axis
    common = min(a.max(), b.max()) - max(a.min(), b.min())
    if common < 0.35 * max(np.ptp(a), np.ptp(b)):
        return False
    normal = np.array([-axis[1], axis[0]])
    apart = abs(float((second @ normal).mean() - (first @ normal).mean())) / width_px
    return LEAST_WIDTH_FRACTION < apart < MOST_WIDTH_FRACTION


def _line_of(points: Array, axis: Array) -> Array:
    middle = points.mean(axis=0)
    _, _, directions = np.linalg.svd(points - middle, full_matrices=False)
    along = directions[0] * np.sign(directions[0] @ axis)
    at = (points - middle) @ along
    return np.stack([middle + at.min() * along, middle + at.max() * along])


PLACES = 32  # places along a side at which its edge is sought
STEP_PX = 0.5  # distance of the samples across a side
HALF_STEP_PX = 1.5  # colours this far to either side of an edge are compared: the working image's blur
LEAST_AGREEING = 0.5  # part of the places whose edges must lie on one line; else the side stays where it was


def sharpened(bar: Bar, image: WorkingImage) -> Bar:
    """The bar with each side on the line of the steepest change of colour near it."""
    reach_px = min(2.0 + 0.1 * bar.width_px, 0.3 * bar.width_px)
    return replace(bar, sides=np.stack([_sharpened_side(bar, side, reach_px, image) for side in (0, 1)]))


def _sharpened_side(bar: Bar, side: int, reach_px: float, image: WorkingImage) -> Array:
    start, end = bar.sides[side]
    normal = bar.inward(side)
    offsets = np.arange(-reach_px, reach_px + 0.5 * STEP_PX, STEP_PX)
    along = np.linspace(0.04, 0.96, PLACES)[:, None] * (end - start) + start
    wide = np.concatenate([offsets - HALF_STEP_PX, offsets + HALF_STEP_PX])
    places = (along[:, None] + wide[None, :, None] * normal).astype(np.float32)
    x, y = cv2.split(places)
    colours = np.asarray(cv2.remap(image.colours, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
    scale = np.array([COLOUR_STEP, COLOUR_STEP, BRIGHTNESS_STEP])
    change = np.linalg.norm((colours[:, len(offsets) :] - colours[:, : len(offsets)]) / scale, axis=2)
    # Of edges alike in height the one nearer to the outline is meant.
    best = np.argmax(change * (1.0 - 0.4 * np.abs(offsets) / max(reach_px, 1e-9)), axis=1)
    height = change[np.arange(PLACES), best]
    points = along + offsets[best, None] * normal
    seen = height > 1.0
    if np.count_nonzero(seen) < LEAST_AGREEING * PLACES:
        return np.asarray(bar.sides[side])
    line = cv2.fitLine(points[seen].astype(np.float32), cv2.DIST_WELSCH, 0, 0.01, 0.01)
    vx, vy, x0, y0 = (float(value) for value in np.ravel(line))
    direction, at = np.array([vx, vy]), np.array([x0, y0])
    off = np.abs((points[seen] - at) @ np.array([-vy, vx]))
    if np.mean(off < LINE_WITHIN_PX) < LEAST_AGREEING:
        return np.asarray(bar.sides[side])
    return np.stack([at + direction * float((end_px - at) @ direction) for end_px in (start, end)])


@dataclass(frozen=True)
class Zones:
    """Where the parts of an instrument with a bar may be, masks of shape (h, w).

    `strip` goes from the border to the bar's inner end, `middle` is the bar itself without its sides, `distal` is what
    wrist and jaws can reach, `narrow` where they are when they are straight and closed. `beside` is the strip with what
    a shaft wider than its bar takes up.
    """

    strip: NDArray[np.bool_]
    middle: NDArray[np.bool_]
    distal: NDArray[np.bool_]
    narrow: NDArray[np.bool_]
    beside: NDArray[np.bool_]

    @classmethod
    def of(cls, bar: Bar, image: WorkingImage) -> Zones:
        """The zones of a bar whose first end is towards the border."""
        height, width = image.core.shape
        x = np.arange(width, dtype=np.float32)[None, :]
        y = np.arange(height, dtype=np.float32)[:, None]
        depth = np.full((height, width), np.inf, np.float32)
        for side in (0, 1):
            normal, start = bar.inward(side).astype(np.float32), bar.sides[side, 0].astype(np.float32)
            depth = np.minimum(depth, (x - start[0]) * normal[0] + (y - start[1]) * normal[1])
        axis, inner = bar.axis.astype(np.float32), bar.middles[1].astype(np.float32)
        along = (x - inner[0]) * axis[0] + (y - inner[1]) * axis[1]
        across = np.abs((y - inner[1]) * axis[0] - (x - inner[0]) * axis[1])
        end_width = float(np.linalg.norm(bar.sides[0, 1] - bar.sides[1, 1]))
        before = along < 0.0
        strip = before & (depth > -0.08 * bar.width_px - 1.0)
        middle = before & (depth > 0.5) & (along > -float(np.linalg.norm(bar.middles[1] - bar.middles[0])))
        distal = (along >= -0.3 * end_width) & (along < DISTAL_WIDTHS * end_width)
        distal &= across < DISTAL_HALF_WIDTHS * end_width + 0.1 * np.maximum(along, 0.0)
        narrow = distal & (across < 0.6 * end_width) & (along < 0.6 * DISTAL_WIDTHS * end_width)
        beside = before & (depth > -BESIDE_WIDTHS * bar.width_px)
        return cls(strip, middle, distal, narrow, beside)

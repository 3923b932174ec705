"""The instrument's shaft in the image: a dark bar that comes in from the border of what the endoscope shows."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.profile.segmentation import AreaGate
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.colour import field_of_view
from svmdist.vision.instruments.evidence import sampled
from svmdist.vision.instruments.find_instruments import SeenInstrument

VIEW_BORDER_FRACTION = 0.006  # of the image's width, left out: optics fade at the field of view's border
GLARE_WIDTH_FRACTION = 0.03  # of the image's width; narrower bright stripes are reflections, and are closed
SPECK_WIDTH_FRACTION = 0.008  # of the image's width; narrower dark lines are vessels or gaps, and are opened
MIDDLE_STRIP = 0.125  # of the width, to either side of the middle, where the end's arc has its apex
MIN_SIDE_PX = 6.0  # the shortest side of a shaft: the least that a line can be fitted to
MAX_TAPER_RAD = 0.6  # between the sides; a cylinder that points at the camera has no contour lines

BEYOND, MORE_STRIP = np.arange(0.25, 2.5, 0.05), 0.25
"""Where more of a shaft is sought beyond its end, and to either side of the middle, over its width."""
MORE, MORE_SHARE = 10, 0.35  # of half a width along that, dark is so much of more shaft; of wrists, less
MAX_PRINTED_FRACTION = 0.1  # of a short dark segment that is bright: of a tag's print half is white
MIN_END_STD_PX = 3.0  # of the shaft's end: steel, jaws and shadow are as dark, 4 px and more off it
WORKING_PX = 320  # of a picture's width, as coarse as that in which instruments are found without colours
SIDE_STD_PX = 2.4  # of a mask's side off the shaft's edge, in its pixels: glare and shade shift it
MAX_SAMPLES = 120  # points of a contour among which its two corners are searched


@dataclass(frozen=True, slots=True)
class Side:
    """One contour line of a shaft, from `start_px` at the border to `end_px` at the tip, shape (2,) each."""

    start_px: Array
    end_px: Array

    @property
    def direction(self) -> Array:
        """Unit vector towards the tip, shape (2,)."""
        return np.asarray((self.end_px - self.start_px) / self.length_px)

    @property
    def length_px(self) -> float:
        """Distance of both ends."""
        return float(np.linalg.norm(self.end_px - self.start_px))


def find_shaft(
    shaft: Image,
    rule: AreaGate,
    covered: Image | None = None,
    black: Image | None = None,
    *,
    may_be_print: bool = False,
) -> tuple[SeenInstrument, Image] | None:
    """Find the shaft in its mask (h, w), less `covered`, and what the endoscope shows; None where none comes in.

    `black` may be border. Where it `may_be_print`, a short segment as bright as that is none. Sides do not tell base
    from tip of a shaft that runs through the whole image, and where something is mounted, its end is not visible.
    """
    width, covered = shaft.shape[1], np.zeros_like(shaft) if covered is None else covered
    dark = np.asarray(cv2.medianBlur(shaft, 3), np.uint8)
    view = field_of_view(dark if black is None else np.asarray(dark | black))
    dark = np.asarray(cv2.subtract(dark, covered), np.uint8)
    rim_px = max(2, round(VIEW_BORDER_FRACTION * width))
    speck_px = max(1, round(SPECK_WIDTH_FRACTION * width / 2))
    gap_px = round(GLARE_WIDTH_FRACTION * width / 2)
    # Masks are opened and closed in a box about what is dark, which has room for the closing and the border.
    margin_px = max(2 * gap_px, rim_px + 2) + 2
    x, y, wide, high = cv2.boundingRect(dark & view)
    left, top = corner = max(x - margin_px, 0), max(y - margin_px, 0)
    box = np.s_[top : y + high + margin_px, left : x + wide + margin_px]
    core = _eroded(view[box], rim_px)
    at_border = cv2.subtract(core, _eroded(core, 2))
    mask = cv2.morphologyEx(cv2.bitwise_and(dark[box], core), cv2.MORPH_OPEN, _disc(speck_px))
    mask = cv2.bitwise_and(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, _disc(gap_px)), core)
    contours, _ = cv2.findContours(cv2.subtract(mask, covered[box]), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    for contour in sorted(contours, key=cv2.contourArea, reverse=True):
        if cv2.contourArea(contour) < rule.min_area_px:
            return None
        points = np.asarray(contour.reshape(-1, 2), np.int32)
        found = _sides_of(points + np.array(corner, np.int32), at_border[points[:, 1], points[:, 0]] == 0)
        if found is None:
            continue
        first, second, end_px = found
        whole = np.zeros_like(shaft)
        cv2.drawContours(whole, [contour], -1, 255, cv2.FILLED, offset=corner)
        if may_be_print and _is_print(first, second, whole, shaft):
            return None
        is_rim = end_px is not None and not (
            _is_covered(first, second, end_px, covered) or _is_cut(first, second, end_px, dark)
        )
        # As one found without colours: its end is that of the dark part, and its sides are rough.
        pixel_px = max(max(shaft.shape) / WORKING_PX, 1.0)
        small = cv2.resize(whole, None, fx=1.0 / pixel_px, fy=1.0 / pixel_px, interpolation=cv2.INTER_AREA)
        sides = np.array([[side.start_px, side.end_px] for side in (first, second)])
        seen = SeenInstrument(
            small > 127,
            shaft.shape,
            sides,
            sides[:, 1].mean(0) if end_px is None else end_px,
            evidence=1.0,
            side_covariance=np.tile((SIDE_STD_PX * pixel_px) ** 2 * np.eye(2), (2, 1, 1)),
            end_std_px=MIN_END_STD_PX if is_rim else np.inf,
            ends_dark=True,
            pixel_px=pixel_px,
            knows_tip=end_px is not None,
        )
        return seen, view
    return None


def _is_print(first: Side, second: Side, mask: Image, dark: Image) -> bool:
    """Whether what is seen is shorter than twice its width, and as bright inside as a print: glare is less."""
    if min(first.length_px, second.length_px) >= 2.0 * np.linalg.norm(first.start_px - second.start_px):
        return False
    inside = _eroded(mask, 2)
    bright = 1.0 - cv2.countNonZero(cv2.bitwise_and(inside, dark)) / max(cv2.countNonZero(inside), 1)
    return bright > MAX_PRINTED_FRACTION


def _sides_of(contour: NDArray[np.int32], inside: NDArray[np.bool_]) -> tuple[Side, Side, Array | None] | None:
    """The two sides of a closed contour, shape (n, 2), and the middle of its distal end."""
    if inside.all() or not inside.any():
        return None
    # The stretches away from the border: from a start on it, so that none is cut in two.
    turn = int(np.argmin(inside))
    contour, inside = np.roll(contour, -turn, axis=0), np.roll(inside, -turn)
    pieces = np.split(contour.astype(np.float64), np.flatnonzero(np.diff(inside.astype(np.int8))) + 1)
    arcs = [piece for piece in pieces[1::2] if len(piece) >= 2 * MIN_SIDE_PX]
    arcs.sort(key=len, reverse=True)
    if not arcs:
        return None
    is_through = len(arcs) > 1 and len(arcs[1]) > 0.4 * len(arcs[0])  # one along each side, in opposite directions
    sides = (_fitted_side(arcs[0]), _fitted_side(arcs[1][::-1])) if is_through else _split(arcs[0])
    if sides is None or min(side.length_px for side in sides) < MIN_SIDE_PX:
        return None
    first, second = sides
    if not first.direction @ second.direction > np.cos(MAX_TAPER_RAD):
        return None
    if is_through:
        return first, second, None
    # The foremost point about the middle between the sides.
    along = first.direction + second.direction
    along /= np.linalg.norm(along)
    middle_px, apart_px = 0.5 * (first.end_px + second.end_px), second.end_px - first.end_px
    ahead, aside = (arcs[0] - middle_px) @ along, (arcs[0] - middle_px) @ np.array([-along[1], along[0]])
    near = np.abs(aside) < MIDDLE_STRIP * np.linalg.norm(apart_px)
    return first, second, np.asarray(middle_px + (ahead[near].max() if near.any() else 0.0) * along)


def _is_covered(first: Side, second: Side, end_px: Array, covered: Image) -> bool:
    radius_px = 0.7 * float(np.linalg.norm(first.end_px - second.end_px))
    left, top = (max(0, int(value - radius_px)) for value in end_px)
    right, bottom = (max(0, int(value + radius_px) + 2) for value in end_px)
    y, x = np.nonzero(covered[top:bottom, left:right])
    return not np.all(np.hypot(x + left - end_px[0], y + top - end_px[1]) > radius_px)


def _is_cut(first: Side, second: Side, end_px: Array, dark: Image) -> bool:
    """Whether more of a shaft is beyond its end: blood, or a band, cuts it in two."""
    along, apart_px = first.direction + second.direction, second.end_px - first.end_px
    along /= np.linalg.norm(along)
    ahead, aside = BEYOND * np.linalg.norm(apart_px), np.linspace(-MORE_STRIP, MORE_STRIP, 9)
    places = end_px + ahead[:, None, None] * along + aside[:, None] * apart_px
    is_dark = (sampled(dark, places, nearest=True) > 0).mean(1)
    return bool(np.convolve(is_dark, np.full(MORE, 1.0 / MORE), "valid").max() > MORE_SHARE)


def _split(arc: Array) -> tuple[Side, Side] | None:
    """Cut an arc, shape (n, 2), at the two corners that leave three pieces closest to straight lines."""
    points = arc[np.round(np.linspace(0, len(arc) - 1, min(len(arc), MAX_SAMPLES))).astype(int)]
    count = len(points)
    step_px = len(arc) / count
    shortest = max(3, int(np.ceil(MIN_SIDE_PX / step_px)))
    if count < 3 * shortest:
        return None
    first = np.arange(shortest, count - 2 * shortest + 1)
    second = np.arange(2 * shortest, count - shortest + 1)
    x, y = (points - points.mean(0)).T
    moments = np.stack([np.ones(count), x, y, x * x, y * y, x * y])
    sums = np.hstack([np.zeros((6, 1)), np.cumsum(moments, axis=1)])
    total = _line_cost(sums[:, None, second] - sums[:, first, None])
    total += _line_cost(sums[:, first])[:, None] + _line_cost(sums[:, -1:] - sums[:, second])
    total = np.where(second[None, :] - first[:, None] >= shortest, total, np.inf)
    a, b = np.unravel_index(int(np.argmin(total)), total.shape)
    return _fitted_side(points[: first[a]]), _fitted_side(points[second[b] :][::-1])


def _line_cost(moments: Array) -> Array:
    """Sum of squared distances, shape (...) in px², from their best line of points with moments of shape (6, ...)."""
    n, x, y, xx, yy, xy = moments
    share = 1.0 / np.maximum(n, 1.0)
    cxx, cyy, cxy = xx - x * x * share, yy - y * y * share, xy - x * y * share
    apart = cxx - cyy
    smallest = 0.5 * (cxx + cyy - np.sqrt(apart * apart + 4.0 * cxy * cxy))
    return np.asarray(np.maximum(smallest, 0.0))


def _fitted_side(points: Array) -> Side:
    """The line through points in their order, shape (n, 2), robust to bumps, as long as they are."""
    fitted = cv2.fitLine(points.astype(np.float32), cv2.DIST_HUBER, 0, 0.01, 0.01)
    vx, vy, x, y = (float(value) for value in np.ravel(fitted))
    along, at = np.array([vx, vy]), np.array([x, y])
    start, end = (at + along * float((points[index] - at) @ along) for index in (0, -1))
    return Side(start, end)


def _disc(radius_px: int) -> NDArray[np.uint8]:
    size = 2 * max(radius_px, 1) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), np.uint8)


def _eroded(mask: Image, radius_px: int) -> Image:
    return np.asarray(cv2.erode(mask, _disc(radius_px), borderValue=0), np.uint8)

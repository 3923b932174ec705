"""A shaft by its silhouette: its two edges in the image's gradients, where they end, and the wrist beyond them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.least_squares import median, scale_of
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.edge_lines import ROUGH_PX, EdgeLine, edge_line, edge_within, most_blur_px
from svmdist.vision.instruments.find_instruments import WRIST_NARROWER, SeenInstrument

MIN_LENGTH_WIDTHS = 1.25  # of both sides, on average: where it comes in at a slant one is shorter
MOST_OFF_STDS = 1.6  # of a sharp edge from the rough side: what is farther is rather another edge
SOFT_STD_WIDTHS = 0.05  # of a side without one, over the width: beside what people draw in photographs
MAX_TAPER_RAD = 0.6  # between the sides; a cylinder that points at the camera shows no length
ENDS_AGREE_WIDTHS = 0.3  # both edges' ends along the shaft: clevises are lopsided
MIN_END_STD_WIDTHS = 0.08  # of the cylinder's end, over the width: ears and bevels hide it
WRIST_REACH = 2.0  # of wrist and jaws over their straight length: a band before the shaft's end looks like it
MOST_REACH = 1.1  # of wrist and jaws that begin at the end: they may come towards the camera
WRIST_STD = 0.12  # of the tool's origin, over the outline's length beyond the end: jaws open and turn
TIP_STD = 0.05  # of where the jaws end, over the same
WRIST_SCATTER = 0.2  # of a wrist's pixels across it, over the shaft's width: more are of another instrument
MIN_WRIST_WIDTHS = 0.5  # an outline that ends closer behind the cylinder's end shows no wrist
MIN_WRIST_SHARE = 0.5  # of a straight wrist: less is another tip, or points at the camera by over 60°
FLANK_STDS = 4.0  # from the colours on both sides: one pixel of paper in a thousand is so far
# The least scatter of lightness: light falls off over a wrist's length; of Lab's a and b: compression leaves as much
FLANK_LEVELS = 8.0, 3.0, 3.0
MAX_FLANK_OUTLIERS = 0.05  # with more of a flank so far off, fat or vessels lie beside the wrist

WIDTH_CELLS = 24  # of the patch that is looked at, across the shaft: its cost is the same for every image
BEHIND, BESIDE = 0.75, 2.0  # how far it reaches behind the end and beside the axis, over the shaft's width
FLANK = 0.75  # what is farther from the axis, over the width, is background beside a wrist for the most part
MIN_CELLS = 12
FROM_ONE_END = 1.0 / np.sqrt(3.0)  # from what may be anywhere in a range to its one end, RMS, over its length
FAR_PERCENTILE = 99.0  # of the outline's distances from the shaft's end: its tip, without a speck on it


@dataclass(frozen=True, slots=True)
class WristShape:
    """A straight wrist beyond the shaft's end: the tool's origin as a fraction of it, its length over the width."""

    tool_fraction: float
    length_widths: float


@dataclass(frozen=True, slots=True)
class WristPoint:
    """The tool's origin in the wrist's outline, (2,) in px, with its deviation, and the jaws' tips, (2,) in px.

    Where the shaft's end is off along the shaft, so is the origin, by `end_share` of that: the deviation leaves it out.
    By `excess_px` the outline is longer than wrist and jaws, by the share `missing` shorter than a straight wrist's.
    """

    pixel: Array
    std_px: float
    tip_px: Array
    tip_std_px: float
    end_share: float
    excess_px: float = 0.0
    missing: float = 0.0


def _wrist_point(
    bgr: Image, instrument: SeenInstrument, end_px: Array, along: Array, width_px: float, shape: WristShape
) -> WristPoint | None:
    """Where the tool's origin is beyond a shaft's end, in an image, shape (h, w, 3); None where no wrist is seen.

    `instrument` is what is roughly known of it; `along` (2,) is the shaft's direction to the tip.
    The origin is the shape's part of the way from the end to the outline's tip, as the crow flies, in the middle of
    the outline. Of an outline shorter than a straight wrist it may be farther on; one much shorter is not informative.
    """
    cell_px, mask = width_px / WIDTH_CELLS, instrument.mask
    farthest = WRIST_REACH * shape.length_widths
    u = np.arange(-BEHIND, farthest, 1.0 / WIDTH_CELLS) * width_px
    v = np.arange(-BESIDE, BESIDE + 0.5 / WIDTH_CELLS, 1.0 / WIDTH_CELLS) * width_px
    across = np.array([-along[1], along[0]])
    x, y = (end_px[axis] + u[:, None] * along[axis] + v * across[axis] for axis in (0, 1))
    last_x, last_y = mask.shape[1] - 1, mask.shape[0] - 1
    seen = (x >= 0) & (y >= 0) & (x <= last_x) & (y <= last_y)
    x, y = x.astype(np.float32), y.astype(np.float32)
    left, top = int(np.clip(x.min() - cell_px, 0, last_x)), int(np.clip(y.min() - cell_px, 0, last_y))
    window = bgr[top : max(int(y.max() + cell_px) + 2, top + 1), left : max(int(x.max() + cell_px) + 2, left + 1)]
    if cell_px >= 1.5:
        window = np.asarray(cv2.blur(window, (int(cell_px + 0.5),) * 2), np.uint8)
    patch = cv2.remap(window, x - left, y - top, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    known = cv2.remap(mask, x, y, cv2.INTER_NEAREST) > 0
    ahead, off_axis = u[:, None] / width_px, np.abs(v)[None, :] / width_px
    shaft = (ahead < 0.0) & (off_axis < 0.5)
    different = _unlike_flanks(np.asarray(patch, np.uint8), seen & ~known & (off_axis > FLANK), v)
    near = np.hypot(ahead, off_axis) < farthest
    body = np.asarray(((different | known) & seen & near & (ahead >= 0.0)) | shaft, np.uint8)
    opened = cv2.morphologyEx(body, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    closed = cv2.morphologyEx(opened, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    _, labels = cv2.connectedComponents(closed, connectivity=8)
    own = np.bincount(labels[shaft & (closed > 0)], minlength=1)
    beyond = (labels == own.argmax()) & (ahead > 0.0)  # what is connected with the shaft
    if not own.any() or np.count_nonzero(beyond) < MIN_CELLS:
        return None
    offset = np.stack(np.nonzero(beyond), -1) * cell_px + [u[0], v[0]]
    distance = np.linalg.norm(offset, axis=1)
    reach_px, expected_px = float(np.percentile(distance, FAR_PERCENTILE)), shape.length_widths * width_px
    if reach_px < max(MIN_WRIST_WIDTHS * width_px, MIN_WRIST_SHARE * expected_px):
        return None  # another tip than the profile's, or one that is mostly missed
    ring = np.abs(distance - shape.tool_fraction * reach_px) < 0.5 * WRIST_STD * reach_px
    if np.count_nonzero(ring) < 3:
        return None
    at = offset[ring].mean(0)
    apart_px = shared_px = 0.0
    if instrument.touches_another:  # the origin is in either of them, and the farthest point the other one's
        apart_px = float(np.sqrt(max(offset[ring].var(0).sum() - (WRIST_SCATTER * width_px) ** 2, 0.0)))
        shared_px = FROM_ONE_END * (reach_px - MIN_WRIST_SHARE * expected_px)
    # The middle of an arc lies inside of it.
    at *= shape.tool_fraction * reach_px / max(float(np.linalg.norm(at)), 1e-9)
    # An outline shorter than a straight wrist comes towards the camera, or lacks its jaws: then the origin is beyond.
    short_px = FROM_ONE_END * max(0.0, expected_px - reach_px)
    tip = offset[distance > reach_px - cell_px].mean(0)
    pixel, tip_px = (end_px + place[0] * along + place[1] * across for place in (at, tip))
    unsure_px = float(np.hypot(short_px, apart_px / shape.tool_fraction))
    std_px = float(np.hypot(WRIST_STD * reach_px, shape.tool_fraction * unsure_px))
    tip_std_px = float(np.linalg.norm([TIP_STD * reach_px, unsure_px, shared_px]))
    excess_px, missing = max(0.0, reach_px - MOST_REACH * expected_px), max(0.0, 1.0 - reach_px / expected_px)
    return WristPoint(pixel, std_px, tip_px, tip_std_px, 1.0 - shape.tool_fraction, excess_px, missing)


def _unlike_flanks(patch: Image, flanks: NDArray[np.bool_], v: Array) -> NDArray[np.bool_]:
    """What of a patch, shape (m, n, 3), looks like neither flank; nothing without a flank of one colour."""
    channels = [np.asarray(channel, np.float64) for channel in cv2.split(cv2.cvtColor(patch, cv2.COLOR_BGR2LAB))]
    unlike: list[NDArray[np.bool_]] = []
    for side in (flanks & (v < 0.0), flanks & (v > 0.0)):
        if np.count_nonzero(side) < 4 * MIN_CELLS:
            continue
        square = np.zeros(side.shape)
        for channel, floor in zip(channels, FLANK_LEVELS, strict=True):
            off = channel - median(channel[side])
            square += (off / max(scale_of(off[side]), floor)) ** 2
        away = square > FLANK_STDS**2
        if np.mean(away[side]) > MAX_FLANK_OUTLIERS:
            return np.zeros_like(flanks)  # several things are there, and a wrist would be one more
        unlike.append(away)
    return np.asarray(np.all(unlike, axis=0)) if unlike else np.zeros_like(flanks)


IN_BLUR = 0.3
"""Of an edge's blur, which light has before a camera bends its scale: a step from 1 to 15, to the power of 1 / 2.2, is
steepest half a deviation on its dark side, a linear one in the middle. This is the RMS of what is between."""
GOES_ON_WIDTHS, ENDS_WIDTHS = 1.0, 0.5  # beyond a dark part's end: one side alone goes on, the other one ends
STRIP = 0.15  # inside of that side, over the way to the other one, where the instrument would be
SHADOW_STD_WIDTHS = 0.12  # of a shadow's border off the side that casts it, over the width
BEYOND_WIDTHS = (0.15, 0.65)  # beyond an outline's end, over its width, where a narrower wrist is visible
ENDS_APART = 0.3  # of an end over the distance of both: deviation of a uniform distribution between them


@dataclass(frozen=True, slots=True)
class Rim:
    """The shaft's end on its middle line: pixel (2,), direction to the tip (2,); by the outline or the dark part.

    `std_px` is its deviation along the shaft. With a probability of `other_share` it is the end of the other one of
    these, as many radii further along; `narrows` is how likely an outline goes on narrower there.
    """

    pixel: Array
    towards_tip: Array
    std_px: float
    is_outline: bool = False
    other_radii: float = 0.0
    other_share: float = 0.0
    narrows: float = 1.0


@dataclass(frozen=True, slots=True)
class Silhouette:
    """Both edges of a shaft as the camera sees them, border first, and where they end.

    `rim` is None where the shaft goes on to the border of the picture, `wrist` where no wrist is seen beyond.
    `wrist_std` is the width's deviation over it by what may be no shaft: the wrist is narrower.
    """

    edges: tuple[EdgeLine, EdgeLine]
    rim: Rim | None = None
    wrist: WristPoint | None = None
    knows_tip: bool = True
    wrist_std: float = 0.0

    @property
    def towards_tip(self) -> Array:
        """Unit vector along the middle line, shape (2,)."""
        along = self.edges[0].direction + self.edges[1].direction
        return np.asarray(along / np.linalg.norm(along))

    @property
    def middle_px(self) -> Array:
        """A point between both edges, shape (2,)."""
        return np.asarray(np.mean([(edge.start_px, edge.end_px) for edge in self.edges], axis=(0, 1)))

    @property
    def width_px(self) -> float:
        """Between both edges, at the end."""
        along, apart_px = self.towards_tip, self.edges[1].end_px - self.edges[0].end_px
        return abs(float(along[0] * apart_px[1] - along[1] * apart_px[0]))

    @property
    def width_std(self) -> float:
        """Deviation of the width over it by what both edges get wrong alike: the outline is anywhere in their blur."""
        return float(IN_BLUR * sum(edge.blur_px for edge in self.edges) / self.width_px)


def find_silhouette(
    bgr: Image, seen: SeenInstrument, picture: Image | None, wrist: WristShape | None, least_levels: float
) -> Silhouette | None:
    """Measure an instrument that was roughly found in an image, shape (h, w, 3); None without a shaft's straight edges.

    Nor of what is hardly longer than wide: at the border that is as likely the wrist, which may be narrower. Edges are
    steps of at least so many levels; where the image has none so sharp, a side is what the evidence has. With `wrist`,
    what is seen of it beyond the end is measured, too; without, the instrument is a dark bar.
    """
    first, second = _edges(bgr, seen, picture, least_levels)
    if not seen.shows_shaft or first.direction @ second.direction < np.cos(MAX_TAPER_RAD):
        return None
    endless = Silhouette((first, second), knows_tip=seen.knows_tip)
    along, width_px = endless.towards_tip, endless.width_px
    is_long = 0.5 * (first.length_px + second.length_px) >= MIN_LENGTH_WIDTHS * width_px > 0.0
    # A dark bar's sides, which no evidence supports, are known by their edges alone.
    are_known = wrist is not None or (len(first.points_px) > 0 and len(second.points_px) > 0)
    if not (is_long and are_known):
        return None
    ends = [] if seen.ends_dark else [edge.end_px for edge in (first, second) if edge.ends]
    if len(ends) < 2 and not np.isfinite(seen.end_std_px):
        return endless
    if seen.ends_dark:
        end_px, narrows = seen.end_px, 0.0
        first, second = _with_inflated_side((first, second), seen, end_px, along, width_px)
        std_px = float(np.hypot(seen.end_std_px, MIN_END_STD_WIDTHS * width_px))
    else:
        place, least_std_px = float(seen.end_px @ along), MIN_END_STD_WIDTHS * width_px
        std_px = max(seen.end_std_px, least_std_px + ENDS_APART * width_px)
        if ends:
            places = [float(end @ along) for end in ends]
            # One edge may fade before the other, on dark tissue; beyond the cylinder neither stays on its line.
            apart_px = max(places) - min(places)
            sharp = float(np.mean(places)) if apart_px <= ENDS_AGREE_WIDTHS * width_px else max(places)
            sharp_std_px = least_std_px + ENDS_APART * (apart_px if len(places) == 2 else width_px)
            # Sharp edges stop where steel begins, or go on along the wrist, and so does evidence: it is between.
            off_px, share = place - sharp, sharp_std_px**2 / (sharp_std_px**2 + seen.end_std_px**2)
            place = sharp + share * off_px
            std_px = float(np.hypot(sharp_std_px * np.sqrt(1.0 - share), 0.5 * FROM_ONE_END * off_px))
        middle_px = 0.5 * (first.end_px + second.end_px)
        end_px = middle_px + (place - float(middle_px @ along)) * along
        narrows = _inside(seen, end_px + np.linspace(*BEYOND_WIDTHS, 9)[:, None] * width_px * along)
    point = None if wrist is None else _wrist_point(bgr, seen, end_px, along, width_px, wrist)
    if point is not None:  # where the outline is longer than a wrist, its end is before the shaft's, or is it
        std_px = float(np.hypot(std_px, FROM_ONE_END * point.excess_px))
    # Beyond a wrist that was taken for a shaft there are jaws at most.
    wrist_std = seen.wrist_std * (1.0 if point is None else min(1.0, 2.0 * point.missing))
    # Of a short segment most of either side may be the wrist's, in line with it.
    run_px = [max(float((one.end_px - one.start_px) @ along), 1e-9) for one in (first, second)]
    on_shaft = np.array([(end_px - one.start_px) @ along for one in (first, second)]) / run_px
    beyond = float(np.clip(1.5 - 2.0 * on_shaft, 0.0, 1.0).mean())
    wrist_std = max(wrist_std, WRIST_NARROWER * beyond)
    rim = Rim(end_px, along, std_px, not seen.ends_dark, 2.0 * seen.other_px / width_px, seen.other_share, narrows)
    return Silhouette((first, second), rim, point, wrist_std=wrist_std)


def _with_inflated_side(
    edges: tuple[EdgeLine, EdgeLine], seen: SeenInstrument, end_px: Array, along: Array, width_px: float
) -> tuple[EdgeLine, EdgeLine]:
    """Both edges; of one that goes on alone beyond the dark part, along no instrument, little is known: shadows do."""
    beyond = [float((edge.end_px - end_px) @ along) / width_px for edge in edges]
    at = int(np.argmax(beyond))
    if not (beyond[at] > GOES_ON_WIDTHS and beyond[1 - at] < ENDS_WIDTHS):
        return edges
    edge, inward = edges[at], edges[1 - at].end_px - edges[at].end_px
    inward = inward - (inward @ along) * along
    strip = edge.end_px - np.linspace(0.0, beyond[at], 9)[:, None] * width_px * along + STRIP * inward
    if _inside(seen, strip) > 0.5:
        return edges
    edge = _of_shadow(edge, width_px)
    return (edge, edges[1]) if at == 0 else (edges[0], edge)


def _of_shadow(border: EdgeLine, width_px: float) -> EdgeLine:
    """A shadow's border in place of the shaft's own edge, which is somewhere within."""
    return replace(border, covariance=(SHADOW_STD_WIDTHS * width_px) ** 2 * np.eye(2))


def _inside(seen: SeenInstrument, places_px: Array) -> float:
    """Which share of places, (n, 2), is the instrument's."""
    places = np.rint((places_px + 0.5) / seen.pixel_px - 0.5).astype(int)
    height, width = seen.small_mask.shape
    inside = ((places >= 0) & (places < [width, height])).all(1)
    x, y = np.clip(places, 0, [width - 1, height - 1]).T
    return float(np.mean(seen.small_mask[y, x] & inside))


def _edges(bgr: Image, seen: SeenInstrument, picture: Image | None, least_levels: float) -> list[EdgeLine]:
    """Both sides: sharp where the image has an edge near that of the evidence, and without the shaft's shadow."""
    edges: list[EdgeLine] = []
    for side, rough in enumerate(seen.sides):
        one = edge_line(bgr, rough, seen.width_px, seen.pixel_px, picture, least_levels)
        if one is None or not _agrees(one, seen, side):  # the side as the evidence has it
            (start_px, end_px), variance_px2 = rough, (SOFT_STD_WIDTHS * seen.width_px) ** 2
            covariance = seen.side_covariance[side] + variance_px2 * np.eye(2)
            one = EdgeLine(start_px, end_px, np.zeros((0, 2)), False, 0.0, covariance, seen.pixel_px)
        edges.append(one)
    found: list[EdgeLine] = []
    for outer, other in (edges, edges[::-1]):
        one = edge_within(bgr, outer, other, picture, least_levels)
        if one is None and outer.covariance is None and outer.blur_px > most_blur_px(other):
            one = _of_shadow(outer, seen.width_px)  # whose shaft's edge is not found
        found.append(one or outer)
    return found


def _agrees(edge: EdgeLine, seen: SeenInstrument, side: int) -> bool:
    """Whether a sharp edge is that which the evidence has: another one is a highlight's, or of something beside it."""
    ends_px = seen.sides[side]
    along = ends_px[1] - ends_px[0]
    along = along / max(float(np.linalg.norm(along)), 1e-9)
    across = np.array([-along[1], along[0]])
    ahead_px = (ends_px - edge.start_px) @ along / (edge.direction @ along)
    off_px = (edge.start_px + ahead_px[:, None] * edge.direction - ends_px) @ across
    std_px = np.sqrt(np.diag(seen.side_covariance[side]) + (ROUGH_PX * seen.pixel_px) ** 2)
    return bool((np.abs(off_px) < MOST_OFF_STDS * std_px).all())

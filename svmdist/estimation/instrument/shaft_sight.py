"""What one image shows of a dark shaft with a coloured knuckle behind its end: planes, rim and knuckle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.instrument.cylinder import TangentPlane, tangent_plane
from svmdist.profile import AreaGate
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.disc import Disc, fit_disc
from svmdist.vision.edges import (
    CORRELATION_PX,
    edge_blur_px,
    edge_points,
    fit_line,
    straightened,
)
from svmdist.vision.regions import Region, find_region
from svmdist.vision.segmentation.exposure import brightest_channel
from svmdist.vision.shading import shading_shift_px
from svmdist.vision.shaft_segmentation import ShaftRegion, Side

REACH_FRACTION = 0.007
"""How far sub-pixel edges are searched from the mask's contour, over the image's width."""
MIN_REACH_PX = 4.0
MIN_CONTRAST = 18.0
"""Levels of 255 between shaft and background: less is shade."""
TRIM_FRACTION = 0.06
"""Of a side at its ends, where the rim's and the border's corners round it."""
RIM_STRIP = 0.25
"""The rim is searched in this part of the shaft's half width about the middle, where its arc has its apex."""
RIM_REACH = 0.9
"""How far along the shaft, in half widths: an arc's apex lies up to one before the corners."""
VISIBLE_RADIUS, RADIUS_STD = 0.97, 0.022
"""Jaws and fork hide some percent of the knuckle, and its limb is in shade: its apparent radius over that of the
whole, and how that varies. Over 72 frames of six seeds 0.96 ± 0.02, sharp, blurred, hazy or dim."""
DISC_POINTS = 8
"""Points of the disc's border that err independently: it is cut by fork and jaws, each over an eighth."""
RADIUS_PER_BLUR = 0.1
"""What neighbours of other colours within the border's blur shift it, over that blur."""
MAX_LOG_RATIO = 0.25
"""Between the disc's radius and that of its region: further apart they are not of the same thing."""
MIN_SATURATION = 50
"""Grey steel in coloured light stays below."""
KNUCKLE_STD = 0.045
"""By how much that moves its centroid, over the radius."""
SYSTEMATIC_PX = 0.08
"""What shading beside an edge shifts it, beside noise: see the error budget."""
SYSTEMATIC_PER_BLUR, INLIER_PER_BLUR = 0.05, 0.2
"""Both grow with the edge's blur: shading over twice the width shifts the steepest point by more."""
BLUR_REACH_FRACTION = 0.022
"""How far the blur of an edge is measured, over the image's width: a tool at 200 mm/s moves so far in 1/60 s."""


@dataclass(frozen=True, slots=True)
class Contour:
    """One side of the silhouette: the plane that touches the shaft there, and where it is.

    `side` is +1 to the right of the axis as it runs to the tip, y being down, and -1 to the left.
    """

    plane: TangentPlane
    side: int


@dataclass(frozen=True, slots=True)
class Rim:
    """Where the dark shaft ends on its middle line: a pixel (2,), the unit direction to the tip (2,), px."""

    pixel: Array
    towards_tip: Array
    std_px: float


@dataclass(frozen=True, slots=True)
class Knuckle:
    """The coloured sphere about the tool's origin: middle (2,) and radius with standard deviations, in px.

    `radius_px` is None where the border or something else cuts it.
    """

    centre_px: Array
    std_px: float
    radius_px: float | None
    radius_std_px: float


@dataclass(frozen=True, slots=True)
class ShaftSight:
    """Contours (none, one or two), the rim and the knuckle, each as far as it is to be seen.

    `towards_tip` (2,) is the direction of the shaft's middle line in the image, None where nothing tells.
    `is_stub` says that less of the shaft is to be seen than it is wide.
    """

    contours: tuple[Contour, ...]
    rim: Rim | None
    knuckle: Knuckle | None
    towards_tip: Array | None
    middle_px: Array | None
    is_stub: bool


def see_shaft(
    image_bgr: Image, region: ShaftRegion | None, knuckle: Knuckle | None, camera: Camera
) -> ShaftSight:
    """Measure contours and rim of a shaft that was found."""
    if region is None:
        return ShaftSight((), None, knuckle, None, None, True)
    brightness = brightest_channel(image_bgr)
    towards_tip = region.first.direction + region.second.direction
    towards_tip /= np.linalg.norm(towards_tip)
    contours: list[Contour] = []
    for side in (region.first, region.second):
        contour = _contour(brightness, side, region, towards_tip, camera)
        if contour is not None and all(contour.side != other.side for other in contours):
            contours.append(contour)
    rim = _rim(brightness, region, towards_tip) if region.end_is_free else None
    known = towards_tip if region.end_px is not None else None
    return ShaftSight(tuple(contours), rim, knuckle, known, region.middle_px, region.is_stub)


def see_knuckle(mask: Image, rule: AreaGate, image_hsv: Image) -> Knuckle | None:
    """The region of a mask, shape (h, w), as a disc, its size from where the colour has half its strength.

    A grey region is bare steel, of a tip without a coloured knuckle: it is no disc about the tool's origin and gives
    none. `image_hsv` has shape (h, w, 3).
    """
    region = find_region(mask, rule)
    if region is None or float(np.median(image_hsv[..., 1][mask > 0])) < MIN_SATURATION:
        return None
    disc = knuckle_disc(image_hsv, mask, region)
    if disc is not None:
        whole_px = disc.radius_px / VISIBLE_RADIUS
        own_px = np.hypot(disc.scatter_px / np.sqrt(DISC_POINTS), RADIUS_PER_BLUR * disc.blur_px)
        std_px = float(np.hypot(RADIUS_STD * whole_px, own_px))
        return Knuckle(region.centroid_px, KNUCKLE_STD * whole_px, whole_px, std_px)
    return Knuckle(region.centroid_px, 0.5 * float(np.sqrt(region.area_px / np.pi)), None, 0.0)


def knuckle_disc(image_hsv: Image, mask: Image, region: Region) -> Disc | None:
    """The disc of a region of a mask, shape (h, w); None at the border, or where its colour makes another border."""
    corners = region.hull.reshape(-1, 2)
    height, width = mask.shape
    if not bool(((corners > 1) & (corners < [width - 2, height - 2])).all()):
        return None
    radius_px = float(np.sqrt(region.area_px / np.pi))
    disc = fit_disc(image_hsv, mask, region.centroid_px, radius_px)
    return disc if disc is not None and abs(np.log(disc.radius_px / radius_px)) < MAX_LOG_RATIO else None


def _contour(
    brightness: Image, side: Side, region: ShaftRegion, towards_tip: Array, camera: Camera
) -> Contour | None:
    along = side.end_px - side.start_px
    start_px, end_px = side.start_px + TRIM_FRACTION * along, side.end_px - TRIM_FRACTION * along
    outward = 0.5 * (side.start_px + side.end_px) - region.middle_px
    width_px = brightness.shape[1]
    blur_px = edge_blur_px(
        brightness, start_px, end_px, outward, BLUR_REACH_FRACTION * width_px, MIN_CONTRAST
    )
    # A threshold may cut a blurred edge two of its deviations off its middle.
    reach_px = max(MIN_REACH_PX, REACH_FRACTION * width_px) + 2.0 * blur_px
    points_px = edge_points(brightness, start_px, end_px, outward, reach_px, MIN_CONTRAST, blur_px)
    points_px = _inside_view(points_px, region.field_of_view)
    if len(points_px) == 0:
        return None
    across = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    across = across if across @ outward > 0.0 else -across
    points_px = points_px - shading_shift_px(brightness, points_px, across, blur_px) * across
    unit = 1.0 / float(camera.K[0, 0])
    line = fit_line(
        straightened(camera, points_px),
        unit,
        min_count=5,
        inlier_px=0.5 + INLIER_PER_BLUR * blur_px,
        systematic_px=float(np.hypot(SYSTEMATIC_PX, SYSTEMATIC_PER_BLUR * blur_px)),
        correlation_px=max(CORRELATION_PX, 2.0 * blur_px),
    )
    if line is None:
        return None
    plane = tangent_plane(line, straightened(camera, region.middle_px[None])[0])
    right = towards_tip[0] * outward[1] - towards_tip[1] * outward[0]
    return Contour(plane, 1 if right > 0 else -1)


def _rim(brightness: Image, region: ShaftRegion, towards_tip: Array) -> Rim | None:
    if region.end_px is None:
        return None
    half_width_px = 0.5 * float(np.linalg.norm(region.first.end_px - region.second.end_px))
    across = np.array([-towards_tip[1], towards_tip[0]]) * RIM_STRIP * half_width_px
    points_px = edge_points(
        brightness,
        region.end_px - across,
        region.end_px + across,
        towards_tip,
        RIM_REACH * half_width_px,
        MIN_CONTRAST,
    )
    if len(points_px) < 4:
        return None
    ahead_px = (points_px - region.end_px) @ towards_tip
    middle_px = float(np.median(ahead_px))
    spread_px = 1.4826 * float(np.median(np.abs(ahead_px - middle_px)))
    return Rim(region.end_px + middle_px * towards_tip, towards_tip, max(0.3, spread_px))


def _inside_view(points_px: Array, view: Image) -> Array:
    """The points, shape (n, 2), around which the endoscope shows something."""
    column, row = np.round(points_px).astype(np.intp).T
    return np.asarray(points_px[view[row, column] > 0])

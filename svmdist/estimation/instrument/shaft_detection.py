"""The shaft and the distal marker in one image: tangent planes along both edges, the end, the marker's size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.least_squares import median, scale_of
from svmdist.profile.settings import DistalMarkerSettings, ShaftSettings
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision import shadows
from svmdist.vision.edges import Disc, edge_blur_px, edge_points, fit_disc, shading_shift_px
from svmdist.vision.lines import (
    POINT_CORRELATION_PX,
    Line,
    TangentPlane,
    axis_of_cylinder,
    fit_line,
    line_between,
    tangent_plane,
    without_perspective,
)
from svmdist.vision.regions import Region
from svmdist.vision.shaft_segmentation import ShaftRegion, Side
from svmdist.vision.silhouette import FROM_ONE_END, Silhouette, WristPoint

EDGE_REACH_FRACTION = 0.007  # how far edges are searched from the mask's contour, over the image's width
MIN_EDGE_REACH_PX = 4.0  # the least of that reach: a threshold cuts an edge of usual blur within this
SIDE_TRIM_FRACTION = 0.06  # of a side at each end: corners of the shaft's end and the picture's border
BLUR_REACH_FRACTION = 0.022  # of the image's width: a tool at 200 mm/s moves so far in 1/60 s
LINE_INLIER_PX = 0.5  # of an edge's point off its line: ten times the least deviation of a point
LINE_INLIER_PER_BLUR = 0.2  # shading over twice the width shifts the steepest point by more
LINE_INLIER_PER_WIDTH = 0.012  # for a silhouette's edges: near ones are less sharp, and lenses bend them
SHADING_STD_PX = 0.08  # what shading beside an edge shifts it, in addition to noise: see the error budget
SHADING_STD_PER_BLUR = 0.05  # how that grows with the edge's blur, for the same reason
OUTLINE_SHADING_STD_PX = 0.15  # where nothing is known of the light: a limb fades or shines
END_STRIP_FRACTION = 0.25  # of the half width about the middle, where the end's arc has its apex
END_REACH_HALF_WIDTHS = 0.9  # along the shaft: an arc's apex lies up to one half width before the corners
MIN_END_STD_PX = 3.0  # of the shaft's end: steel, jaws and shadow are as dark, 4 px and more off it
MAX_LOG_RATIO = 0.25  # between radii by circle and area: further apart they are different things
BORDER_POINTS = 8.0  # of the border that err independently: it is cut by fork and jaws, each over an eighth
BORDER_STD_PER_BLUR = 0.1  # what neighbours of other colours shift it, over the border's blur
WHOLE_REACH = 1.1  # of a whole marker's farthest points over its area's radius: fork and jaws cut a fifth
CENTROID_STD = 0.045  # by how much hidden parts move the region's centroid, over the radius


@dataclass(frozen=True, slots=True)
class DistalMarker:
    """The marker: the middle of its circle, or of its region, (2,), and its radius, with standard deviations, in px.

    `radius_px` is that of the whole sphere, None where the image's border or something else cuts it; `disc` is the
    circle along its border that the radius comes from, `area_px` the area of what is visible.
    """

    centre_px: Array
    std_px: float
    radius_px: float | None
    radius_std_px: float
    disc: Disc | None = None
    area_px: float = 0.0


def detect_distal_marker(
    image_hsv: Image, mask: Image, region: Region | None, settings: DistalMarkerSettings
) -> DistalMarker | None:
    """The region of the mask (h, w) as a disc, sized where the colour has half its strength; None of bare steel."""
    if region is None or _median_saturation(image_hsv, mask) < settings.min_saturation:
        return None
    disc = _marker_disc(image_hsv, mask, region)
    if disc is None:
        std_px = 0.5 * float(np.sqrt(region.area_px / np.pi))
        return DistalMarker(region.centroid_px, std_px, None, 0.0, None, region.area_px)
    whole_px = disc.radius_px / settings.visible_radius
    own_px = np.hypot(disc.scatter_px / np.sqrt(BORDER_POINTS), BORDER_STD_PER_BLUR * disc.blur_px)
    # A part of a disc is longer than wide, and the whole is as wide as that is long, or less.
    reach_px = cv2.minEnclosingCircle(region.hull.astype(np.float32))[1] + 0.5
    hidden = max(0.0, reach_px / float(np.sqrt(region.area_px / np.pi)) - WHOLE_REACH)
    radius_std_px = float(
        np.linalg.norm([settings.radius_std * whole_px, own_px, FROM_ONE_END * hidden * whole_px])
    )
    std_px = CENTROID_STD * whole_px
    return DistalMarker(disc.centre_px, std_px, whole_px, radius_std_px, disc, region.area_px)


def _marker_disc(image_hsv: Image, mask: Image, region: Region) -> Disc | None:
    """The circle along a region's border; None at the image's border, or where the colour's border is another."""
    corners = region.hull.reshape(-1, 2)
    height, width = mask.shape
    if not bool(((corners > 1) & (corners < [width - 2, height - 2])).all()):
        return None
    radius_px = float(np.sqrt(region.area_px / np.pi))
    disc = fit_disc(image_hsv, mask, region.centroid_px, radius_px)
    if disc is None or abs(np.log(disc.radius_px / radius_px)) >= MAX_LOG_RATIO:
        return None
    return disc


def marker_centre(
    marker: DistalMarker, camera: Camera, depth_m: float, radius_m: float
) -> tuple[Array, float]:
    """The pixel (2,) of a sphere's middle, and its border's blur in px; without a circle the centroid, blur 0."""
    disc = marker.disc
    if disc is None:
        return marker.centre_px, 0.0
    return without_perspective(disc.centre_px, camera, depth_m, radius_m), disc.blur_px


def _median_saturation(image_hsv: Image, mask: Image) -> float:
    x, y, width, height = cv2.boundingRect(mask)
    window = np.s_[y : y + height, x : x + width]
    counts = cv2.calcHist([image_hsv[window]], [1], mask[window], [256], [0, 256]).ravel()
    total = np.cumsum(counts)
    middle = [np.searchsorted(total, 0.5 * total[-1], side) for side in ("left", "right")]
    return float(np.mean(middle))


MIN_END_POINTS = 4
NEAREST_M, FARTHEST_M = 0.02, 0.5  # of a shaft's end: nearer it fills the view, farther it has no light
MOST_STEEP = 0.975  # of the axis along the view, 13° off it: nothing tells that so short a shaft is one
STEEP_LENGTH_WIDTHS = 2.5  # of such a shaft, from which on its taper does


@dataclass(frozen=True, slots=True)
class Contour:
    """One side of the silhouette: the plane that touches the shaft there; `side` is +1 to the right of the axis."""

    plane: TangentPlane
    side: int


@dataclass(frozen=True, slots=True)
class Rim:
    """The shaft's end on its middle line: pixel (2,), direction to the tip (2,); by the outline or the dark part.

    With a probability of `other_share` it is the end of the other one of these, as many radii further along; `narrows`
    is how likely an outline goes on narrower there.
    """

    pixel: Array
    towards_tip: Array
    std_px: float
    is_outline: bool = False
    other_radii: float = 0.0
    other_share: float = 0.0
    narrows: float = 1.0


@dataclass(frozen=True, slots=True)
class ShaftDetection:
    """Contours (none, one or two) and the rim, each as far as it is visible.

    `towards_tip` (2,) is the direction of the shaft's middle line in the image, None where nothing tells it.
    `is_stub` says that less of the shaft is visible than tells its sides from other things: twice its width of a dark
    part; no outline is one. `wrist` is where the tool's origin is in the outline of a whole instrument.
    `width_std` is the deviation over the width of what both contours get wrong alike.
    """

    contours: tuple[Contour, ...]
    rim: Rim | None
    towards_tip: Array | None
    middle_px: Array | None
    is_stub: bool
    wrist: WristPoint | None = None
    width_std: float = 0.0


NO_SHAFT = ShaftDetection((), None, None, None, True)


def detect_shaft(
    brightness: Image, bgr: Image, region: ShaftRegion | None, camera: Camera, settings: ShaftSettings
) -> ShaftDetection:
    """Measure contours and rim of a shaft that was found; `NO_SHAFT` for none.

    `brightness`, shape (h, w), shows edges; colours of `bgr`, shape (h, w, 3), tell the shaft from its shadow.
    """
    if region is None:
        return NO_SHAFT
    towards_tip = region.first.direction + region.second.direction
    towards_tip /= np.linalg.norm(towards_tip)
    sides = (region.first, region.second)
    reach_px = BLUR_REACH_FRACTION * brightness.shape[1]
    blurs_px = [edge_blur_px(brightness, _trimmed(side, region), reach_px, settings) for side in sides]
    contours = []
    for side, blur_px, other_px in zip(sides, blurs_px, blurs_px[::-1], strict=True):
        # Both edges of a shaft are as sharp as each other; a shadow beside it ends in a penumbra.
        is_penumbra = blur_px > shadows.PENUMBRA_RATIO * max(other_px, shadows.PENUMBRA_BLUR_PX)
        own_px = min(blur_px, other_px) if is_penumbra else blur_px
        line = _side_line((brightness, bgr), side, region, own_px, is_penumbra, camera, settings)
        if line is not None:
            outward = _trimmed(side, region)[2]
            contours.append(_contour_of(line, region.middle_px, outward, towards_tip, camera))
    rim = _rim(brightness, region, towards_tip, settings) if region.end_is_free else None
    known = towards_tip if region.end_px is not None else None
    return ShaftDetection(_one_per_side(contours), rim, known, region.middle_px, region.is_stub)


def detect_silhouette(silhouette: Silhouette | None, camera: Camera, radius_m: float) -> ShaftDetection:
    """Contours, end and wrist of a shaft whose silhouette was found, whatever its colour; `NO_SHAFT` for none.

    None is it either that would stand elsewhere than a shaft of its radius can.
    """
    if silhouette is None:
        return NO_SHAFT
    towards_tip, middle_px = silhouette.towards_tip, silhouette.middle_px
    found = []
    for edge in silhouette.edges:
        outward = 0.5 * (edge.start_px + edge.end_px) - middle_px
        inlier_px = max(LINE_INLIER_PX, LINE_INLIER_PER_WIDTH * silhouette.width_px, edge.within_px)
        if edge.covariance is None:
            line = _line_through(edge.points_px, camera, inlier_px, OUTLINE_SHADING_STD_PX)
        else:
            ends = camera.rays(np.stack([edge.start_px, edge.end_px]))[:, :2]
            line = line_between(ends, edge.covariance / float(camera.K[0, 0]) ** 2)
        if line is not None:
            found.append(_contour_of(line, middle_px, outward, towards_tip, camera))
    contours = _one_per_side(found)
    if len(contours) == 2 and not _can_stand(contours, silhouette, camera, radius_m):
        return NO_SHAFT
    end_px, rim = silhouette.end_px, None
    if end_px is not None:
        other = 2.0 * silhouette.other_px / silhouette.width_px, silhouette.other_share
        rim = Rim(end_px, towards_tip, silhouette.std_px, silhouette.is_outline, *other, silhouette.narrows)
    wrist, width_std = silhouette.wrist, silhouette.width_std
    return ShaftDetection(contours, rim, towards_tip, middle_px, False, wrist, width_std)


def _one_per_side(contours: Sequence[Contour]) -> tuple[Contour, ...]:
    first: dict[int, Contour] = {}
    for contour in contours:
        first.setdefault(contour.side, contour)
    return tuple(first.values())


def _can_stand(contours: Sequence[Contour], silhouette: Silhouette, camera: Camera, radius_m: float) -> bool:
    """Whether a shaft of a radius between two planes is before the camera, and no stub that points along the view."""
    axis = axis_of_cylinder(contours[0].plane, contours[1].plane, radius_m)
    if axis is None:
        return False
    place_px = silhouette.middle_px if silhouette.end_px is None else silhouette.end_px
    depth_m = axis.depth_m(camera.rays(place_px)[0])
    # Its wrist was taken for the taper of a shaft that comes from behind the camera.
    is_steep = abs(float(axis.direction[2])) > MOST_STEEP and silhouette.length_widths < STEEP_LENGTH_WIDTHS
    return NEAREST_M < depth_m < FARTHEST_M and not is_steep


def _line_through(
    points_px: Array,
    camera: Camera,
    inlier_px: float,
    systematic_px: float,
    correlation_px: float = POINT_CORRELATION_PX,
) -> Line | None:
    """The line on z = 1 through most of an edge's points, shape (n, 2) in px."""
    unit = 1.0 / float(camera.K[0, 0])
    points = camera.rays(points_px)[:, :2]
    return fit_line(points, unit, shadows.MIN_LINE_POINTS, inlier_px, systematic_px, correlation_px)


def _contour_of(line: Line, middle_px: Array, outward: Array, towards_tip: Array, camera: Camera) -> Contour:
    """The contour on a line of z = 1; `middle_px` is on the shaft, `outward` leads off it, (2,)."""
    plane = tangent_plane(line, camera.rays(middle_px)[0, :2])
    right = towards_tip[0] * outward[1] - towards_tip[1] * outward[0]
    return Contour(plane, 1 if right > 0 else -1)


def _trimmed(side: Side, region: ShaftRegion) -> tuple[Array, Array, Array]:
    """A side's start and end without its corners, and a vector from the shaft's middle to it, shape (2,) each."""
    trim = SIDE_TRIM_FRACTION * (side.end_px - side.start_px)
    outward = 0.5 * (side.start_px + side.end_px) - region.middle_px
    return side.start_px + trim, side.end_px - trim, outward


def _side_line(
    views: tuple[Image, Image],
    side: Side,
    region: ShaftRegion,
    blur_px: float,
    is_penumbra: bool,
    camera: Camera,
    settings: ShaftSettings,
) -> Line | None:
    """The line on z = 1 along a side; None where only a shadow's border is to be seen."""
    brightness, bgr = views
    along = side.end_px - side.start_px
    rough = _trimmed(side, region)
    width_px = brightness.shape[1]
    # A threshold may cut a blurred edge two of its deviations off its middle.
    reach_px = max(MIN_EDGE_REACH_PX, EDGE_REACH_FRACTION * width_px) + 2.0 * blur_px
    points_px = shadows.in_view(edge_points(brightness, rough, reach_px, settings, blur_px), region)
    if len(points_px) == 0:
        return None
    across = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    across = across if across @ rough[2] > 0.0 else -across
    inlier_px = LINE_INLIER_PX + LINE_INLIER_PER_BLUR * blur_px
    std_px = float(np.hypot(SHADING_STD_PX, SHADING_STD_PER_BLUR * blur_px))
    in_shadow = partial(shadows.edge_before_shadow, brightness, rough, across, region, settings, blur_px)
    shadowed = in_shadow()
    is_shaft = shadows.is_of_shaft(bgr, points_px, across, region, blur_px, shadowed)
    if is_shaft is None:  # what colours cannot tell: a shadow ends in a penumbra
        is_shaft = not is_penumbra
    if is_shaft:
        points_px = points_px - shading_shift_px(brightness, points_px, across, blur_px) * across
    else:
        if shadowed is None:  # a shadow that is brighter than the shaft
            shadowed = in_shadow(is_brighter=True)
        if shadowed is None:
            return None
        points_px, inlier_px, std_px = shadowed, shadows.SHADOW_INLIER_PX, shadows.SHADOW_STD_PX
    return _line_through(points_px, camera, inlier_px, std_px, max(POINT_CORRELATION_PX, 2.0 * blur_px))


def _rim(brightness: Image, region: ShaftRegion, towards_tip: Array, settings: ShaftSettings) -> Rim | None:
    if region.end_px is None:
        return None
    half_width_px = 0.5 * float(np.linalg.norm(region.first.end_px - region.second.end_px))
    across = np.array([-towards_tip[1], towards_tip[0]]) * (END_STRIP_FRACTION * half_width_px)
    reach_px = END_REACH_HALF_WIDTHS * half_width_px
    rough = (region.end_px - across, region.end_px + across, towards_tip)
    points_px = edge_points(brightness, rough, reach_px, settings)
    if len(points_px) < MIN_END_POINTS:
        return None
    ahead_px = (points_px - region.end_px) @ towards_tip
    middle_px = median(ahead_px)
    std_px = max(MIN_END_STD_PX, scale_of(ahead_px - middle_px))
    return Rim(region.end_px + middle_px * towards_tip, towards_tip, std_px)

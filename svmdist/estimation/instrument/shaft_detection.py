"""The shaft and the distal marker in one image: tangent planes along both edges, the end, the marker's size."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.profile.settings import DistalMarkerSettings
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.lines import TangentPlane, axis_of_cylinder, fit_line, line_between
from svmdist.vision.regions import Disc, Region, fit_disc
from svmdist.vision.silhouette import Rim, Silhouette, WristPoint

LINE_INLIER_PX = 0.5  # of an edge's point off its line: ten times the least deviation of a point
LINE_INLIER_PER_WIDTH = 0.012  # for a silhouette's edges: near ones are less sharp, and lenses bend them
MIN_LINE_POINTS = 5  # of an edge: fewer lie on a line by chance
SHADING_STD_PX = 0.15  # where nothing is known of the light: a limb fades or shines
MAX_LOG_RATIO = 0.25  # between radii by circle and area: further apart they are different things
BORDER_POINTS = 8.0  # of the border that err independently: it is cut by fork and jaws, each over an eighth
STD_PER_DOUBT = 1.5  # of the radius: of 808 simulated ones 2% are off by more than two deviations
WHOLE_ASPECT = 0.9  # of a whole marker's width over its length: fork and jaws cut a tenth
CENTROID_STD = 0.045  # by how much hidden parts move the region's centroid, over the radius
NEAREST_M, FARTHEST_M = 0.02, 0.5  # of a shaft's end: nearer it fills the view, farther it has no light


@dataclass(frozen=True, slots=True)
class DistalMarker:
    """The marker: the middle of its circle, or of its region, (2,), and its radius, with standard deviations, in px."""

    centre_px: Array
    std_px: float
    radius_px: float | None  # of the whole sphere; None where the image's border or something else cuts it
    radius_std_px: float
    disc: Disc | None = None  # the circle along its border that the radius comes from
    area_px: float = 0.0  # of what is visible
    hidden_px: float = 0.0  # by how much of the radius' deviation something hides it


def detect_distal_marker(
    image_hsv: Image, mask: Image, region: Region, settings: DistalMarkerSettings
) -> DistalMarker | None:
    """The region of the mask (h, w) as a disc, sized where the colour has half its strength; None of bare steel."""
    x, y, width, height = cv2.boundingRect(mask)
    window = np.s_[y : y + height, x : x + width]
    if np.median(image_hsv[window][..., 1][mask[window] > 0]) < settings.min_saturation:
        return None
    # At the image's border there is no circle to fit, nor where the colour's border is another one.
    corners, radius_px = region.hull.reshape(-1, 2), float(np.sqrt(region.area_px / np.pi))
    is_whole = bool(((corners > 1) & (corners < [mask.shape[1] - 2, mask.shape[0] - 2])).all())
    disc = fit_disc(image_hsv, mask, region.centroid_px, radius_px) if is_whole else None
    if disc is None or abs(np.log(disc.radius_px / radius_px)) >= MAX_LOG_RATIO:
        return DistalMarker(region.centroid_px, 0.5 * radius_px, None, 0.0, None, region.area_px)
    # Of a disc whose part is hidden the circle is too small, as an ellipse's area is to the circle about it.
    moments = cv2.moments(region.hull.astype(np.float32))
    spread = [[moments["mu20"], moments["mu11"]], [moments["mu11"], moments["mu02"]]]
    narrow, long = np.sqrt(np.maximum(np.linalg.eigvalsh(spread), 1.0))
    hidden = max(0.0, float(np.sqrt(WHOLE_ASPECT * long / narrow)) - 1.0)
    whole_px = (1.0 + hidden) * disc.radius_px / settings.visible_radius
    own_px = np.hypot(disc.scatter_px / np.sqrt(BORDER_POINTS), STD_PER_DOUBT * disc.doubt_px)
    hidden_px = hidden * disc.radius_px
    radius_std_px = float(np.linalg.norm([settings.radius_std * whole_px, own_px, hidden_px]))
    std_px = CENTROID_STD * whole_px
    return DistalMarker(disc.centre_px, std_px, whole_px, radius_std_px, disc, region.area_px, hidden_px)


@dataclass(frozen=True, slots=True)
class ShaftDetection:
    """Contours (none, one or two), the planes that touch the shaft there, and the rim, each as far as it is visible."""

    contours: tuple[TangentPlane, ...] = ()
    rim: Rim | None = None
    towards_tip: Array | None = None  # direction of the shaft's middle line in the image, (2,); None if unknown
    middle_px: Array | None = None
    wrist: WristPoint | None = None  # where the tool's origin is in the outline of a whole instrument
    width_std: float = 0.0  # deviation over the width of what both contours get wrong alike
    wrist_std: float = 0.0  # the same of what may be no shaft, where nothing else shows its depth


NO_SHAFT = ShaftDetection()


def detect_silhouette(
    silhouette: Silhouette, camera: Camera, radius_m: float, beside: tuple[float, float] = (0.0, 0.0)
) -> ShaftDetection:
    """Contours, end and wrist of a shaft by its silhouette; `NO_SHAFT` where one of its radius cannot stand.

    Its sides may be those of something wider on it, by `beside` of its width: of a sharp side, of one without an edge.
    """
    towards_tip, middle_px = silhouette.towards_tip, silhouette.middle_px
    unit, inside = 1.0 / float(camera.K[0, 0]), camera.rays(middle_px)[0, :2]
    found: dict[int, TangentPlane] = {}
    for edge in silhouette.edges:
        inlier_px = max(LINE_INLIER_PX, LINE_INLIER_PER_WIDTH * silhouette.width_px, edge.within_px)
        ends = camera.rays(np.stack([edge.start_px, edge.end_px]))[:, :2]
        if edge.covariance is None:
            points = camera.rays(edge.points_px)[:, :2]
            plane = fit_line(points, unit, inside, MIN_LINE_POINTS, inlier_px, SHADING_STD_PX)
        else:
            plane = line_between(ends, edge.covariance * unit**2, inside)
        if plane is not None:
            off = 0.5 * beside[edge.covariance is not None] * silhouette.width_px * unit
            wider = line_between(ends, np.full((2, 2), off**2), inside)
            outward = 0.5 * (edge.start_px + edge.end_px) - middle_px
            side = 1 if towards_tip[0] * outward[1] - towards_tip[1] * outward[0] > 0 else -1
            found.setdefault(side, replace(plane, covariance=plane.covariance + wider.covariance, side=side))
    contours = tuple(found.values())
    if len(contours) == 2:
        axis = axis_of_cylinder(contours, radius_m)
        place_px = middle_px if silhouette.rim is None else silhouette.rim.pixel
        if axis is None or not NEAREST_M < axis.depth_m(camera.rays(place_px)[0]) < FARTHEST_M:
            return NO_SHAFT
    known = towards_tip if silhouette.knows_tip else None
    stds = silhouette.width_std, silhouette.wrist_std
    return ShaftDetection(contours, silhouette.rim, known, middle_px, silhouette.wrist, *stds)

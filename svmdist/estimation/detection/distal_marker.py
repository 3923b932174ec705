"""The coloured distal marker about the tool's origin: its place and its size in one image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.profile.settings import DistalMarkerSettings
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.disc import Disc, fit_disc
from svmdist.vision.regions import Region
from svmdist.vision.sphere import without_perspective

DEFAULT = DistalMarkerSettings()


@dataclass(frozen=True, slots=True)
class DistalMarker:
    """The marker: the middle of its region, (2,), and its radius, with standard deviations, in px.

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
    image_hsv: Image, mask: Image, region: Region | None, settings: DistalMarkerSettings = DEFAULT
) -> DistalMarker | None:
    """The region of the instrument's mask, shape (h, w), as a disc, sized where the colour has half its strength.

    A grey region is bare steel, of a tip without a coloured marker: it is no disc about the tool's origin and gives
    None. `image_hsv` has shape (h, w, 3), at normalised exposure.
    """
    if region is None or _median_saturation(image_hsv, mask) < settings.min_saturation:
        return None
    disc = marker_disc(image_hsv, mask, region, settings)
    if disc is None:
        std_px = 0.5 * float(np.sqrt(region.area_px / np.pi))
        return DistalMarker(region.centroid_px, std_px, None, 0.0, None, region.area_px)
    whole_px = disc.radius_px / settings.visible_radius
    own_px = np.hypot(
        disc.scatter_px / np.sqrt(settings.border_points), settings.border_std_per_blur * disc.blur_px
    )
    radius_std_px = float(np.hypot(settings.radius_std * whole_px, own_px))
    std_px = settings.centroid_std * whole_px
    return DistalMarker(region.centroid_px, std_px, whole_px, radius_std_px, disc, region.area_px)


def marker_disc(
    image_hsv: Image, mask: Image, region: Region, settings: DistalMarkerSettings = DEFAULT
) -> Disc | None:
    """The circle along the border of a region of a mask, shape (h, w).

    None at the image's border, or where the colour makes another border than the mask.
    """
    corners = region.hull.reshape(-1, 2)
    height, width = mask.shape
    if not bool(((corners > 1) & (corners < [width - 2, height - 2])).all()):
        return None
    radius_px = float(np.sqrt(region.area_px / np.pi))
    disc = fit_disc(image_hsv, mask, region.centroid_px, radius_px, settings)
    if disc is None or abs(np.log(disc.radius_px / radius_px)) >= settings.max_log_ratio:
        return None
    return disc


def marker_centre(
    region: Region, disc: Disc | None, camera: Camera, depth_m: float, radius_m: float
) -> tuple[Array, float]:
    """The pixel (2,) of the middle of a sphere of `radius_m` at `depth_m`, and the blur of its border in px.

    Blur moves a threshold's border to the side of what the colour mixes with, the place of half its strength hardly.
    Without a circle, or for a tip that is no sphere (`radius_m` 0), it is the region's centroid, of blur 0.
    """
    if disc is None or radius_m <= 0.0:
        return region.centroid_px, 0.0
    return without_perspective(disc.centre_px, camera, depth_m, radius_m), disc.blur_px


def _median_saturation(image_hsv: Image, mask: Image) -> float:
    """Median over a mask, shape (h, w), from a histogram of the levels."""
    x, y, width, height = cv2.boundingRect(mask)
    window = np.s_[y : y + height, x : x + width]
    counts = cv2.calcHist([image_hsv[window]], [1], mask[window], [256], [0, 256]).ravel()
    total = np.cumsum(counts)
    middle = [np.searchsorted(total, 0.5 * total[-1], side) for side in ("left", "right")]
    return float(np.mean(middle))

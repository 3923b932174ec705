"""Detection of the pasted marker: ORB, homography, outline and third contour (paper, secs. III.B and III.C)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from svmdist.profile import Features as FeatureRules
from svmdist.profile import Marker
from svmdist.profile.settings import MarkerSettings
from svmdist.samples import Image, Status
from svmdist.transforms import Array
from svmdist.vision.frame_context import to_grey, to_hsv
from svmdist.vision.marker.features import EDGE_MARGIN_PX, Features, detect_orb, match_features
from svmdist.vision.marker.homography import fit_homography, is_plausible, square_corners, transfer
from svmdist.vision.marker.pattern import MarkedWindow, padded_template, paste_marker
from svmdist.vision.regions import Region, find_region
from svmdist.vision.segmentation.colour import colour_mask

DEFAULT = MarkerSettings()

SUBPIXEL_BITS = 4
"""OpenCV draws at 1/16 px with this shift."""


@dataclass(frozen=True, slots=True)
class MarkerDetection:
    """The result of the search for the marker: a status, counts and places, None where it did not get that far.

    `keypoint_count` counts ORB's keypoints in the window about the marker. `corners_px` has shape (4, 2) and
    `centroid_px` shape (2,), both in px of the image.
    """

    status: Status
    keypoint_count: int
    match_count: int | None = None
    inlier_count: int | None = None
    corners_px: Array | None = None
    centroid_px: Array | None = None


def template_features(marker: Marker, rules: FeatureRules) -> Features:
    """ORB features of the marker itself, in px of the marker."""
    template = padded_template(marker.size_px, EDGE_MARGIN_PX)
    features = detect_orb(template, rules.feature_count)
    return replace(features, points_px=features.points_px - EDGE_MARGIN_PX)


def mark(image_bgr: Image, centre_px: Array, marker: Marker) -> MarkedWindow:
    """Paste the marker on an image, shape (h, w, 3), about `centre_px`, shape (2,).

    ORB finds no keypoint within its edge margin of a border, at no level of its pyramid. The marker with this margin
    is thus all of the image where keypoints of the template can be found again.
    """
    return paste_marker(image_bgr, centre_px, marker.size_px, EDGE_MARGIN_PX)


def detect_marker(
    marked: MarkedWindow,
    template: Features,
    marker: Marker,
    rules: FeatureRules,
    settings: MarkerSettings = DEFAULT,
) -> MarkerDetection:
    """Find the marker in its window, draw its outline, and take the outline's centroid by colour."""
    grey = to_grey(marked.window_bgr)
    features = detect_orb(grey, rules.feature_count)
    if len(features) == 0:
        return MarkerDetection(Status.NO_FEATURES, 0)
    matches = match_features(template, features, rules.ratio)
    if len(matches) < rules.min_match_count:
        return MarkerDetection(Status.TOO_FEW_MATCHES, len(features), len(matches))
    homography = fit_homography(matches, rules.reprojection_px, settings)
    if homography is None or not is_plausible(homography.H, marker.size_px, settings):
        return MarkerDetection(Status.NO_HOMOGRAPHY, len(features), len(matches))
    corners_px = transfer(homography.H, square_corners(marker.size_px))
    region = third_contour(marked.window_bgr, corners_px, marker)
    origin_px = np.array(marked.origin_px, np.float64)
    return MarkerDetection(
        Status.NO_OUTLINE if region is None else Status.OK,
        len(features),
        len(matches),
        int(np.count_nonzero(homography.inliers)),
        corners_px + origin_px,
        None if region is None else region.centroid_px + origin_px,
    )


def third_contour(window_bgr: Image, corners_px: Array, marker: Marker) -> Region | None:
    """Draw the outline on a copy of the window and find it again by its colour, behind a gate of 100 px (eqs. 19, 20).

    Only the outline's bounding box is looked at; an outline that leaves the window is cut at its border.
    """
    height, width = window_bgr.shape[:2]
    reach_px = marker.outline_width_px + 1
    low = np.clip(np.floor(corners_px.min(0)) - reach_px, 0, [width - 1, height - 1])
    high = np.clip(np.ceil(corners_px.max(0)) + reach_px + 1, 1, [width, height])
    (x0, y0), (x1, y1) = low.astype(int), high.astype(int)
    box_bgr = window_bgr[y0:y1, x0:x1].copy()
    draw_outline(box_bgr, corners_px - low, marker)
    region = find_region(colour_mask(to_hsv(box_bgr), marker.outline), marker.outline)
    if region is None:
        return None
    return replace(region, centroid_px=region.centroid_px + low, hull=region.hull + low.astype(np.int32))


def draw_outline(image_bgr: Image, corners_px: Array, marker: Marker) -> None:
    """Draw the polyline of the outline into an image, in place, at sub-pixel corners of shape (4, 2)."""
    fixed = np.round(corners_px * (1 << SUBPIXEL_BITS)).astype(np.int32)
    cv2.polylines(
        image_bgr, [fixed], True, marker.outline_bgr, marker.outline_width_px, cv2.LINE_8, SUBPIXEL_BITS
    )

"""The marker found again: ORB, homography, outline and third contour (paper, secs. III.B and III.C)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from svmdist.profile import Features as FeatureRules
from svmdist.profile import Marker
from svmdist.samples import Image, Status
from svmdist.transforms import Array
from svmdist.vision.marker.features import EDGE_MARGIN_PX, Features, detect_orb, match_features
from svmdist.vision.marker.homography import fit_homography, is_plausible, square_corners, transfer
from svmdist.vision.marker.pattern import MarkedImage, padded_template
from svmdist.vision.regions import Region, find_region
from svmdist.vision.segmentation.colour import colour_mask, to_hsv

SUBPIXEL_BITS = 4
"""OpenCV draws at 1/16 px with this shift."""


@dataclass(frozen=True, slots=True)
class FoundMarker:
    """What the search for the marker gave: a status, counts and places, None where it did not get that far.

    `corners_px` has shape (4, 2) and `centroid_px` shape (2,), both in px of the image.
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


def find_marker(marked: MarkedImage, template: Features, marker: Marker, rules: FeatureRules) -> FoundMarker:
    """Find the marker on a canvas, draw its outline, and take the outline's centroid by colour."""
    frame = detect_orb(
        np.asarray(cv2.cvtColor(marked.canvas_bgr, cv2.COLOR_BGR2GRAY), np.uint8), rules.feature_count
    )
    if len(frame) == 0:
        return FoundMarker(Status.NO_FEATURES, 0)
    matches = match_features(template, frame, rules.ratio)
    if len(matches) < rules.min_match_count:
        return FoundMarker(Status.TOO_FEW_MATCHES, len(frame), len(matches))
    homography = fit_homography(matches, rules.reprojection_px)
    if homography is None or not is_plausible(homography.H, marker.size_px):
        return FoundMarker(Status.NO_HOMOGRAPHY, len(frame), len(matches))
    inlier_count = int(np.count_nonzero(homography.inliers))
    corners_px = transfer(homography.H, square_corners(marker.size_px))
    region = third_contour(marked.canvas_bgr, corners_px, marker)
    origin_px = np.array(marked.origin_px, np.float64)
    if region is None:
        return FoundMarker(Status.NO_OUTLINE, len(frame), len(matches), inlier_count, corners_px - origin_px)
    return FoundMarker(
        Status.OK,
        len(frame),
        len(matches),
        inlier_count,
        corners_px - origin_px,
        region.centroid_px - origin_px,
    )


def third_contour(canvas_bgr: Image, corners_px: Array, marker: Marker) -> Region | None:
    """Draw the outline on the canvas and find it again by its colour, behind a gate of 100 px (eqs. 19, 20).

    Only the outline's surroundings are searched: HSV of the whole canvas would cost more than ORB.
    """
    low = np.floor(corners_px.min(0)).astype(int) - marker.outline_width_px - 1
    high = np.ceil(corners_px.max(0)).astype(int) + marker.outline_width_px + 2
    height, width = canvas_bgr.shape[:2]
    x0, y0 = np.clip(low, 0, [width - 1, height - 1])
    x1, y1 = np.clip(high, 1, [width, height])
    window = canvas_bgr[y0:y1, x0:x1].copy()
    draw_outline(window, corners_px - np.array([x0, y0]), marker)
    region = find_region(colour_mask(to_hsv(window), marker.outline), marker.outline)
    if region is None:
        return None
    return Region(
        region.area_px,
        region.polygon_area_px2,
        region.centroid_px + np.array([x0, y0]),
        region.hull + np.array([x0, y0], np.int32),
        region.hull_area_px2,
    )


def draw_outline(image_bgr: Image, corners_px: Array, marker: Marker) -> None:
    """Draw the polyline of the outline into an image, in place, at sub-pixel corners of shape (4, 2)."""
    fixed = np.round(corners_px * (1 << SUBPIXEL_BITS)).astype(np.int32)
    cv2.polylines(
        image_bgr, [fixed], True, marker.outline_bgr, marker.outline_width_px, cv2.LINE_8, SUBPIXEL_BITS
    )

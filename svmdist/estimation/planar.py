"""The paper's estimator: segment, overlay the virtual marker, find it by ORB, map to the plane, measure."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.estimation.frame import Frame
from svmdist.estimation.plane_mapping import PlaneMapping, planar_distance
from svmdist.profile import Features as FeatureRules
from svmdist.profile import Marker
from svmdist.profile.settings import OutlineSettings
from svmdist.results import Distance, Distances, FrameResult, as_pixel
from svmdist.samples import Image, Status
from svmdist.transforms import Array
from svmdist.vision.colour import colour_mask, to_grey, to_hsv
from svmdist.vision.marker import (
    EDGE_MARGIN_PX,
    Features,
    Matches,
    detect_orb,
    fit_homography,
    marker_corners,
    match_features,
    padded_template,
    paste_marker,
)
from svmdist.vision.regions import Region, find_region

SUBPIXEL_BITS = 4  # OpenCV draws at 1/16 px with this shift


def locate(frame: Frame) -> tuple[FrameResult, Region | None, Region | None]:
    """Tissue and instrument by their colours as recorded, and the result so far; rejected if one is missing."""
    tissue, instrument = frame.left.regions_as_recorded
    result = FrameResult(frame.stamp_ns, Status.OK if instrument else Status.NO_INSTRUMENT)
    if instrument is not None:
        result = result.with_image(tool_px=as_pixel(instrument.centroid_px), tool_area_px=instrument.area_px)
    if tissue is None:
        return result.rejected(Status.NO_TISSUE), None, instrument
    result = result.with_image(tissue_px=as_pixel(tissue.centroid_px), tissue_area_px=tissue.area_px)
    return result, tissue, instrument


def in_plane(result: FrameResult, tool_px: Array, tissue_px: Array, mapping: PlaneMapping) -> FrameResult:
    """Both places to the plane, and the distance between them; one that is not finite rejects the frame."""
    distance_m = float(planar_distance(mapping.to_plane_m(tool_px) - mapping.to_plane_m(tissue_px)))
    if not math.isfinite(distance_m):
        return result.rejected(Status.NOT_FINITE)
    return replace(result.with_image(tool_px=as_pixel(tool_px)), distances=Distances(planar=Distance(distance_m)))


@lru_cache(8)
def _template(marker: Marker, rules: FeatureRules) -> Features:
    """ORB features of the marker itself, in px of the marker."""
    features = detect_orb(padded_template(marker.size_px, EDGE_MARGIN_PX), rules.feature_count)
    return replace(features, points_px=features.points_px - EDGE_MARGIN_PX)


@dataclass(frozen=True, slots=True)
class MarkerSearch:
    """What the search for the pasted marker saw, in px of the window that has the marker in it."""

    window_bgr: Image
    origin_px: tuple[int, int]  # the window's top left pixel (x, y) in the image, and maybe outside of it
    features: Features
    matches: Matches
    inliers: NDArray[np.bool_]  # the matches that agree with the homography, shape (n,)
    corners_px: Array | None = None  # the marker's outline by it, shape (4, 2); None where there is no plausible one


def search_marker(frame: Frame, centre_px: Array) -> MarkerSearch:
    """Paste the marker about `centre_px`, (2,), and find it again: features, matches, homography."""
    profile = frame.arm.profile
    size_px, rules = profile.marker.size_px, profile.features
    window_bgr, origin_px = paste_marker(frame.left.context.bgr_as_recorded, centre_px, size_px, EDGE_MARGIN_PX)
    features = detect_orb(to_grey(window_bgr), rules.feature_count)
    matches = match_features(_template(profile.marker, rules), features, rules.ratio)
    found = MarkerSearch(window_bgr, origin_px, features, matches, np.zeros(len(matches), np.bool_))
    if len(matches) < rules.min_match_count or (homography := fit_homography(matches, rules.reprojection_px)) is None:
        return found
    H, inliers = homography
    corners_px = marker_corners(H, size_px, profile.settings.marker)
    return found if corners_px is None else replace(found, inliers=inliers, corners_px=corners_px)


def third_contour(window_bgr: Image, corners_px: Array, marker: Marker, settings: OutlineSettings) -> Region | None:
    """Draw the outline on a copy of the window and find it again by its colour, gated at 100 px (eqs. 19, 20)."""
    height, width = window_bgr.shape[:2]
    reach_px = marker.outline_width_px + 1
    low = np.clip(np.floor(corners_px.min(0)) - reach_px, 0, [width - 1, height - 1])
    high = np.clip(np.ceil(corners_px.max(0)) + reach_px + 1, 1, [width, height])
    (x0, y0), (x1, y1) = low.astype(int), high.astype(int)
    box_bgr = window_bgr[y0:y1, x0:x1].copy()
    fixed = np.round((corners_px - low) * (1 << SUBPIXEL_BITS)).astype(np.int32)
    cv2.polylines(box_bgr, [fixed], True, marker.outline_bgr, marker.outline_width_px, cv2.LINE_8, SUBPIXEL_BITS)
    region = find_region(colour_mask(to_hsv(box_bgr), marker.outline), marker.outline, settings)
    if region is None:
        return None
    return replace(region, centroid_px=region.centroid_px + low, hull=region.hull + low.astype(np.int32))


def by_overlay(frame: Frame, mapping: PlaneMapping) -> FrameResult:
    """`--method overlay`: the paper's three phases."""
    # First phase: tissue, instrument, marker on the instrument.
    profile = frame.arm.profile
    result, tissue, instrument = locate(frame)
    if tissue is None or instrument is None:
        return result

    # Second phase: features, matches, homography, outline.
    found = search_marker(frame, instrument.centroid_px)
    result = result.with_image(keypoint_count=len(found.features))
    if len(found.features) == 0:
        return result.rejected(Status.NO_FEATURES)
    result = result.with_image(match_count=len(found.matches))
    if len(found.matches) < profile.features.min_match_count:
        return result.rejected(Status.TOO_FEW_MATCHES)
    if found.corners_px is None:
        return result.rejected(Status.NO_HOMOGRAPHY)
    result = result.with_image(inlier_count=int(np.count_nonzero(found.inliers)))

    # Final phase: third contour, both places to the plane, and the distance between them.
    outline = third_contour(found.window_bgr, found.corners_px, profile.marker, profile.settings.outline)
    if outline is None:
        return result.rejected(Status.NO_OUTLINE)
    return in_plane(result, outline.centroid_px + found.origin_px, tissue.centroid_px, mapping)


def by_centroid(frame: Frame, mapping: PlaneMapping) -> FrameResult:
    """`--method centroid`: the instrument's centroid is the tool's position."""
    result, tissue, instrument = locate(frame)
    if tissue is None or instrument is None:
        return result
    return in_plane(result, instrument.centroid_px, tissue.centroid_px, mapping)

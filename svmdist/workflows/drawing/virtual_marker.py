"""The virtual marker of `overlay` in a frame: where it was pasted, its matches and inliers, and its outline.

The method keeps only counts of these. They are computed again here, by the same functions and so with the same
result: the search is deterministic.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.drawing import Form, Part, Shape
from svmdist.estimation.frame import Frame
from svmdist.estimation.planar.marker_detection import mark, template_features
from svmdist.profile import Profile
from svmdist.transforms import Array
from svmdist.vision.frame_context import to_grey
from svmdist.vision.marker.features import detect_orb, match_features
from svmdist.vision.marker.homography import fit_homography, is_plausible, square_corners, transfer
from svmdist.vision.marker.pattern import MarkedWindow


@dataclass(frozen=True, slots=True)
class VirtualMarker:
    """What the search for the pasted marker saw: the window with the marker in it, and places in px of the image.

    `template_px` and `matched_px`, shape (n, 2), are the matched points of template and image, `inliers`, shape (n,),
    those that agree with the homography; `corners_px`, shape (4, 2), is the outline, None where there is none.
    """

    window: MarkedWindow
    keypoints_px: Array
    template_px: Array
    matched_px: Array
    inliers: NDArray[np.bool_]
    corners_px: Array | None


def virtual_marker(frame: Frame, profile: Profile) -> VirtualMarker | None:
    """Search for the marker as `overlay` did in this frame; None where it pasted none."""
    regions = frame.tool.found.get("regions_as_recorded")
    if regions is None or regions[0] is None or regions[1] is None:
        return None
    rules, settings = profile.features, profile.settings.marker
    window = mark(frame.left.context.bgr_as_recorded, regions[1].centroid_px, profile.marker)
    origin_px = np.array(window.origin_px, np.float64)
    features = detect_orb(to_grey(window.window_bgr), rules.feature_count)
    matches = match_features(template_features(profile.marker, rules), features, rules.ratio)
    inliers, corners_px = np.zeros(len(matches), np.bool_), None
    if len(matches) >= rules.min_match_count:
        homography = fit_homography(matches, rules.reprojection_px, settings)
        if homography is not None and is_plausible(homography.H, profile.marker.size_px, settings):
            inliers = homography.inliers
            corners_px = transfer(homography.H, square_corners(profile.marker.size_px)) + origin_px
    return VirtualMarker(
        window,
        features.points_px + origin_px,
        matches.template_px,
        matches.frame_px + origin_px,
        inliers,
        corners_px,
    )


def marker_shapes(found: VirtualMarker, name: str) -> Iterator[Shape]:
    """The outline, and the matches: inliers apart from the others."""
    if found.corners_px is not None:
        yield Shape(Part.MARKER, Form.LOOP, found.corners_px, name)
    for part, chosen in ((Part.MATCH, ~found.inliers), (Part.INLIER, found.inliers)):
        if chosen.any():
            yield Shape(part, Form.POINTS, found.matched_px[chosen], name)

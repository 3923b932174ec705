"""The distal marker in both views of a rectified pair: its disparity, and how certain that is.

The two views cut the marker alike, so that most of what moves its centroid is gone from the disparity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.detection.distal_marker import DistalMarker
from svmdist.results import Failure
from svmdist.settings.stereo import StereoSettings
from svmdist.transforms import Array
from svmdist.vision.rectified import RectifiedPair
from svmdist.vision.sphere import apparent_radius_px

DEFAULT = StereoSettings()


@dataclass(frozen=True, slots=True)
class StereoMatch:
    """The marker in both views: centre in the left one, (2,), disparity, and their standard deviations, in px."""

    left_px: Array
    std_px: float
    disparity_px: float
    disparity_std_px: float


def match_distal_marker(
    left: DistalMarker | None,
    right: DistalMarker | None,
    pair: RectifiedPair,
    radius_m: float | None,
    camera: Camera,
    settings: StereoSettings = DEFAULT,
) -> StereoMatch | Failure:
    """Pair the markers of both views; or why they cannot be paired. `radius_m` is a whole marker's, if known."""
    if left is None or right is None:
        return Failure("the instrument is seen in one view only")
    if abs(left.centre_px[1] - right.centre_px[1]) > settings.row_tolerance_px + left.std_px + right.std_px:
        return Failure("the views do not agree on the instrument")
    disparity_px = pair.disparity_px(float(left.centre_px[0]), float(right.centre_px[0]))
    if disparity_px <= pair.disparity_at(settings.far_m):
        return Failure(
            f"the instrument's disparity, {disparity_px:.1f} px, is that of a point beyond {settings.far_m} m"
        )
    p_camera_m, _ = pair.point(left.centre_px, disparity_px)
    whole_px = left.radius_px or right.radius_px or 2.0 * left.std_px
    if radius_m is not None:
        whole_px = float(apparent_radius_px(p_camera_m, radius_m, camera))
    std_px = left.std_px
    disparity_std_px = float(
        np.hypot(settings.marker_disparity_noise_px, settings.marker_disparity_std * whole_px)
    )
    for marker in (left, right):
        radius_px = marker.radius_px
        if radius_px is None or abs(radius_px / whole_px - 1.0) > settings.size_tolerance:
            # How much is hidden may differ between the views by as much as it moves the centroid in one.
            std_px = max(std_px, 0.5 * whole_px)
            disparity_std_px = float(np.hypot(disparity_std_px, 0.5 * whole_px))
    depth_std_m = p_camera_m[2] / disparity_px * disparity_std_px
    if depth_std_m > settings.max_depth_std_m:
        return Failure("the instrument is partly hidden: its disparity tells no depth")
    return StereoMatch(left.centre_px, std_px, disparity_px, disparity_std_px)

"""The distal marker in both views of a rectified pair: its disparity, and how certain that is.

The two views cut the marker alike, so that most of what moves its centroid is gone from the disparity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.detection.distal_marker import DistalMarker
from svmdist.profile.settings import StereoSettings
from svmdist.results import Failure
from svmdist.transforms import Array
from svmdist.vision.rectified import RectifiedPair
from svmdist.vision.sphere import apparent_radius_px

DEFAULT = StereoSettings()
ASIDE_RAD = 0.056
"""The angle between the views for which the settings state the disparity's deviation: 5 mm at 90 mm."""


@dataclass(frozen=True, slots=True)
class StereoMatch:
    """The marker in both views: centre in the left one, (2,), disparity, and their standard deviations, in px."""

    left_px: Array
    std_px: float
    disparity_px: float
    disparity_std_px: float
    is_other_part: bool = False
    """Whether it is of another size than the marker that the profile states: part of it, or something else."""


def match_distal_marker(
    left: DistalMarker | None,
    right: DistalMarker | None,
    pair: RectifiedPair,
    radius_m: float | None,
    camera: Camera,
    settings: StereoSettings = DEFAULT,
    radius_std_fraction: float = 0.0,
) -> StereoMatch | Failure:
    """Pair the markers of both views; or why they cannot be paired.

    `radius_m` is a whole marker's, if known, and `radius_std_fraction` its standard deviation over itself.
    """
    if left is None or right is None:
        return Failure("the instrument is seen in one view only")
    left_at, right_at = pair.to_rows(left.centre_px), pair.to_rows(right.centre_px, right=True)
    if abs(left_at[1] - right_at[1]) > settings.row_tolerance_px + left.std_px + right.std_px:
        return Failure("the views do not agree on the instrument")
    disparity_px = pair.disparity_px(float(left_at[0]), float(right_at[0]))
    if disparity_px <= pair.disparity_at(settings.far_m):
        return Failure(
            f"the instrument's disparity, {disparity_px:.1f} px, is that of a point beyond {settings.far_m} m"
        )
    p_camera_m, _ = pair.point(left.centre_px, disparity_px)
    # From further aside other parts of it are hidden.
    aside = max(1.0, pair.baseline_m / float(p_camera_m[2]) / ASIDE_RAD)
    radii_px = [marker.radius_px for marker in (left, right) if marker.radius_px is not None]
    if len(radii_px) < 2 or radius_m is None:
        # A coloured part of any shape. What one view shows more of moves its centroid by up to half of it:
        # that is taken for two deviations.
        whole_px = float(np.sqrt(max(left.area_px, right.area_px) / np.pi))
        uneven = abs(left.area_px - right.area_px) / max(left.area_px, right.area_px, 1.0)
        part = 0.25 * uneven + settings.part_disparity_std * aside
        std_px = float(np.hypot(settings.marker_disparity_noise_px, part * whole_px))
        return StereoMatch(left.centre_px, max(left.std_px, 0.5 * whole_px), disparity_px, std_px)
    whole_px = float(apparent_radius_px(p_camera_m, radius_m, camera))
    disparity_std_px = float(
        np.hypot(settings.marker_disparity_noise_px, settings.marker_disparity_std * aside * whole_px)
    )
    std_px = left.std_px
    hidden = max(abs(radius_px / whole_px - 1.0) for radius_px in radii_px)
    is_other_part = hidden > max(settings.size_tolerance, 2.0 * radius_std_fraction)
    if is_other_part:
        # Both views show a part, and nearly the same one where it is as large in both.
        uneven = abs(radii_px[0] - radii_px[1]) / whole_px
        std_px = max(std_px, 0.5 * whole_px)
        part_px = whole_px * (0.5 * uneven + settings.hidden_disparity_std * aside * hidden)
        disparity_std_px = float(np.hypot(disparity_std_px, part_px))
    return StereoMatch(left.centre_px, std_px, disparity_px, disparity_std_px, is_other_part)

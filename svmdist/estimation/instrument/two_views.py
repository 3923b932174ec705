"""What both views of a pair show of one tool: the distal marker's disparity, and residuals of the shaft's pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.instrument.shaft_detection import DistalMarker
from svmdist.profile.settings import StereoSettings
from svmdist.results import Failure
from svmdist.transforms import Array
from svmdist.vision.lines import apparent_radius_px
from svmdist.vision.stereo import RectifiedPair

ROW_TOLERANCE_PX = 3.0  # rectified points lie on one row; the marker is cut differently in each view
MARKER_DISPARITY_STD = 0.012  # over the radius, in one frame: from 3° aside jaws hide other parts of it
# Noise of the marker's disparity: that of two centroids of some hundred pixels
MARKER_DISPARITY_NOISE_PX = 0.05
SIZE_TOLERANCE = 0.2  # of the size by depth; a smaller marker is partly hidden, in both views alike
HIDDEN_DISPARITY_STD = 0.15  # over radius and hidden part: the centroid moves by a quarter more or less
PART_DISPARITY_STD = 0.04  # over a disc's radius: from 3° aside another part of the region shows
WATCH_FRAMES = 20  # frames over which disparities are held against the instrument's sizes
WATCH_BOUND_STDS = 2.5  # in the median; beyond, it widens the depth: one log in eighty by chance

DEFAULT = StereoSettings()
# The angle between the views for which the settings state the disparity's deviation: 5 mm at 90 mm
ASIDE_RAD = 0.056


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
    """Pair the markers of both views; or why they cannot be paired."""
    if left is None or right is None:
        return Failure("the instrument is seen in one view only")
    left_at, right_at = pair.to_rows(left.centre_px), pair.to_rows(right.centre_px, right=True)
    if abs(left_at[1] - right_at[1]) > ROW_TOLERANCE_PX + left.std_px + right.std_px:
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
        part = 0.25 * uneven + PART_DISPARITY_STD * aside
        std_px = float(np.hypot(MARKER_DISPARITY_NOISE_PX, part * whole_px))
        return StereoMatch(left.centre_px, max(left.std_px, 0.5 * whole_px), disparity_px, std_px)
    whole_px = float(apparent_radius_px(p_camera_m, radius_m, camera))
    disparity_std_px = float(np.hypot(MARKER_DISPARITY_NOISE_PX, MARKER_DISPARITY_STD * aside * whole_px))
    std_px = left.std_px
    hidden = max(abs(radius_px / whole_px - 1.0) for radius_px in radii_px)
    is_other_part = hidden > max(SIZE_TOLERANCE, 2.0 * radius_std_fraction)
    if is_other_part:
        # Both views show a part, and nearly the same one where it is as large in both.
        uneven = abs(radii_px[0] - radii_px[1]) / whole_px
        std_px = max(std_px, 0.5 * whole_px)
        part_px = whole_px * (0.5 * uneven + HIDDEN_DISPARITY_STD * aside * hidden)
        disparity_std_px = float(np.hypot(disparity_std_px, part_px))
    return StereoMatch(left.centre_px, std_px, disparity_px, disparity_std_px, is_other_part)

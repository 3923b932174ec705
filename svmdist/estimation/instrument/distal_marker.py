"""The tool's origin in one view or two: by a coloured distal marker, or in the outline of its wrist."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from svmdist.estimation.frame import Arm, Frame, View
from svmdist.estimation.instrument.measurement import MARKER, PointError
from svmdist.estimation.instrument.shaft import FARTHEST_M, STD_PER_DOUBT
from svmdist.results import Failure, ToolPose
from svmdist.transforms import Array, transform_points
from svmdist.vision.lines import without_perspective
from svmdist.vision.stereo import RectifiedPair, matched_place

WRIST = "wrist"
# Deviations over the marker's radius. Biases are states of the filter, and reach the interval as such.
VISIBLE_MIDDLE = 0.05  # a bias: geometry, 6 % of the disc hidden on one side moves the middle of the rest so
DISPARITY_BIAS = 0.016  # blood and shading differ in each view, by 0.1 to 0.2 px at 12 px
SHADING_BIAS = 0.12  # and the light's angle in rad: half of √(1 - 0.97²), Lambert's dark limb
CENTRE_NOISE = 0.02  # pixels, light and angle of view, when simulated: a quarter of a pixel at 12 px
UNKNOWN_SHAPE = 0.33  # of what is seen, where no size is known: of half a disc the middle is 0.42 radii off
DISPARITY_NOISE = 0.008  # when simulated, from 3° aside: jaws hide other parts in the other view
INTERLACED_DISPARITY_NOISE = 0.03  # colours of both fields are mixed, 0.4 px at 12 px
PART_DISPARITY = 0.15  # and over the hidden part: from 3° aside its middle moves by a quarter more or less
DISPARITY_NOISE_PX = 0.05  # that of two centroids of some hundred pixels
EVEN_AREA_FRACTION = 0.02  # by which areas in both views differ when nothing is wrong, over their sum
ASIDE_RAD = 0.056  # the angle between the views that these are given for: 5 mm at 90 mm
ROW_TOLERANCE_PX = 3.0  # rectified points lie on one row; the marker is cut differently in each view
WHOLE_AREA_SPREAD = 0.1  # of a whole marker over its disc's: jaws hide some, a fork adds
MIN_VISIBLE_FRACTION = 0.4  # of a whole marker's area: with less of it, it may be any coloured part
MAX_AREA_FRACTION = 1.44  # a sphere shows no more than its disc, and light a fifth of its radius
MOST_UNKNOWN = 10.0  # of the depth, over itself: of more, a size is not informative either
OTHER_PART_PLACE = 3.0  # over the marker's radius: a ring or a clip, anywhere on the distal part
WRIST_CORRELATED = 0.5  # of the variance of a point on the outline of a wrist: its shape is as it is
MATCH_STD_PX, MATCH_STEP_PX = 1.0, 0.5  # of a wrist in both views: they show other sides of it, by a pixel
MATCH_REACH = 3.0  # how far from the outlines' disparity it is sought, in deviations of that
MATCH_WIDTHS = 0.35  # how far the compared wrist reaches to either side, over the shaft's width


@dataclass(frozen=True, slots=True)
class Expected:
    """The depth at which the tool is expected, and its standard deviation over it."""

    depth_m: float
    std_fraction: float

    @classmethod
    def of(cls, pose: ToolPose) -> Expected | None:
        """By a predicted pose; None where that is behind the camera."""
        depth_m = float(pose.position_m[2])
        return cls(depth_m, float(np.sqrt(pose.covariance[2, 2])) / depth_m) if depth_m > 0.0 else None


@dataclass(frozen=True, slots=True)
class SeenMarker:
    """Where a view shows the tool's origin: pixel (2,), its noise in px, and what stays of its error."""

    name: str
    pixel: Array
    std_px: float
    error: PointError
    radius_px: float  # of the whole
    area_px: float = 0.0
    hidden: float = 0.0  # the fraction of the whole that is not visible


@dataclass(frozen=True, slots=True)
class MarkerPair:
    """The tool's origin in both views: disparity where rows correspond, its noise and its bias, in px."""

    left: SeenMarker
    right: SeenMarker
    disparity_px: float
    std_px: float
    bias_std_px: float
    expected: Expected  # where sizes were compared


def marker_in(view: View, arm: Arm, expected: Expected | None) -> SeenMarker | None:
    """The distal marker, or the tool's origin in the outline of its wrist, and what of it is hidden as expected.

    What hides a side of a disc moves the middle of the rest by half of what is missing. Of another size than the
    marker, what is coloured is somewhere about the tool's origin.
    """
    marker, instrument = view.distal_marker, arm.profile.instrument
    if marker is None:
        return _by_wrist(view, arm)
    seen_px = float(np.sqrt(marker.area_px / np.pi))
    if instrument is None:
        std_px, hidden = UNKNOWN_SHAPE * seen_px, UNKNOWN_SHAPE
        error = PointError(MARKER, shading_px=SHADING_BIAS * seen_px)
        return SeenMarker(MARKER, marker.centre_px, std_px, error, seen_px, marker.area_px, hidden)
    radius_m, place_std_m = instrument.knuckle_radius_m, instrument.knuckle_position_std_m
    if expected is None:
        size_px = marker.radius_px or seen_px
        error = PointError(MARKER, place_std_m, shading_px=SHADING_BIAS * size_px)
        return SeenMarker(MARKER, marker.centre_px, marker.std_px, error, size_px, marker.area_px)
    whole_px = float(view.camera.K[0, 0]) * radius_m / expected.depth_m
    whole, unknown = (seen_px / whole_px) ** 2, min(expected.std_fraction, MOST_UNKNOWN)
    tolerance = np.exp(4.0 * np.hypot(unknown, instrument.knuckle_radius_std_fraction))
    is_other = not MIN_VISIBLE_FRACTION / tolerance <= whole <= MAX_AREA_FRACTION * tolerance
    wrong = max(0.0, abs(1.0 - whole) - WHOLE_AREA_SPREAD)
    name, part_std_m, unseen = MARKER, 0.0, float(np.hypot(0.5 * wrong, unknown))  # jaws that move hide other parts
    if is_other:
        name, part_std_m, unseen = "other part", OTHER_PART_PLACE * radius_m, 0.0
    pixel, doubt_px = marker.centre_px, 0.0
    if (disc := marker.disc) is not None:
        pixel = without_perspective(disc.centre_px, view.camera, expected.depth_m, radius_m)
        doubt_px = disc.doubt_px
    std_px = float(np.hypot(whole_px * np.hypot(CENTRE_NOISE, unseen), STD_PER_DOUBT * doubt_px))
    place_std_m = float(np.hypot(VISIBLE_MIDDLE * radius_m, place_std_m))
    error = PointError(name, place_std_m, part_std_m, SHADING_BIAS * whole_px)
    hidden = max(0.0, abs(np.sqrt(whole) - 1.0) - 0.5 * WHOLE_AREA_SPREAD)
    return SeenMarker(MARKER, pixel, std_px, error, whole_px, marker.area_px, hidden)


def _by_wrist(view: View, arm: Arm) -> SeenMarker | None:
    """The tool's origin in the outline of its wrist; None without both sides of the shaft, and its end."""
    shaft, axis, straight, camera = view.shaft, view.shaft.axis, arm.straight, view.camera
    if shaft.wrist is None or shaft.rim is None or view.rim_ahead is None or axis is None or straight is None:
        return None
    ray = camera.rays(shaft.rim.pixel)[0]
    depth_m = axis.depth_m(ray)
    _, J = camera.project_with_derivative(depth_m * ray)
    by_m = float(shaft.rim.towards_tip @ J @ axis.direction)
    end_std_m = np.copysign(np.hypot(view.rim_ahead[1], shaft.rim.std_px / by_m), by_m)
    wrist, px_per_m = shaft.wrist, float(camera.K[0, 0]) / depth_m
    noise_px, bias_px = np.sqrt([1.0 - WRIST_CORRELATED, WRIST_CORRELATED]) * wrist.std_px
    by_end_m = wrist.end_share * (end_std_m * axis.direction)
    by_jaws_m = (1.0 - wrist.end_share) * straight.jaw_tip_std_m
    error = PointError(WRIST, float(bias_px / px_per_m), with_end_m=by_end_m, with_jaws_m=by_jaws_m)
    return SeenMarker(WRIST, wrist.pixel, float(noise_px), error, wrist.std_px)


def pair_markers(frame: Frame, pair: RectifiedPair, expected: Expected | None = None) -> MarkerPair | Failure:
    """The tool's origin in both views, sized where it is expected, or where its own disparity puts it."""
    arm, left, right = frame.arm, frame.left, frame.right
    one, other = (None if view is None else marker_in(view, arm, expected) for view in (left, right))
    if one is None or other is None or one.name != other.name:
        return Failure("the instrument is seen in one view only")
    left_at, right_at = pair.to_rows(one.pixel), pair.to_rows(other.pixel, right=True)
    if abs(left_at[1] - right_at[1]) > ROW_TOLERANCE_PX + one.std_px + other.std_px:
        return Failure("the views do not agree on the instrument")
    disparity_px = float(left_at[0] - right_at[0]) - pair.offset_px
    far_m = arm.profile.stereo_in_range.far_m
    if disparity_px <= pair.disparity_at(far_m):
        return Failure(f"the instrument's disparity, {disparity_px:.1f} px, is that of a point beyond {far_m} m")
    depth_m = float(pair.point(one.pixel, disparity_px)[0][2])
    if expected is None:
        std_px = float(np.hypot(DISPARITY_NOISE_PX, DISPARITY_BIAS * one.radius_px))
        return pair_markers(frame, pair, Expected(depth_m, std_px / disparity_px))
    if one.area_px == 0.0:  # on an outline
        std_px = float(np.hypot(one.radius_px, other.radius_px))
        matched = _matched(frame, pair, one, disparity_px, std_px)
        if matched is not None:
            # What is next to the tool's origin, by as far as that is not known, may be as much deeper.
            disparity_px, other = matched[0], replace(other, pixel=matched[1])
            std_px = float(np.hypot(MATCH_STD_PX, one.std_px * disparity_px / pair.K[0, 0]))
        return MarkerPair(one, other, disparity_px, std_px, std_px, expected)
    # From further aside other parts of it are hidden; what one view shows more of moves its middle by up to half.
    aside = max(1.0, pair.baseline_m / depth_m / ASIDE_RAD)
    uneven = abs(one.area_px - other.area_px) / (one.area_px + other.area_px)
    noise = aside * (INTERLACED_DISPARITY_NOISE if frame.scene.mixes_colours else DISPARITY_NOISE)
    noise = float(np.hypot(noise, max(0.0, uneven - EVEN_AREA_FRACTION)))
    bias = aside * float(np.hypot(DISPARITY_BIAS, PART_DISPARITY * max(one.hidden, other.hidden)))
    std_px = float(np.hypot(DISPARITY_NOISE_PX, one.radius_px * noise))
    return MarkerPair(one, other, disparity_px, std_px, one.radius_px * bias, expected)


def _matched(
    frame: Frame, pair: RectifiedPair, one: SeenMarker, disparity_px: float, std_px: float
) -> tuple[float, Array] | None:
    """Disparity and right pixel of what the left view shows where the wrist is, near those that its outlines have."""
    right, silhouette = frame.right, frame.left.silhouette
    if right is None or silhouette is None:
        return None
    first_px = max(disparity_px - MATCH_REACH * std_px, pair.disparity_at(FARTHEST_M))
    tried_px = np.arange(first_px, disparity_px + MATCH_REACH * std_px, MATCH_STEP_PX)
    points_m = pair.points(np.tile(pair.to_rows(one.pixel), (len(tried_px), 1)), tried_px)
    places_px = right.camera.project(transform_points(right.T_view_left, points_m))
    views = frame.left.context.grey, right.context.grey
    at = matched_place(views, one.pixel, MATCH_WIDTHS * silhouette.width_px, places_px)
    return None if at is None else (float(tried_px[at]), places_px[at])

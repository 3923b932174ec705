"""The factors of a tool's pose: what one view or a pair shows of the instrument, each as a measurement of a link.

They are written once, for methods with and without memory; the view is an argument. All noise constants of the distal
marker stand here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.across_views import matched_place
from svmdist.estimation.frame import Frame, View
from svmdist.estimation.instrument.measurement import LinkMeasurement
from svmdist.estimation.instrument.measurement_kinds import (
    MARKER,
    POSE_CORRELATION_TIME_S,
    ContourMeasurement,
    DisparityMeasurement,
    EndMeasurement,
    InRightView,
    PointMeasurement,
    PoseMeasurement,
    SizeMeasurement,
)
from svmdist.estimation.instrument.shaft_detection import (
    BORDER_STD_PER_BLUR,
    FARTHEST_M,
    marker_centre,
)
from svmdist.estimation.instrument.shaft_model import ShaftSizes, shaft_frames
from svmdist.estimation.scene import Arm
from svmdist.kinematics import DHChain, frame_transforms, row_index
from svmdist.kinematics.robot_state import RobotState
from svmdist.results import Failure, ToolPose
from svmdist.transforms import Array, inverse
from svmdist.vision.stereo import RectifiedPair

WRIST, DISPARITY = "wrist", "disparity"
# Deviations over the marker's radius. What lasts is a state of the filter, and reaches the interval as such.
VISIBLE_MIDDLE = 0.05  # lasts: geometry, 6 % of the disc hidden on one side moves the middle of the rest so
SHADING_BIAS = (
    0.12  # lasts, over the light's angle in rad: geometry, half of √(1 - 0.97²), Lambert's dark limb
)
LASTING_DISPARITY = (
    0.016  # lasts: blood and shading differ in each view, by 0.1 to 0.2 px at 12 px when simulated
)
CENTRE_NOISE = 0.02  # pixels, light and angle of view, when simulated: a quarter of a pixel at 12 px
UNKNOWN_SHAPE = 0.33  # of what is seen, where no size is known: of half a disc the middle is 0.42 radii off
DISPARITY_NOISE = 0.008  # when simulated, from 3° aside: jaws hide other parts in the other view
INTERLACED_DISPARITY_NOISE = 0.03  # colours of both fields are mixed, 0.4 px at 12 px
PART_DISPARITY = 0.15  # and over the hidden part: from 3° aside its middle moves by a quarter more or less
DISPARITY_NOISE_PX = 0.05  # that of two centroids of some hundred pixels
EVEN_AREA_FRACTION = 0.02  # by which areas in both views differ when nothing is wrong, over their sum
ASIDE_RAD = 0.056  # the angle between the views that these are stated for: 5 mm at 90 mm
ROW_TOLERANCE_PX = 3.0  # rectified points lie on one row; the marker is cut differently in each view
WHOLE_AREA_SPREAD = 0.1  # of a whole marker over its disc's: jaws hide some, a fork adds
MIN_VISIBLE_FRACTION = 0.4  # of a whole marker's area: with less of it, it may be any coloured part
MAX_AREA_FRACTION = (
    1.44  # the same above: a sphere shows no more than its disc, and light a fifth of its radius
)
OTHER_PART_PLACE = 3.0  # over the marker's radius: a ring or a clip, anywhere on the distal part
LASTING_SIZE = 0.75  # of the variance of the marker's radius: light and blood stay
WRIST_LASTING = 0.5  # of the variance of a point on the outline of a wrist: its shape is as it is
JAW_TIP_STD = 0.35  # of an outline's tip over the length of closed, straight jaws: they open and turn
MATCH_STD_PX, MATCH_STEP_PX = 1.0, 0.5  # of a wrist in both views: they show other sides of it, by a pixel
MATCH_REACH = 3.0  # how far from the outlines' disparity it is sought, in deviations of that
MATCH_WIDTHS = 0.35  # how far the compared wrist reaches to either side, over the shaft's width
TOOL_SPEED_M_S = 0.05  # standard deviation along each axis: the tool stands elsewhere in a later view


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
    """Where a view shows the tool's origin: pixel (2,), its noise in px, and what stays of its error.

    `part_std_m` is how far the visible part's middle may be off the marker's, along each axis; `radius_px` the radius
    of the whole, of which a fraction `hidden` is not to be seen. What is of another size is another part.
    """

    name: str
    pixel: Array
    std_px: float
    place_std_m: float
    part_std_m: float
    radius_px: float
    area_px: float = 0.0
    hidden: float = 0.0
    is_other_part: bool = False

    @property
    def bias_name(self) -> str:
        """What lasts of its error is of one thing on the instrument."""
        return "other part" if self.is_other_part else self.name

    @property
    def shaded_px(self) -> float:
        """Radius of what light from the camera shades to one side; 0 of an outline."""
        return self.radius_px if self.area_px > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class MarkerPair:
    """The tool's origin in both views: disparity where rows correspond, its noise and what lasts of its error, in px.

    `expected` is the depth that sizes were compared at.
    """

    left: SeenMarker
    right: SeenMarker
    disparity_px: float
    std_px: float
    lasting_std_px: float
    expected: Expected

    @property
    def total_std_px(self) -> tuple[float, float]:
        """Standard deviations of the pixel and of the disparity, where they are seen once."""
        px_per_m = self.left.radius_px * self.left.part_std_m
        return float(np.hypot(self.left.std_px, px_per_m)), float(np.hypot(self.std_px, self.lasting_std_px))


def marker_in(view: View, arm: Arm, expected: Expected | None) -> SeenMarker | None:
    """The distal marker, or the tool's origin in the outline of its wrist; what is expected tells what of it is hidden.

    What hides a side of a disc moves the middle of the rest by half of what is missing. Of another size than the
    marker, what is coloured is somewhere about the tool's origin.
    """
    marker, instrument = view.distal_marker, arm.profile.instrument
    if marker is None:
        wrist = view.shaft.wrist
        if wrist is None:
            return None
        share = 0.0 if expected is None else WRIST_LASTING
        lasting_m = 0.0 if expected is None else wrist.std_px * expected.depth_m / float(view.camera.K[0, 0])
        std_px = float(np.sqrt(1.0 - share)) * wrist.std_px
        return SeenMarker(WRIST, wrist.pixel, std_px, float(np.sqrt(share)) * lasting_m, 0.0, wrist.std_px)
    seen_px = float(np.sqrt(marker.area_px / np.pi))
    if instrument is None:
        std_px, hidden = UNKNOWN_SHAPE * seen_px, UNKNOWN_SHAPE
        return SeenMarker(MARKER, marker.centre_px, std_px, 0.0, 0.0, seen_px, marker.area_px, hidden)
    radius_m, place_std_m = instrument.knuckle_radius_m, instrument.knuckle_position_std_m
    if expected is None:
        size_px = marker.radius_px or seen_px
        return SeenMarker(MARKER, marker.centre_px, marker.std_px, place_std_m, 0.0, size_px, marker.area_px)
    whole_px = float(view.camera.K[0, 0]) * radius_m / expected.depth_m
    whole, unknown = (seen_px / whole_px) ** 2, expected.std_fraction
    tolerance = np.exp(4.0 * np.hypot(unknown, instrument.knuckle_radius_std_fraction))
    is_other = not MIN_VISIBLE_FRACTION / tolerance <= whole <= MAX_AREA_FRACTION * tolerance
    wrong = max(0.0, abs(1.0 - whole) - WHOLE_AREA_SPREAD)
    pixel, blur_px = marker_centre(marker, view.camera, expected.depth_m, radius_m)
    hidden = 0.0 if is_other else float(np.hypot(0.5 * wrong, unknown))  # jaws that move hide other parts
    return SeenMarker(
        MARKER,
        pixel,
        float(np.hypot(whole_px * np.hypot(CENTRE_NOISE, hidden), BORDER_STD_PER_BLUR * blur_px)),
        float(np.hypot(VISIBLE_MIDDLE * radius_m, place_std_m)),
        OTHER_PART_PLACE * radius_m if is_other else 0.0,
        whole_px,
        marker.area_px,
        max(0.0, abs(np.sqrt(whole) - 1.0) - 0.5 * WHOLE_AREA_SPREAD),
        is_other,
    )


def pair_markers(frame: Frame, pair: RectifiedPair, expected: Expected | None = None) -> MarkerPair | Failure:
    """The tool's origin in both views, sized where it is expected, or where its own disparity puts it."""
    arm, left, right = frame.arm, frame.left, frame.right
    one, other = (None if view is None else marker_in(view, arm, expected) for view in (left, right))
    if one is None or other is None or one.name != other.name:
        return Failure("the instrument is seen in one view only")
    left_at, right_at = pair.to_rows(one.pixel), pair.to_rows(other.pixel, right=True)
    if abs(left_at[1] - right_at[1]) > ROW_TOLERANCE_PX + one.std_px + other.std_px:
        return Failure("the views do not agree on the instrument")
    disparity_px, far_m = (
        pair.disparity_px(float(left_at[0]), float(right_at[0])),
        arm.profile.stereo_in_range.far_m,
    )
    if disparity_px <= pair.disparity_at(far_m):
        return Failure(
            f"the instrument's disparity, {disparity_px:.1f} px, is that of a point beyond {far_m} m"
        )
    depth_m = float(pair.point(one.pixel, disparity_px)[0][2])
    if expected is None:
        std_px = float(np.hypot(DISPARITY_NOISE_PX, LASTING_DISPARITY * one.radius_px))
        return pair_markers(frame, pair, Expected(depth_m, std_px / disparity_px))
    if one.area_px == 0.0:  # on an outline
        std_px = float(np.hypot(one.std_px, other.std_px))
        matched = _matched(frame, pair, one, disparity_px, std_px)
        if matched is not None:
            # What is next to the tool's origin, by as far as that is not known, may be as much deeper.
            disparity_px, other = matched[0], replace(other, pixel=matched[1])
            std_px = float(np.hypot(MATCH_STD_PX, one.std_px * disparity_px / pair.K[0, 0]))
        return MarkerPair(one, other, disparity_px, std_px, std_px, expected)
    # From further aside other parts of it are hidden; what one view shows more of moves its middle by up to half.
    aside = max(1.0, pair.baseline_m / depth_m / ASIDE_RAD)
    uneven = abs(one.area_px - other.area_px) / (one.area_px + other.area_px)
    noise = aside * (INTERLACED_DISPARITY_NOISE if frame.scene.is_interlaced else DISPARITY_NOISE)
    noise = float(np.hypot(noise, max(0.0, uneven - EVEN_AREA_FRACTION)))
    lasting = aside * float(np.hypot(LASTING_DISPARITY, PART_DISPARITY * max(one.hidden, other.hidden)))
    std_px = float(np.hypot(DISPARITY_NOISE_PX, one.radius_px * noise))
    return MarkerPair(one, other, disparity_px, std_px, one.radius_px * lasting, expected)


def _matched(
    frame: Frame, pair: RectifiedPair, one: SeenMarker, disparity_px: float, std_px: float
) -> tuple[float, Array] | None:
    """Disparity and right pixel of what the left view shows where the wrist is, near those that its outlines have."""
    scene, silhouette, right = frame.scene, frame.left.silhouette, frame.scene.observation.right
    if scene.right is None or silhouette is None or right is None:
        return None
    first_px = max(disparity_px - MATCH_REACH * std_px, pair.disparity_at(FARTHEST_M))
    tried_px = np.arange(first_px, disparity_px + MATCH_REACH * std_px, MATCH_STEP_PX)
    points_m = pair.points(np.tile(pair.to_rows(one.pixel), (len(tried_px), 1)), tried_px)
    T_right_left = inverse(right.T_left_right)
    places_px = right.camera.project(points_m @ T_right_left[:3, :3].T + T_right_left[:3, 3])
    views = scene.left.grey, scene.right.grey
    at = matched_place(views, one.pixel, MATCH_WIDTHS * silhouette.width_px, places_px)
    return None if at is None else (float(tried_px[at]), places_px[at])


def of_images(
    frame: Frame,
    expected: Expected | None,
    markers: MarkerPair | Failure | None = None,
    *,
    both_views: bool,
    lasting_share: float = 0.0,
    is_tracked: bool = False,
) -> list[LinkMeasurement]:
    """All factors of the left view or of both; of the variance of edges a share lasts.

    What hides a part of end and marker hides it in both views alike: the second view adds its disparity only. Of a tool
    that is tracked, the shaft's end, a stub's sides, and a size beside a disparity tell less than is known before; and
    what hides its marker may be what has the sides.
    """
    arm, left, right, seen = frame.arm, frame.left, frame.right, frame.scene.observation.right
    views = [left]
    T_right_left, motion_std_m = np.eye(4), 0.0
    if both_views and right is not None and seen is not None:
        views, T_right_left = [left, right], inverse(seen.T_left_right)
        motion_std_m = TOOL_SPEED_M_S * abs(seen.delay_s)

    def of_view(view: View, found: Iterator[LinkMeasurement]) -> list[LinkMeasurement]:
        if view is left:
            return list(found)
        return [InRightView(one, T_right_left, arm.deviations, motion_std_m) for one in found]

    def first(found: Iterator[list[LinkMeasurement]]) -> list[LinkMeasurement]:
        return next((of_one for of_one in found if of_one), [])

    found: list[LinkMeasurement] = []
    marks = first(of_view(view, marked(view, arm, expected)) for view in views)
    # An outline's wrist tells too little without the rest of the outline.
    is_by_outline = any(one.name.endswith(WRIST) for one in marks)
    if is_tracked and not is_by_outline:
        if not left.shaft.is_stub and (marks or left.tag_corners_px is not None):
            found += sides(left, arm, lasting_share)
    else:
        for view in views:
            found += of_view(view, sides(view, arm, lasting_share))
        found += first(of_view(view, end(view, arm)) for view in views)
    if len(views) < 2 or not isinstance(markers, MarkerPair):
        return [*found, *marks]
    if is_tracked:
        marks = [one for one in marks if not isinstance(one, SizeMeasurement)]
    return [*found, *marks, _disparity(frame, views[1], markers, T_right_left)]


def sides(view: View, arm: Arm, lasting_share: float = 0.0) -> Iterator[LinkMeasurement]:
    """Both sides of the shaft's outline in a view; of their variance a share lasts."""
    instrument, axis = arm.profile.instrument, arm.shaft_axis
    if instrument is None or axis is None:
        return
    # What both edges get wrong alike is to the tool what a wrong radius is.
    radius_std = float(np.hypot(arm.deviations.shaft_radius_fraction, view.shaft.width_std))
    deviations = replace(arm.deviations, shaft_radius_fraction=radius_std)
    for contour in view.shaft.contours:
        _, axes = np.linalg.eigh(contour.plane.covariance)
        across = axes[:, 1:].T
        covariance = across @ contour.plane.covariance @ across.T
        yield ContourMeasurement(
            f"edge {contour.side:+d}",
            axis.link,
            contour.plane.normal,
            across,
            (1.0 - lasting_share) * covariance,
            axis.p_axis_m,
            axis.axis,
            instrument.shaft_radius_m,
            contour.side,
            lasting_share * covariance,
            focal_px=_focal_px(view.camera),
            deviations=deviations,
            correlation_time_s=arm.profile.settings.filter.edge_correlation_time_s,
        )


def end(view: View, arm: Arm) -> Iterator[LinkMeasurement]:
    """The shaft's end: of its dark part, or of the outline that is a cylinder's."""
    axis, rim, instrument = arm.shaft_axis, view.shaft.rim, arm.profile.instrument
    if rim is None or axis is None or instrument is None:
        return
    if view.shaft.is_stub and view.distal_marker is not None:  # what ends there may be anything dark
        return
    chain, sizes = arm.required_chain, ShaftSizes(instrument)
    reach_m = float(np.linalg.norm(shaft_frames(chain, np.zeros(len(chain.joint_names)))[1][:3, 3]))
    ahead_m, std_m = sizes.rim_ahead(view.shaft, arm.profile.settings.shaft.end_model_std_m, reach_m)
    yield EndMeasurement(
        "end",
        axis.link,
        view.camera,
        rim.pixel,
        rim.towards_tip,
        np.array([[rim.std_px**2]]),
        hinge_on_link(arm.required_chain, axis.link),
        axis.axis,
        ahead_m,
        0.0 if rim.is_outline else sizes.radius_m,
        std_m,
        deviations=arm.deviations,
    )


def marked(view: View, arm: Arm, expected: Expected | None) -> Iterator[LinkMeasurement]:
    """The tool's origin by its distal marker, and its size; or by the outline of its wrist, and the jaws' tip."""
    seen, marker, instrument = marker_in(view, arm, expected), view.distal_marker, arm.profile.instrument
    if seen is None:
        return
    yield PointMeasurement(
        seen.name,
        None,
        view.camera,
        _marker_place_m(arm, seen),
        seen.pixel,
        seen.std_px**2 * np.eye(2),
        seen.place_std_m,
        SHADING_BIAS * seen.shaded_px,
        part_std_m=seen.part_std_m,
        bias_name=seen.bias_name,
        correlation_time_s=arm.profile.settings.filter.point_correlation_time_s,
        deviations=arm.deviations,
    )
    if instrument is None:
        return
    if marker is not None and marker.radius_px is not None and not seen.is_other_part:
        lasting, variance_px2 = LASTING_SIZE, marker.radius_std_px**2
        yield SizeMeasurement(
            "size",
            None,
            view.camera,
            instrument.knuckle_radius_m,
            marker.radius_px,
            np.array([[(1.0 - lasting) * variance_px2]]),
            float(np.sqrt(lasting * variance_px2)),
            arm.profile.settings.filter.point_correlation_time_s,
            arm.deviations,
        )
    if seen.name == WRIST and (wrist := view.shaft.wrist) is not None:
        length_m = instrument.jaw_length_m
        yield PointMeasurement(
            "jaws' tip",
            None,
            view.camera,
            length_m * straight_jaws(arm.required_chain),
            wrist.tip_px,
            wrist.std_px**2 * np.eye(2),
            JAW_TIP_STD * length_m,
            bias_name="jaws",
            deviations=arm.deviations,
        )


def _disparity(frame: Frame, right: View, markers: MarkerPair, T_right_left: Array) -> LinkMeasurement:
    """How far apart both views show the tool's origin; it shares with its point what is off it on the instrument."""
    arm, left = frame.arm, markers.left
    return DisparityMeasurement(
        DISPARITY,
        None,
        frame.left.camera,
        right.camera,
        T_right_left,
        float(left.pixel[0] - markers.right.pixel[0]),
        np.array([[markers.std_px**2]]),
        left.place_std_m,
        SHADING_BIAS * left.shaded_px,
        part_std_m=left.part_std_m,
        bias_name=left.bias_name,
        correlation_time_s=arm.profile.settings.filter.point_correlation_time_s,
        deviations=arm.deviations,
        lasting_std_px=markers.lasting_std_px,
        p_link_m=_marker_place_m(arm, left),
    )


def tag(
    frame: Frame, robot: RobotState, predicted: ToolPose, lasting_share: float
) -> Iterator[LinkMeasurement]:
    """The tag's pose; the predicted tool tells how the tag is turned, but for the wrist's joints between them."""
    fiducial = frame.arm.profile.fiducial
    if fiducial is None or frame.left.tag_corners_px is None:
        return
    T_base_tag = robot.T_base_link(fiducial.link) @ fiducial.T_link_tag
    R_camera_tag = predicted.T_camera_tool[:3, :3] @ robot.T_base_tool[:3, :3].T @ T_base_tag[:3, :3]
    std_rad = float(np.sqrt(np.linalg.eigvalsh(predicted.covariance[3:, 3:])[-1]))
    found = frame.tag_near(R_camera_tag, std_rad)
    if found is not None:
        yield PoseMeasurement(
            "tag",
            fiducial.link,
            fiducial.T_link_tag,
            found.T_camera_tag,
            (1.0 - lasting_share) * found.covariance,
            lasting_share * found.covariance,
            POSE_CORRELATION_TIME_S,
            _focal_px(frame.left.camera),
            frame.arm.deviations,
        )


def _marker_place_m(arm: Arm, seen: SeenMarker) -> Array:
    """Where the tool carries what is seen, shape (3,), by the profile."""
    instrument = arm.profile.instrument
    if instrument is None or seen.name != MARKER:
        return np.zeros(3)
    return np.array(instrument.knuckle_position_m)


def hinge_on_link(chain: DHChain, link: str) -> Array:
    """The wrist's hinge, shape (3,), in the frame of the link that slides along the shaft."""
    straight = np.zeros(len(chain.joint_names))
    T = inverse(frame_transforms(chain, straight)[row_index(chain, link)])
    return np.asarray(T[:3, :3] @ shaft_frames(chain, straight)[0][:3, 3] + T[:3, 3])


def straight_jaws(chain: DHChain) -> Array:
    """The direction of straight, closed jaws in the tool's frame, shape (3,)."""
    return shaft_frames(chain, np.zeros(len(chain.joint_names)))[1][2, :3].copy()


def _focal_px(camera: Camera) -> tuple[float, float]:
    return float(camera.K[0, 0]), float(camera.K[1, 1])

"""The factors of a tool's pose: what one view or a pair shows of the instrument, each as a measurement of a link."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from svmdist.estimation.frame import Arm, Frame, View
from svmdist.estimation.instrument import measurement as kinds
from svmdist.estimation.instrument.distal_marker import WRIST, Expected, MarkerPair, SeenMarker, marker_in
from svmdist.estimation.instrument.kinematic_error_filter import KinematicErrorFilter
from svmdist.estimation.instrument.measurement import LinkMeasurement
from svmdist.kinematics.robot_state import RobotState
from svmdist.results import Failure, ToolPose
from svmdist.transforms import Array

DISPARITY, EDGE, SIZE = "disparity", "edge {:+d}", "size"
SHAFT, TAG = "shaft", "tag"  # detections
CORRELATED_SIZE = 0.75  # of the variance of the marker's radius: light and blood stay
CORRELATED_OUTLINE = 0.75  # of the variance of what ends an outline in the image: the cause stays
TAG_CORRELATION_TIME_S = 0.5
COLOUR_DELAY_S = 0.0092  # where both fields' colours are mixed: half of a 50th or of a 60th of a second


def of_images(
    frame: Frame,
    expected: Expected | None,
    markers: MarkerPair | Failure | None = None,
    *,
    both_views: bool,
    correlated_share: float = 0.0,
    is_tracked: bool = False,
) -> list[LinkMeasurement]:
    """All factors of the left view or of both; of the variance of edges a share is correlated.

    What hides a part of end and marker hides it in both views alike: the second view adds its disparity only. Of a tool
    that is tracked by its marker or tag, the right view's sides, the shaft's end and a size beside a disparity
    add no information.
    """
    arm, left, right = frame.arm, frame.left, frame.right
    views = [left, right] if both_views and right is not None else [left]

    def of_view(view: View, found: Iterator[LinkMeasurement]) -> list[LinkMeasurement]:
        return list(found) if view is left else [_in_right_view(one, view) for one in found]

    found, marks, ends = list[LinkMeasurement](), list[LinkMeasurement](), list[LinkMeasurement]()
    for view in views:
        marks = marks or of_view(view, marked(view, arm, expected))
    # An outline's wrist is too ambiguous without the rest of the outline.
    is_by_outline = any(one.name.endswith(WRIST) for one in marks)
    if is_tracked and not is_by_outline and (marks or left.tag_corners_px is not None):
        found += sides(left, arm, correlated_share)
    else:
        is_alone = sum(bool(view.shaft.contours) for view in views) < 2
        for view in views:
            found += of_view(view, sides(view, arm, correlated_share, is_alone=is_alone))
            ends = ends or of_view(view, end(view, arm))
    if len(views) > 1 and isinstance(markers, MarkerPair):
        if is_tracked:
            marks = [one for one in marks if one.name != SIZE]
        marks = [*marks, _disparity(frame, views[1], markers)]
    if frame.scene.mixes_colours and not is_by_outline:
        marks = [replace(one, delay_s=one.delay_s + COLOUR_DELAY_S) for one in marks]
    return [*found, *ends, *marks]


def sides(view: View, arm: Arm, correlated_share: float = 0.0, *, is_alone: bool = False) -> Iterator[LinkMeasurement]:
    """Both sides of the shaft's outline in a view; of their variance a share is correlated."""
    if not view.shaft.contours or arm.straight is None:
        return
    axis = arm.straight.axis
    # What both edges get wrong alike is to the tool what a wrong radius is.
    radius_m, camera_error = arm.straight.radius_m, arm.profile.camera_error
    radius_std = float(np.hypot(arm.straight.instrument.shaft_radius_std_fraction, view.shaft.width_std))
    if is_alone:  # no other view shows the depth of what may be a wrist
        radius_std = float(np.hypot(radius_std, view.shaft.wrist_std))
    focal_px, time_s = np.diag(view.camera.K)[:2], arm.profile.settings.filter.edge_correlation_time_s
    for contour in view.shaft.contours:
        _, axes = np.linalg.eigh(contour.covariance)
        across = axes[:, 1:].T
        covariance = across @ contour.covariance @ across.T
        by_bias = kinds.bias_jacobian(correlated_share * covariance)
        yield LinkMeasurement(
            name=EDGE.format(contour.side),
            in_view=kinds.edge(contour, across, by_bias, axis, radius_m, radius_std, focal_px, camera_error),
            covariance=(1.0 - correlated_share) * covariance,
            link=axis.link,
            source=SHAFT,
            correlation_time_s=time_s,
            camera_error=camera_error,
        )


def end(view: View, arm: Arm) -> Iterator[LinkMeasurement]:
    """The shaft's end: of its dark part, or of the outline that is a cylinder's."""
    rim, ahead, straight = view.shaft.rim, view.rim_ahead, arm.straight
    if rim is None or ahead is None or straight is None:
        return
    # On the axis, or on the generatrix that faces the camera.
    place = straight.axis.axis, straight.hinge_m, ahead[0], 0.0 if rim.is_outline else straight.radius_m
    bias_std_px = float(np.sqrt(CORRELATED_OUTLINE)) * rim.std_px
    yield LinkMeasurement(
        name="end",
        in_view=kinds.shaft_end(view.camera, rim, *place, ahead[1], bias_std_px, arm.profile.camera_error),
        covariance=np.array([[(1.0 - CORRELATED_OUTLINE) * rim.std_px**2]]),
        link=straight.axis.link,
        source=SHAFT,
        bias=kinds.END_BIAS,  # whichever view shows it
        correlation_time_s=arm.profile.settings.filter.point_correlation_time_s,
        camera_error=arm.profile.camera_error,
        rests_on=tuple(EDGE.format(contour.side) for contour in view.shaft.contours),
    )


def marked(view: View, arm: Arm, expected: Expected | None) -> Iterator[LinkMeasurement]:
    """The tool's origin by its distal marker, and its size; or by the outline of its wrist, and the jaws' tip."""
    seen, marker, instrument = marker_in(view, arm, expected), view.distal_marker, arm.profile.instrument
    if seen is None:
        return
    time_s = arm.profile.settings.filter.point_correlation_time_s
    error = arm.profile.camera_error
    of_marker = partial(LinkMeasurement, source=kinds.MARKER, correlation_time_s=time_s, camera_error=error)
    in_view = kinds.point(view.camera, seen.pixel, marker_place_m(arm, seen), seen.error)
    # What another part is off is not what the marker is.
    bias = "" if seen.error.name == seen.name else seen.error.name
    yield of_marker(name=seen.name, in_view=in_view, covariance=seen.std_px**2 * np.eye(2), bias=bias)
    if instrument is None:
        return
    is_other_part = seen.error.part_std_m > 0.0  # it is not of the marker's size
    if marker is not None and marker.radius_px is not None and not is_other_part:
        variance_px2 = marker.radius_std_px**2 - marker.hidden_px**2
        stds_px = float(np.sqrt(CORRELATED_SIZE * variance_px2)), marker.hidden_px
        radius = instrument.knuckle_radius_m, instrument.knuckle_radius_std_fraction
        in_view = kinds.sphere_size(view.camera, *radius, marker.radius_px, *stds_px)
        yield of_marker(name=SIZE, in_view=in_view, covariance=np.array([[(1.0 - CORRELATED_SIZE) * variance_px2]]))
    if seen.name == WRIST and (wrist := view.shaft.wrist) is not None and arm.straight is not None:
        tip_m, C = instrument.jaw_length_m * arm.straight.T_shaft_tool[2, :3], wrist.tip_std_px**2 * np.eye(2)
        in_view = kinds.point(
            view.camera, wrist.tip_px, tip_m, kinds.PointError(kinds.JAWS, arm.straight.jaw_tip_std_m)
        )
        yield of_marker(name="jaws' tip", in_view=in_view, covariance=C, bias=kinds.JAWS)


def _in_right_view(one: LinkMeasurement, view: View) -> LinkMeasurement:
    """A measurement by the right camera: what an edge or a point alone gets wrong is each view's own."""
    name, *rests_on = (f"right {each}" for each in (one.name, *one.rests_on))
    return replace(one, name=name, rests_on=tuple(rests_on), T_view_left=view.T_view_left, delay_s=view.delay_s)


def _disparity(frame: Frame, right: View, markers: MarkerPair) -> LinkMeasurement:
    """How far apart both views show the tool's origin; it shares with its point what is off it on the instrument."""
    arm, left, cameras = frame.arm, markers.left, (frame.left.camera, right.camera)
    found_px, place_m = float(left.pixel[0] - markers.right.pixel[0]), marker_place_m(arm, left)
    return LinkMeasurement(
        name=DISPARITY,
        in_view=kinds.disparity(cameras, right.T_view_left, found_px, place_m, left.error, markers.bias_std_px),
        covariance=np.array([[markers.std_px**2]]),
        source=DISPARITY,
        bias=left.error.name,
        correlation_time_s=arm.profile.settings.filter.point_correlation_time_s,
        camera_error=arm.profile.camera_error,
    )


def tag(frame: Frame, robot: RobotState, predicted: ToolPose, correlated_share: float) -> Iterator[LinkMeasurement]:
    """The tag's pose; the predicted tool gives the tag's rotation, but for the wrist's joints between them."""
    fiducial = frame.arm.profile.fiducial
    if fiducial is None or frame.left.tag_corners_px is None:
        return
    T_base_tag = robot.T_base_link(fiducial.link) @ fiducial.T_link_tag
    R_camera_tag = predicted.T_camera_tool[:3, :3] @ robot.T_base_tool[:3, :3].T @ T_base_tag[:3, :3]
    std_rad = float(np.sqrt(np.linalg.eigvalsh(predicted.covariance[3:, 3:])[-1]))
    found = frame.tag_near(R_camera_tag, std_rad)
    if found is not None:
        error, focal_px = frame.arm.profile.camera_error, np.diag(frame.left.camera.K)[:2]
        shared = kinds.tag_biases(found.T_camera_tag, focal_px, error, fiducial)
        by_bias = kinds.bias_jacobian(correlated_share * found.covariance)
        yield LinkMeasurement(
            name=TAG,
            in_view=kinds.pose(fiducial.T_link_tag, found.T_camera_tag, by_bias, shared),
            covariance=(1.0 - correlated_share) * found.covariance,
            link=fiducial.link,
            source=TAG,
            correlation_time_s=TAG_CORRELATION_TIME_S,
            camera_error=error,
        )


def marker_place_m(arm: Arm, seen: SeenMarker) -> Array:
    """Where the tool carries what is seen, shape (3,), by the profile."""
    instrument = arm.profile.instrument
    if instrument is None or seen.name != kinds.MARKER:
        return np.zeros(3)
    return np.array(instrument.knuckle_position_m)


def jaw_scale(kalman: KinematicErrorFilter, arm: Arm) -> float:
    """The jaws' length over the profile's, by their tips in the image: never less, as what is seen may lack them."""
    deviations = kalman.state.bias(kinds.JAWS)
    if deviations <= 0.0 or arm.straight is None:
        return 1.0
    return 1.0 + deviations * arm.straight.jaw_tip_std_m / arm.straight.instrument.jaw_length_m

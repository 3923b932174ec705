"""The tool's pose by one image, or by a pair: the filter's measurements under a prior that leaves the place open.

A state of its own for every frame: where the base stands is open, how it is turned and how the wrist is bent are as
certain as kinematics say. Sides, end, marker and disparity are the same measurements that a filter takes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.estimation.frame import Frame, View
from svmdist.estimation.instrument.kinematic_error_filter import KinematicErrorFilter
from svmdist.estimation.instrument.measurement import LinkMeasurement
from svmdist.estimation.instrument.measurement_kinds import (
    ContourMeasurement,
    DisparityMeasurement,
    EndMeasurement,
    InRightView,
    PointMeasurement,
    SizeMeasurement,
)
from svmdist.estimation.instrument.shaft_detection import wrist_marker
from svmdist.estimation.instrument.shaft_model import ShaftModel, first_shafts, shaft_frames
from svmdist.estimation.instrument.two_views import StereoMatch, match_distal_marker
from svmdist.estimation.scene import Arm
from svmdist.kinematics import DHChain, frame_transforms, row_index
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.robot import KinematicError
from svmdist.results import Failure, ToolPose
from svmdist.transforms import Array, inverse, make_transform, rotation_of
from svmdist.vision.stereo import RectifiedPair

OPEN_M = 0.3  # standard deviation of the base's place: a scene is no larger
OPEN_RAD = 3.0  # of its rotation, where nothing tells it
START_STD_M, START_STD_RAD = 5e-3, 0.1  # of a start, which is where to linearise and no more
ROLL_COUNT = 4  # starts about a shaft whose rotation is not known
TOOL_SPEED_M_S = 0.05  # standard deviation along each axis: the tool stands elsewhere in a later view
OTHER_PART_PLACE = 3.0  # over the marker's radius: a ring or a clip, anywhere on the distal part
UNKNOWN_END = 0.5  # deviation of the distance from hinge to the shaft's end where none is stated, over itself
JAW_TIP_STD = 0.35  # of an outline's tip over the length of closed, straight jaws: they open and turn
MAX_REFUSED_SHARE = 1.0 / 3.0  # of what was measured: with more refused nothing tells which is right


@dataclass(frozen=True, slots=True)
class ImagePose:
    """The tool's pose, the wrist's hinge (3,) in the camera frame, the measurements that carry them, and any doubt."""

    pose: ToolPose
    hinge_m: Array
    used: tuple[str, ...]
    doubt: str


def pose_by_image(frame: Frame) -> ImagePose | Failure:
    """The tool by the left view; or why it cannot be measured."""
    arm, left = frame.arm, frame.left
    instrument, marker = arm.profile.instrument, left.distal_marker or wrist_marker(left.shaft)
    if instrument is None:
        return Failure(f"profile {arm.profile.name} has no [instrument]")
    if left.shaft.is_stub and left.shaft.contours and marker is None:
        # Anything dark at the border has two short sides; nothing here would contradict them.
        return Failure("too little of the shaft is to be seen, and neither wrist nor distal marker")
    model = ShaftModel.of(frame.robot, arm.required_chain, instrument)
    firsts = first_shafts(left.shaft, marker, model, left.camera, model.R_camera_shaft)
    measured = [*sides(left, arm), *end(left, model, arm), *marked(left, model, arm)]
    return _located(frame, list(firsts), measured, model)


def pose_by_pair(frame: Frame, pair: RectifiedPair) -> ImagePose | Failure:
    """The tool by both views; or why it cannot be measured."""
    arm, left, right, seen = frame.arm, frame.left, frame.right, frame.scene.observation.right
    instrument = arm.profile.instrument
    assert instrument is not None
    assert right is not None  # the pair has one
    assert seen is not None
    if left.region is None and right.region is None:
        # What hides the distal part ends the shaft, too: its end is then anywhere.
        return Failure("the instrument's distal part is hidden in both views")
    match = match_of(frame, pair)
    model = ShaftModel.of(frame.robot, arm.required_chain, instrument)
    T_right_left = inverse(seen.T_left_right)
    motion_std_m = TOOL_SPEED_M_S * abs(seen.delay_s)

    def by_right(of_view: Iterator[LinkMeasurement]) -> list[LinkMeasurement]:
        return [InRightView(one, T_right_left, arm.deviations, motion_std_m) for one in of_view]

    # What hides a part of end and marker hides it in both views alike: the second view adds its disparity only.
    is_other_part = isinstance(match, StereoMatch) and match.is_other_part
    measured: list[LinkMeasurement] = [*sides(left, arm), *by_right(sides(right, arm))]
    measured += list(end(left, model, arm)) or by_right(end(right, model, arm))
    measured += list(marked(left, model, arm, is_other_part)) or by_right(
        marked(right, model, arm, is_other_part)
    )
    tool_m = None
    if isinstance(match, StereoMatch):
        tool_m = pair.point(match.left_px, match.disparity_px)[0]
        variance = np.array([[match.disparity_std_px**2]])
        measured.append(
            DisparityMeasurement(
                "disparity",
                None,
                left.camera,
                right.camera,
                T_right_left,
                match.disparity_px,
                variance,
                _marker_std_m(arm, is_other_part),
                deviations=arm.deviations,
            )
        )
    return _located(frame, list(_first_places(left, right, tool_m, model, T_right_left)), measured, model)


def match_of(frame: Frame, pair: RectifiedPair) -> StereoMatch | Failure:
    """The distal marker in both views."""
    profile, right = frame.arm.profile, frame.right
    instrument = profile.instrument
    radius_m, radius_std = (None, 0.0)
    if instrument is not None:
        radius_m, radius_std = instrument.knuckle_radius_m, instrument.knuckle_radius_std_fraction
    markers = frame.left.distal_marker, None if right is None else right.distal_marker
    return match_distal_marker(
        *markers, pair, radius_m, frame.left.camera, profile.stereo_in_range, radius_std
    )


def sides(view: View, arm: Arm, lasting_share: float = 0.0) -> Iterator[LinkMeasurement]:
    """Both sides of the shaft's outline in a view; of their variance a share lasts."""
    instrument, axis = arm.profile.instrument, arm.shaft_axis
    if instrument is None or axis is None:
        return
    focal_px = float(view.camera.K[0, 0]), float(view.camera.K[1, 1])
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
            focal_px=focal_px,
            deviations=arm.deviations,
            correlation_time_s=arm.profile.settings.filter.edge_correlation_time_s,
        )


def end(view: View, model: ShaftModel, arm: Arm) -> Iterator[LinkMeasurement]:
    """The shaft's end: of its dark part, or of the outline that is a cylinder's."""
    axis, rim = arm.shaft_axis, view.shaft.rim
    if rim is None or axis is None:
        return
    ahead_m, radius_m, std_m = -model.neck_m, model.radius_m, arm.profile.settings.shaft.end_model_std_m
    if rim.is_outline:
        ahead_m, radius_m, std_m = model.outline_end_m, 0.0, model.outline_end_std_m
    elif model.instrument.shaft_end_m is None:  # guessed from another size
        std_m = UNKNOWN_END * model.neck_m
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
        radius_m,
        std_m,
        deviations=arm.deviations,
    )


def marked(view: View, model: ShaftModel, arm: Arm, is_other_part: bool = False) -> Iterator[LinkMeasurement]:
    """The tool's origin by its distal marker, and its size; or by the outline of its wrist, and the jaws' tip."""
    marker, wrist = view.distal_marker or wrist_marker(view.shaft), view.shaft.wrist
    if marker is None:
        return
    variance = marker.std_px**2 * np.eye(2)
    place_std_m, origin_m = _marker_std_m(arm, is_other_part), np.zeros(3)
    yield PointMeasurement(
        "distal marker", None, view.camera, origin_m, marker.centre_px, variance, place_std_m,
        deviations=arm.deviations,
    )  # fmt: skip
    if marker.radius_px is not None:
        variance = np.array([[marker.radius_std_px**2]])
        radius_m = model.instrument.knuckle_radius_m
        yield SizeMeasurement(
            "size", None, view.camera, radius_m, marker.radius_px, variance, 0.0, deviations=arm.deviations
        )
    if wrist is not None:
        length_m = model.instrument.jaw_length_m
        variance = wrist.std_px**2 * np.eye(2)
        yield PointMeasurement(
            "jaws' tip", None, view.camera, length_m * model.jaws, wrist.tip_px, variance,
            JAW_TIP_STD * length_m, bias_name="jaws", deviations=arm.deviations,
        )  # fmt: skip


def hinge_on_link(chain: DHChain, link: str) -> Array:
    """The wrist's hinge, shape (3,), in the frame of the link that slides along the shaft."""
    straight = np.zeros(len(chain.joint_names))
    T = inverse(frame_transforms(chain, straight)[row_index(chain, link)])
    return np.asarray(T[:3, :3] @ shaft_frames(chain, straight)[0][:3, 3] + T[:3, 3])


def _marker_std_m(arm: Arm, is_other_part: bool) -> float:
    """How far the distal marker may be from the tool's origin, along each axis."""
    instrument = arm.profile.instrument
    assert instrument is not None
    # What is coloured and of another size is somewhere about the tool's origin.
    place_m = OTHER_PART_PLACE * instrument.knuckle_radius_m if is_other_part else 0.0
    return float(np.hypot(instrument.knuckle_position_std_m, place_m))


def _first_places(
    left: View, right: View, tool_m: Array | None, model: ShaftModel, T_right_left: Array
) -> Iterator[Array | Failure]:
    """First `T_left_shaft`, (4, 4): by the sides in either view, by the triangulated marker; or what is missing."""
    R_nominal = model.R_camera_shaft
    for view, T_left_view in ((left, np.eye(4)), (right, inverse(T_right_left))):
        R = None if R_nominal is None else T_left_view[:3, :3].T @ R_nominal
        marker = view.distal_marker or wrist_marker(view.shaft)
        for first in first_shafts(view.shaft, marker, model, view.camera, R):
            if isinstance(first, Failure):
                yield first
                continue
            T = T_left_view @ first
            if tool_m is not None:  # disparity is nearer to the truth than the width of a stub
                yield make_transform(T[:3, :3], tool_m - T[:3, :3] @ model.T_shaft_tool[:3, 3])
            yield np.asarray(T)
    if tool_m is not None and R_nominal is not None:
        yield make_transform(R_nominal, tool_m - R_nominal @ model.T_shaft_tool[:3, 3])


def _located(
    frame: Frame, places: Sequence[Array | Failure], measured: Sequence[LinkMeasurement], model: ShaftModel
) -> ImagePose | Failure:
    """The most probable tool under an open prior, from first places of the shaft's frame, `T_camera_shaft` each."""
    firsts = [place for place in places if not isinstance(place, Failure)]
    if not firsts:
        return next(place for place in places if isinstance(place, Failure))
    chain, robot, profile = frame.arm.required_chain, frame.robot, frame.arm.profile
    error = {name: getattr(profile.kinematic_error, name) for name in KinematicError.model_fields}
    error |= {"camera_base_std_m": OPEN_M, "time_offset_std_s": 0.0}
    rolls_rad: Sequence[float] = (0.0,)
    if isinstance(robot, Failure):
        error["joint_std_rad"] = profile.settings.shaft.unknown_bend_rad
    if isinstance(robot, Failure) or robot.T_camera_base is None:
        if not isinstance(robot, Failure):
            rolls_rad = [2.0 * np.pi * turn / ROLL_COUNT for turn in range(ROLL_COUNT)]
        T_camera_base = firsts[0] @ inverse(model.T_base_shaft)
        robot = RobotState(chain, frame.stamp_ns, model.q, T_camera_base)
        error["camera_base_std_rad"] = OPEN_RAD
    kalman = KinematicErrorFilter(chain, KinematicError(**error), profile.settings.filter)
    kalman.predict(robot)
    covariance = np.diag([START_STD_M**2] * 3 + [START_STD_RAD**2] * 3)
    rolls = [make_transform(rotation_of([0.0, 0.0, angle]), np.zeros(3)) for angle in rolls_rad]
    poses = [T @ roll @ model.T_shaft_tool for T in firsts for roll in rolls]
    kalman.begin([(ToolPose(T, covariance, T[:3, 0]), measured) for T in poses])
    judged = kalman.update(measured)
    degrees = sum(result.degrees_of_freedom for result in judged)
    refused = [result for result in judged if not result.is_accepted]
    if sum(result.degrees_of_freedom for result in refused) > MAX_REFUSED_SHARE * degrees:
        return Failure(f"{', '.join(result.name for result in refused)} do not fit the rest")
    if not judged:
        return Failure("the fit does not converge")
    axis = frame.arm.shaft_axis
    assert axis is not None  # the model has its frame
    T_camera_link = kalman.link_pose(axis.link)
    hinge_m = T_camera_link[:3, :3] @ hinge_on_link(chain, axis.link) + T_camera_link[:3, 3]
    used = tuple(one.name for one in judged if one.is_accepted)
    return ImagePose(kalman.tool_pose(), hinge_m, used, kalman.consistency.doubt)

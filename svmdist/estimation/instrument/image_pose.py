"""The tool's pose by one image, or by a pair: the filter's measurements under a prior that leaves the place open.

A state of its own for every frame: where the base stands is open, how it is turned and how the wrist is bent are as
certain as kinematics say. Sides, end, marker and disparity are the same measurements that a filter takes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from svmdist.estimation.frame import Frame, View
from svmdist.estimation.instrument.consistency import GatingResult
from svmdist.estimation.instrument.distal_marker import MarkerPair, pair_markers
from svmdist.estimation.instrument.factors import DISPARITY, jaw_scale, of_images
from svmdist.estimation.instrument.kinematic_error_filter import KinematicErrorFilter
from svmdist.estimation.instrument.measurement import LinkMeasurement
from svmdist.estimation.instrument.shaft import ShaftDetection, ShaftModel
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.robot import KinematicError
from svmdist.results import Failure, ToolPose
from svmdist.transforms import Array, cross, inverse, make_transform, rotation_of
from svmdist.vision.lines import CylinderAxis, apparent_radius_px
from svmdist.vision.stereo import RectifiedPair

OPEN_M = 0.3  # standard deviation of the base's place: a scene is no larger
OPEN_RAD = 3.0  # of its rotation, if unknown
START_STD_M, START_STD_RAD = 5e-3, 0.1  # of a start, which is where to linearise and no more
ROLL_COUNT = 4  # starts about a shaft whose rotation is not known
DEPTH_CUES = DISPARITY, "size"  # whose outliers contest a pose by where they lead (`rival_m`)
MAX_OUTLIER_SHARE = 1.0 / 3.0  # of what was measured: with more outliers nothing shows which are right


@dataclass(frozen=True, slots=True)
class ImagePose:
    """The tool's pose with its wrist's hinge, the measurements that it rests on, and any contradiction."""

    pose: ToolPose
    used: tuple[str, ...]
    contradiction: str
    gating: tuple[GatingResult, ...] = ()


def pose_by_images(frame: Frame, pair: RectifiedPair | None = None) -> ImagePose | Failure:
    """The tool by the left view, or by both views of a pair; or why it cannot be measured."""
    arm, right, instrument = frame.arm, frame.right, frame.arm.profile.instrument
    if instrument is None:
        return Failure(f"profile {arm.profile.name} has no [instrument]")
    model = ShaftModel.of(frame.robot, arm.required_chain, instrument)
    views, markers, tool_m, expected = [frame.left], None, None, None
    if pair is not None:
        assert right is not None  # the pair has one
        views.append(right)
        if all(view.region is None for view in views) and any(view.shaft.contours for view in views):
            # What hides the distal part ends the shaft, too: its end is then anywhere.
            return Failure("the instrument's distal part is hidden in both views")
        markers = pair_markers(frame, pair)
        if isinstance(markers, MarkerPair):
            tool_m, expected = pair.point(markers.left.pixel, markers.disparity_px)[0], markers.expected
    firsts = list(_first_places(views, tool_m, model))
    return _located(frame, firsts, of_images(frame, expected, markers, both_views=pair is not None), model)


def _first_places(views: Sequence[View], tool_m: Array | None, model: ShaftModel) -> Iterator[Array | Failure]:
    """First `T_left_shaft`, (4, 4): by sides or marker in a view, by the triangulated marker; or what is missing."""
    R_nominal, tool_in_shaft_m = model.R_camera_shaft, model.T_shaft_tool[:3, 3]
    for view in views:
        T_left_view, marker = inverse(view.T_view_left), view.distal_marker
        R = None if R_nominal is None else T_left_view[:3, :3].T @ R_nominal
        firsts = [] if (axis := view.shaft.axis) is None else list(_starts_from_sides(view, axis, model, R))
        if R is None:
            firsts.append(Failure("no long enough part of a shaft is visible with both sides"))
        elif marker is None or marker.radius_px is None:
            firsts.append(Failure("neither both sides of the shaft nor a whole distal marker"))
        else:
            ray, radius_m = view.camera.rays(marker.centre_px)[0], model.instrument.knuckle_radius_m
            marker_m = apparent_radius_px(ray, radius_m, view.camera) / marker.radius_px * ray
            firsts.append(make_transform(R, marker_m - R @ tool_in_shaft_m))
        for first in firsts:
            if isinstance(first, Failure):
                yield first
                continue
            T = T_left_view @ first
            if tool_m is not None:  # disparity is more accurate than the width of a short segment
                yield make_transform(T[:3, :3], tool_m - T[:3, :3] @ tool_in_shaft_m)
            yield np.asarray(T)
    if tool_m is not None and R_nominal is not None:
        yield make_transform(R_nominal, tool_m - R_nominal @ tool_in_shaft_m)


def _starts_from_sides(
    view: View, axis: CylinderAxis, model: ShaftModel, R_nominal: Array | None
) -> Iterator[Array | Failure]:
    """By the closed form, with the shaft's end where it is seen, and where the marker has it; or why none."""
    shaft, d = view.shaft, axis.direction
    if shaft.towards_tip is not None and shaft.middle_px is not None:
        x, y, _ = view.camera.rays(shaft.middle_px)[0]
        ahead = float(np.array([d[0] - x * d[2], d[1] - y * d[2]]) @ shaft.towards_tip)
    elif R_nominal is not None:
        ahead = float(d @ R_nominal[:, 2])
    else:
        yield Failure("the shaft's tip cannot be told from its base")
        return
    d = d if ahead > 0 else -d
    rim, marker, hinges_m = shaft.rim, view.distal_marker, list[Array]()
    landmarks: list[tuple[Array, float]] = []
    if rim is not None:
        landmarks.append((rim.pixel, model.outline_end_m if rim.is_outline else -model.end_m))
    if marker is not None:
        landmarks.append((marker.centre_px, float(model.T_shaft_tool[2, 3])))
    for pixel, ahead_m in landmarks:  # where the axis passes its ray, less its place on the straight tool
        ray = view.camera.rays(pixel)[0]
        ray = ray / np.linalg.norm(ray)
        cosine = float(ray @ d)
        if 1.0 - cosine**2 >= 1e-4:
            along_m = (cosine * float(ray @ axis.point_m) - float(d @ axis.point_m)) / (1.0 - cosine**2)
            hinges_m.append(axis.point_m + (along_m - ahead_m) * d)
    if not hinges_m:
        yield Failure("the shaft's end is not visible")
    for hinge_m in hinges_m:
        # Unknown, the wrist bends as one sees it: about the line of sight.
        y = cross(d, cross(hinge_m, d)) if R_nominal is None else cross(d, R_nominal[:, 0])
        y /= np.linalg.norm(y)
        yield make_transform(np.stack([cross(y, d), y, d], -1), hinge_m)


def _bends_aside(shaft: ShaftDetection) -> bool:
    """Whether the outline of the wrist shows it bent in the image, rather than towards the camera or not at all."""
    if shaft.wrist is None or shaft.towards_tip is None or shaft.middle_px is None:
        return False
    (x, y), (along_x, along_y) = shaft.wrist.pixel - shaft.middle_px, shaft.towards_tip
    return abs(float(along_x * y - along_y * x)) > shaft.wrist.std_px


def _with_other_bend(pose: ToolPose, frame: Frame, model: ShaftModel) -> ToolPose:
    """The pose of a wrist that is bent about the other axis, too: the chain of a straight one lacks that."""
    ray = pose.position_m / np.linalg.norm(pose.position_m)
    bent = pose.T_camera_tool[:3, :3] @ model.T_shaft_tool[1, :3]  # about it the chain bends
    bent -= pose.axis * float(pose.axis @ bent)
    bent /= max(float(np.linalg.norm(bent)), 1e-9)
    variance = frame.arm.profile.settings.shaft.unknown_bend_rad**2
    information = 2.0 / (1.0 - np.exp(-2.0 * variance))  # of the sine of a normal angle
    wrist = frame.left.shaft.wrist
    if wrist is not None:  # across the line of sight its outline says how far it may be
        std_m = wrist.std_px * pose.position_m[2] / frame.left.camera.K[0, 0]
        information += (1.0 - float(bent @ ray) ** 2) * (model.reach_m / std_m) ** 2
    by_bend = np.concatenate([model.reach_m * bent, cross(pose.axis, bent)])
    return replace(pose, covariance=pose.covariance + np.outer(by_bend, by_bend) / information)


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
        rolls_rad = [0.0 if _bends_aside(frame.left.shaft) else 0.5 * np.pi]
    elif robot.T_camera_base is None:
        rolls_rad = [2.0 * np.pi * turn / ROLL_COUNT for turn in range(ROLL_COUNT)]
    if isinstance(robot, Failure) or robot.T_camera_base is None:
        robot = RobotState(chain, frame.stamp_ns, model.q, firsts[0] @ inverse(model.T_base_shaft))
        error["camera_base_std_rad"] = OPEN_RAD
    kalman = KinematicErrorFilter(chain, KinematicError(**error), profile.settings.filter)
    kalman.predict(robot)
    covariance = np.diag([START_STD_M**2] * 3 + [START_STD_RAD**2] * 3)
    rolls = [make_transform(rotation_of([0.0, 0.0, angle]), np.zeros(3)) for angle in rolls_rad]
    poses = [T @ roll @ model.T_shaft_tool for T in firsts for roll in rolls]
    kalman.begin([(ToolPose(T, covariance, T[:3, 0]), measured) for T in poses])
    gating = kalman.update(measured)
    if not gating:
        return Failure("the fit does not converge")
    contradiction = kalman.consistency.contradiction
    outliers = [one for one in gating if not one.is_accepted]
    share = sum(one.degrees_of_freedom for one in outliers) / sum(one.degrees_of_freedom for one in gating)
    if share > MAX_OUTLIER_SHARE or not is_confirmed(gating, has_joints=not isinstance(frame.robot, Failure)):
        names = ", ".join(one.name for one in outliers)
        contradiction = f"{names} {'does' if len(outliers) == 1 else 'do'} not fit the rest"
    pose = kalman.tool_pose()
    if not contradiction and (away_m := kalman.rival_m(pose)):
        contradiction = f"another place, {1e3 * away_m:.0f} mm away, is as likely"
    hinge = kalman.hinge(model.axis.link, model.hinge_m)
    pose = replace(pose, hinge=hinge, jaw_scale=jaw_scale(kalman, frame.arm))
    # A marker is at the tool's origin itself, however the wrist is bent.
    if isinstance(frame.robot, Failure) and frame.left.distal_marker is None:
        pose = _with_other_bend(pose, frame, model)
    return ImagePose(pose, tuple(one.name for one in gating if one.is_accepted), contradiction, gating)


def is_confirmed(gating: Sequence[GatingResult], has_joints: bool) -> bool:
    """Whether the inliers are right and not the outliers, by what agrees with them.

    Without joints an inlier may be another instrument's, or a shadow's; but a disparity and three sides outvote a side.
    With joints, too, sides that a disparity and one of them contradict may be those of a wrist, which is narrower.
    Depth cues contest each other by where each of them leads.
    """
    accepted = {one.name for one in gating if one.is_accepted}
    outliers = {one.name for one in gating} - accepted
    sides = [name for name in outliers if "edge" in name]
    if has_joints:
        return not (sides and DISPARITY in outliers)
    outliers -= set(DEPTH_CUES)
    if len(outliers) == len(sides) == 1:
        return DISPARITY in accepted and sum("edge" in name for name in accepted) >= 3
    return not outliers

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
from svmdist.estimation.instrument.shaft_detection import wrist_marker
from svmdist.estimation.instrument.shaft_model import ShaftModel, first_shafts
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.robot import KinematicError
from svmdist.results import Failure, ToolPose
from svmdist.transforms import Array, inverse, make_transform, rotation_of
from svmdist.vision.stereo import RectifiedPair

OPEN_M = 0.3  # standard deviation of the base's place: a scene is no larger
OPEN_RAD = 3.0  # of its rotation, where nothing tells it
START_STD_M, START_STD_RAD = 5e-3, 0.1  # of a start, which is where to linearise and no more
ROLL_COUNT = 4  # starts about a shaft whose rotation is not known
MAX_REFUSED_SHARE = 1.0 / 3.0  # of what was measured: with more refused nothing tells which is right


@dataclass(frozen=True, slots=True)
class ImagePose:
    """The tool's pose with its wrist's hinge, the measurements that carry it, any doubt, and what was judged."""

    pose: ToolPose
    used: tuple[str, ...]
    doubt: str
    gating: tuple[GatingResult, ...] = ()

    @property
    def holds_depth(self) -> bool:
        """Whether its depth is held: by the shaft's whole outline, or a marker's size or disparity beside it."""
        if any(judged.is_accepted and judged.name in ("size", DISPARITY) for judged in self.gating):
            return True
        return all(judged.is_accepted for judged in self.gating if judged.source == "shaft")

    @property
    def is_by_right_view(self) -> bool:
        """Whether anything in the right view carries it."""
        return any(name == DISPARITY or name.startswith("right ") for name in self.used)


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
    return _located(frame, list(firsts), of_images(frame, None, both_views=False), model)


def pose_by_pair(frame: Frame, pair: RectifiedPair) -> ImagePose | Failure:
    """The tool by both views; or why it cannot be measured."""
    arm, left, right, seen = frame.arm, frame.left, frame.right, frame.scene.observation.right
    instrument = arm.profile.instrument
    assert instrument is not None
    assert right is not None  # the pair has one
    assert seen is not None
    if left.region is None and right.region is None and (left.shaft.contours or right.shaft.contours):
        # What hides the distal part ends the shaft, too: its end is then anywhere.
        return Failure("the instrument's distal part is hidden in both views")
    model = ShaftModel.of(frame.robot, arm.required_chain, instrument)
    markers, tool_m, expected = pair_markers(frame, pair), None, None
    if isinstance(markers, MarkerPair):
        tool_m, expected = pair.point(markers.left.pixel, markers.disparity_px)[0], markers.expected
    firsts = list(_first_places(left, right, tool_m, model, inverse(seen.T_left_right)))
    return _located(frame, firsts, of_images(frame, expected, markers, both_views=True), model)


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
    if not judged:
        return Failure("the fit does not converge")
    doubt = kalman.consistency.doubt
    # Without joints nothing but the other edges says which of them is wrong: it may be those of another instrument.
    for source in ("", "shaft") if isinstance(frame.robot, Failure) else ("",):
        told = [result for result in judged if source in ("", result.source)]
        refused = [result for result in told if not result.is_accepted]
        share = 0.0 if source else MAX_REFUSED_SHARE * sum(result.degrees_of_freedom for result in told)
        if sum(result.degrees_of_freedom for result in refused) > share:
            doubt = f"{', '.join(result.name for result in refused)} do not fit the rest"
    axis, hinge_m = frame.arm.shaft_axis, frame.arm.hinge_m
    assert axis is not None  # the model has its frame
    assert hinge_m is not None
    hinge = kalman.hinge(axis.link, hinge_m)
    pose = replace(kalman.tool_pose(), hinge=hinge, jaw_scale=jaw_scale(kalman, frame.arm))
    used = tuple(one.name for one in judged if one.is_accepted)
    found = ImagePose(pose, used, doubt, judged)
    if not doubt and not found.holds_depth:
        sides = ", ".join(one.name for one in judged if one.source == "shaft" and not one.is_accepted)
        found = replace(found, doubt=f"nothing holds the depth: {sides} refused")
    return found

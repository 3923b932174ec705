"""The method `fused`: the filter over time, with every factor of both views, begun where the images say."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from svmdist.estimation.distances import measured, with_tissue, with_tool
from svmdist.estimation.frame import Arm, Frame
from svmdist.estimation.frame_methods import certain, tool_from_tag
from svmdist.estimation.instrument.consistency import GatingResult, chi_square_bound, with_detections
from svmdist.estimation.instrument.distal_marker import Expected, MarkerPair, pair_markers
from svmdist.estimation.instrument.factors import jaw_scale, of_images, tag
from svmdist.estimation.instrument.kinematic_error_filter import KinematicErrorFilter, Start, pose_distance
from svmdist.estimation.instrument.measurement import LinkMeasurement
from svmdist.estimation.tissue.detection import require_tissue
from svmdist.estimation.tissue.tracking import TissueTracker, at_height, measure_height
from svmdist.results import Failure, FrameResult, ToolEstimate, ToolPose
from svmdist.samples import JointSample, Rejection, Status

MAX_IMAGE_STD_M = 0.008  # a pose by images that is less certain is no place to begin
LOCATED_STD_M = 0.01  # a prediction as certain that agrees with the images needs no start by them
MAX_CONTRADICTIONS = 3  # frames in a row: what hides an instrument misleads one or two
YOUNG_S = 2.0  # how long a filter that has begun anew is held to be hardly surer than the images
SURER = 0.5  # of the variance it began with: an image of less begins anew what is as young


class FusedEstimator:
    """`--method fused`: keeps the filter, and the tissue's pose, between frames.

    Images alone say where to linearise at first, and where to begin anew when they contradict the prediction for some
    frames, or as many as agreed before: the filter then takes the start that prior and measurements make most probable.
    """

    def __init__(self, arm: Arm) -> None:
        profile = arm.profile
        self._arm, self._chain = arm, arm.required_chain
        # That of a frame's arm may be widened by what checks say.
        self._profile_tissue = require_tissue(profile)
        self._tissue_tracker = TissueTracker(profile.settings.tissue)
        self._filter = KinematicErrorFilter(self._chain, profile.kinematic_error, profile.settings.filter)
        self._has_sizes = profile.segmentation.shaft is not None and profile.instrument is not None
        self._correlated = profile.settings.fused.lasting_share
        self._contradictions, self._agreed, self._has_agreed = 0, 0, False
        self._begun_ns, self._image_variance_m2 = -np.inf, 0.0  # when an image located it, and how surely

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; a result needs joints and a tissue seen before, and nothing of this image."""
        tissue, result = self._tissue_tracker.add(frame.scene.tissue), with_tissue(frame)
        robot = frame.robot_in_camera
        if isinstance(robot, Failure):
            return result.rejected(Status.NO_JOINTS, robot.reason)

        # Predict by the joints, begin anew where the images say so, correct by what they show.
        kalman = self._filter
        kalman.predict(robot)
        by_tag = list(self._tag(frame, self._start(frame) or kalman.tool_pose()))
        shown = self._of_images(frame)
        # A short segment at the border, a wrist or a shadow has an outline, too: alone it counts where it holds a pose.
        is_marked = any(view is not None and view.distal_marker is not None for view in (frame.left, frame.right))
        if shown and not (by_tag or is_marked) and self._image_pose(frame) is None:
            shown = []
        gating = kalman.update([*shown, *by_tag])
        said = self._watch(frame, gating)
        height = None if tissue is None else measure_height(self._profile_tissue, tissue, frame, kalman)

        # The tool with the error found, and the distances from there.
        region, consistency = frame.left.region, kalman.consistency
        every, accepted = gating if height is None else (*gating, height), sum(one.is_accepted for one in gating)
        outliers = [one.name for one in every if not one.is_accepted]
        details = [f"refused: {', '.join(outliers)}"] if outliers else []
        if not accepted:
            details.append("joints alone" if gating else "nothing of the tool detected: joints alone")
        result = replace(with_detections(result, every), detail="; ".join(details), consistency=consistency.ratio)
        result = result.with_image(
            tool_area_px=region.area_px if region else None, match_count=len(gating), inlier_count=accepted
        )
        joints = JointSample(frame.stamp_ns, self._chain.joint_names, kalman.corrected_joints())
        pose = replace(kalman.tool_pose(), jaw_scale=jaw_scale(kalman, self._arm))
        tool = ToolEstimate(pose, joints, frame.left.has_plate)
        if tissue is None:
            return with_tool(result, frame, tool).rejected(Status.NO_TISSUE, "no tissue, in this frame or before")
        corrected, cross_covariance = at_height(self._profile_tissue, tissue, frame, kalman)
        found = measured(result, frame, tool, corrected, cross_covariance)
        said = said or consistency.contradiction if found.status in (Status.OK, Status.INCONSISTENT) else ""
        return found.rejected(Status.INCONSISTENT, said) if said else found

    def _image_pose(self, frame: Frame) -> ToolPose | None:
        """The tool by the images alone: by both views, or by the shaft in the left one; None without either."""
        if not self._has_sizes:
            return None
        found = certain(frame, frame.pair_pose, MAX_IMAGE_STD_M)
        if isinstance(found, Rejection):
            found = certain(frame, frame.shaft_pose, MAX_IMAGE_STD_M)
        return None if isinstance(found, Rejection) else found.pose

    def _start(self, frame: Frame) -> ToolPose | None:
        """Begin anew where it is due, and give the pose to linearise at; None where the filter goes on."""
        kalman, is_first = self._filter, self._begun_ns == -np.inf
        # What only the first frame supports is as likely wrong as the second, which contradicts it.
        is_due = is_first or self._contradictions >= min(MAX_CONTRADICTIONS, max(self._agreed, 1))
        image = self._image_pose(frame) if is_due or self._age_s(frame) < YOUNG_S else None
        if image is None:
            return None
        variance_m2 = float(np.trace(image.position_covariance))
        # What it began with may be a short segment at the border, whose errors it would keep.
        if not (is_due or variance_m2 < SURER * self._image_variance_m2):
            return None
        self._contradictions, self._agreed, self._has_agreed = 0, 0, False
        self._begun_ns, self._image_variance_m2 = frame.stamp_ns, variance_m2
        # What was measured before may have led there already.
        predicted = kalman.tool_pose()
        is_sure = is_first and predicted.position_std_m < LOCATED_STD_M
        if is_sure and pose_distance(image, predicted) <= chi_square_bound(6):
            return None
        poses, fit = [image], frame.shaft_pose
        if not isinstance(fit, Failure) and fit.pose is not image:
            poses.append(fit.pose)
        if frame.tag is not None:
            poses.append(tool_from_tag(self._arm, frame.left.camera, frame.tag, kalman.state.robot))
        nominal = self._arm.nominal_tool(kalman.state.robot)
        seen = self._of_images(frame)
        starts: list[Start] = [(pose, [*seen, *self._tag(frame, pose)]) for pose in poses]
        starts.append((None, [*seen, *self._tag(frame, nominal)]))
        return starts[kalman.begin(starts)][0] or kalman.tool_pose()

    def _of_images(self, frame: Frame) -> list[LinkMeasurement]:
        """The factors of both views, but for the tag."""
        # Sizes are compared where disparity puts the marker: a false start would agree with what it makes of them.
        pair = frame.scene.stereo_pair
        markers = None if isinstance(pair, Failure) else pair_markers(frame, pair)
        expected = markers.expected if isinstance(markers, MarkerPair) else Expected.of(self._filter.tool_pose())
        return of_images(frame, expected, markers, both_views=True, correlated_share=self._correlated, is_tracked=True)

    def _tag(self, frame: Frame, predicted: ToolPose) -> Iterator[LinkMeasurement]:
        """The tag's factor, disambiguated by a predicted pose."""
        return tag(frame, self._filter.state.robot, predicted, self._correlated)

    def _age_s(self, frame: Frame) -> float:
        """Since the filter began by an image; infinite where it did not."""
        return (frame.stamp_ns - self._begun_ns) / 1e9

    def _watch(self, frame: Frame, gating: Sequence[GatingResult]) -> str:
        """Why the images contradict the prediction; empty where they do not."""
        consistency, age = self._filter.consistency, self._age_s(frame)
        consistency.excess = 1.0
        # Until inliers have been seen for a while, a filter that has begun anew is hardly surer than the images.
        if age < YOUNG_S:
            own_m2 = float(np.trace(self._filter.tool_pose().position_covariance)) / consistency.widening
            more = max(self._image_variance_m2 / own_m2 - 1.0, 0.0)
            consistency.excess = 1.0 + (1.0 - age / YOUNG_S) * more
        is_off = self._filter.has_jumped
        if not is_off and not consistency.contradiction:
            # An image that shows nothing agrees with anything.
            if any(one.is_accepted for one in gating):
                self._contradictions, self._has_agreed = 0, self._has_agreed or age >= YOUNG_S
                self._agreed += 1
            return ""
        # What never agreed would begin anew for ever.
        self._contradictions += is_off or self._has_agreed
        return "the images contradict the prediction, as if the camera had moved" if is_off else ""

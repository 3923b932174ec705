"""Both cameras: shaft and disparity give the tool, matching and alignment the tissue's surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from svmdist.estimation.arm import Arm
from svmdist.estimation.detection.stereo_match import match_distal_marker
from svmdist.estimation.detection.stereo_surface import StereoSurface
from svmdist.estimation.distances import measured
from svmdist.estimation.filter.nominal import nominal_tool
from svmdist.estimation.first_step import with_tissue
from svmdist.estimation.frame import Frame, Needs
from svmdist.estimation.instrument.stereo_pose import (
    nominal_orientation_pose,
    refine_depth,
    with_calibration,
)
from svmdist.estimation.tissue.pose import require_tissue
from svmdist.geometry.surfaces import Cloud
from svmdist.results import Failure, FrameResult, ToolEstimate, ToolPose
from svmdist.samples import Rejection, Status
from svmdist.transforms import inverse
from svmdist.vision.rectified import RectifiedPair


class StereoEstimator:
    """`--method stereo`. Keeps between frames whether it saw the tag's plate, and nothing else."""

    name = "stereo"
    keeps_state = True

    def __init__(self, arm: Arm) -> None:
        profile = arm.profile
        require_tissue(profile)
        self._chain = arm.required_chain
        self._profile = profile
        self._uses_shaft = profile.segmentation.shaft is not None and profile.instrument is not None
        self._has_plate = False
        tool = ("distal_marker", "right_distal_marker", *(("shaft_fit",) if self._uses_shaft else ()))
        self.needs = Needs(scene=("tissue", "stereo_surface", "tags"), tool=tool, right_view=True)

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; a frame that cannot be measured says why."""
        # The tissue's outline in the left view, and the pair's geometry.
        result, tissue, pair = with_tissue(frame), frame.scene.tissue, frame.scene.stereo_pair
        if tissue is None or tissue.pose is None:
            return result
        if isinstance(pair, Failure):
            return result.rejected(Status.NO_STEREO, pair.reason)

        # The tool: its distal marker in both views, and the shaft's direction.
        pose = self._tool(frame, pair)
        if isinstance(pose, Rejection):
            return result.rejected(pose.status, pose.detail)

        # The tissue's surface, and the distances. The surface has its own error in place of the dome's.
        surface = frame.scene.stereo_surface
        if surface is None:
            return result.rejected(Status.NO_STEREO, "the views do not agree on the tissue's surface")
        std_m = float(np.hypot(surface.std_m, self._calibration_std_m(surface, frame)))
        seen = replace(tissue.pose, surface=Cloud(surface.points_m), surface_std_m=std_m, dome=None)
        return measured(result, frame, ToolEstimate(pose, frame.joints, self._has_plate), seen)

    def _calibration_std_m(self, surface: StereoSurface, frame: Frame) -> float:
        """How far all of the surface may be off in depth by focal length, baseline and the right camera's rotation."""
        right = frame.scene.observation.right
        assert right is not None  # the surface is of both views
        at_m = np.median(surface.points_m, 0)
        T_right_left = inverse(right.T_left_right)
        right_m = T_right_left[:3, :3] @ at_m + T_right_left[:3, 3]
        _, slope = right.camera.project_with_derivative(right_m)
        disparity_px = float(frame.left.camera.K[0, 0] * np.linalg.norm(T_right_left[:3, 3]) / at_m[2])
        biases = frame.arm.deviations.of_disparity(right_m, slope[0], np.array(disparity_px), T_right_left)
        variance_px2 = sum(float(np.sum(bias.jacobian**2)) for bias in biases)
        return float(at_m[2] / disparity_px * np.sqrt(variance_px2))

    def _tool(self, frame: Frame, pair: RectifiedPair) -> ToolPose | Rejection:
        """The shaft's pose corrected by the disparity; else the triangulated point, turned by nominal kinematics."""
        instrument, settings = self._profile.instrument, self._profile.settings.stereo
        radius_m = instrument.knuckle_radius_m if instrument else None
        left, right = frame.tool.distal_marker, frame.tool.right_distal_marker
        match = match_distal_marker(left, right, pair, radius_m, frame.left.camera, settings)
        if isinstance(match, Failure):
            return Rejection(frame.stamp_ns, Status.NO_INSTRUMENT, match.reason)
        seen = frame.scene.observation.right
        assert seen is not None  # the pair has one
        match = with_calibration(match, seen, pair, frame.arm.deviations)
        if self._uses_shaft:
            self._has_plate |= frame.tool.tag_corners_px is not None
            fit = frame.tool.shaft_fit
            pose = None if isinstance(fit, Failure) else refine_depth(fit.pose, match, pair, settings)
            if pose is not None:
                return pose
        robot = frame.robot_in_camera
        if isinstance(robot, Failure):
            return Rejection(frame.stamp_ns, Status.NO_JOINTS, robot.reason)
        nominal = nominal_tool(self._chain, self._profile.kinematic_error, robot)
        return nominal_orientation_pose(match, pair, nominal)

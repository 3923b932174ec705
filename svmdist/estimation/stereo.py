"""Both cameras: shaft and disparity give the tool, matching and alignment the tissue's surface."""

from __future__ import annotations

from dataclasses import replace

from svmdist.estimation.arm import Arm
from svmdist.estimation.detection.stereo_match import match_distal_marker
from svmdist.estimation.distances import measured
from svmdist.estimation.filter.nominal import nominal_tool
from svmdist.estimation.first_step import with_tissue
from svmdist.estimation.frame import Frame, Needs
from svmdist.estimation.instrument.stereo_pose import nominal_orientation_pose, refine_depth
from svmdist.estimation.tissue.pose import require_tissue
from svmdist.geometry.surfaces import Cloud
from svmdist.results import Failure, FrameResult, ToolEstimate, ToolPose
from svmdist.samples import Rejection, Status
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
        seen = replace(tissue.pose, surface=Cloud(surface.points_m), surface_std_m=surface.std_m, dome=None)
        return measured(result, frame, ToolEstimate(pose, frame.joints, self._has_plate), seen)

    def _tool(self, frame: Frame, pair: RectifiedPair) -> ToolPose | Rejection:
        """The shaft's pose corrected by the disparity; else the triangulated point, turned by nominal kinematics."""
        instrument, settings = self._profile.instrument, self._profile.settings.stereo
        radius_m = instrument.knuckle_radius_m if instrument else None
        left, right = frame.tool.distal_marker, frame.tool.right_distal_marker
        match = match_distal_marker(left, right, pair, radius_m, frame.left.camera, settings)
        if isinstance(match, Failure):
            return Rejection(frame.stamp_ns, Status.NO_INSTRUMENT, match.reason)
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

"""Kinematics corrected by what the camera sees: a Kalman filter over the errors of nominal kinematics.

Between detections the joints carry the pose, with the error last found: occlusion and rejected frames cost
certainty, not results.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from svmdist.estimation.arm import Arm
from svmdist.estimation.distances import measured, with_tool
from svmdist.estimation.filter.kinematic_error_filter import KinematicErrorFilter
from svmdist.estimation.first_step import with_tissue
from svmdist.estimation.frame import Frame, Needs
from svmdist.estimation.gate import GatingResult
from svmdist.estimation.measurements import measurements
from svmdist.estimation.tissue.following import FollowedTissue
from svmdist.results import Failure, FrameResult, ToolEstimate
from svmdist.samples import JointSample, Status


class FusedEstimator:
    """`--method fused`: keeps the filter, and the tissue's pose and shape, between frames."""

    name = "fused"
    keeps_state = True
    needs = Needs(
        scene=("tissue", "tags", "stereo_surface"),
        tool=("distal_marker", "right_distal_marker", "shaft"),
        right_view=True,
    )

    def __init__(self, arm: Arm) -> None:
        settings = arm.profile.settings
        self._chain = arm.required_chain
        self._followed = FollowedTissue(arm)
        self._filter = KinematicErrorFilter(self._chain, arm.profile.kinematic_error, settings.filter)
        self._has_plate = False

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; a result needs joints and a tissue seen before, and nothing of this image."""
        tissue, result = self._followed.see(frame), with_tissue(frame)
        robot = frame.robot_in_camera
        if isinstance(robot, Failure):
            return result.rejected(Status.NO_JOINTS, robot.reason)

        # Predict by the joints, correct by what the images show.
        self._filter.predict(robot)
        seen = measurements(frame, self._filter.robot, self._filter.tool_pose())
        gating = self._filter.update(seen)
        height = self._followed.measure_height(frame, self._filter)

        # The tool with the error found, and the distances from there.
        self._has_plate |= frame.tool.tag_corners_px is not None
        region, consistency = frame.tool.region, self._filter.consistency
        result = replace(result, detail=_detail(gating, height), consistency=consistency.ratio).with_image(
            tool_area_px=region.area_px if region else None,
            match_count=len(gating),
            inlier_count=sum(judged.is_accepted for judged in gating),
        )
        joints = JointSample(frame.stamp_ns, self._chain.joint_names, self._filter.corrected_joints())
        tool = ToolEstimate(self._filter.tool_pose(), joints, self._has_plate)
        if tissue is None:
            return with_tool(result, frame, tool).rejected(
                Status.NO_TISSUE, "no tissue, in this frame or before"
            )
        placed, coupling = self._followed.placed(tissue, frame, self._filter)
        found = measured(result, frame, tool, placed, coupling)
        doubt = consistency.doubt if found.measured else ""
        return found.untrusted(doubt) if doubt else found


def _detail(gating: Sequence[GatingResult], height: GatingResult | None) -> str:
    """What was not taken for true, for a person."""
    refused = [judged.name for judged in gating if not judged.is_accepted]
    alone = len(refused) == len(gating)
    if height is not None and not height.is_accepted:
        refused.append(height.name)
    said = f"refused: {', '.join(refused)}" if refused else ""
    if alone:
        how = "joints alone" if gating else "nothing of the tool detected: joints alone"
        return f"{said}; {how}" if said else how
    return said

"""Kinematics corrected by what the camera sees: a Kalman filter over the error of what the robot believes.

Between sights the joints carry the pose, with the error last found: occlusion and rejected frames cost
certainty, not rows.
"""

from __future__ import annotations

from dataclasses import replace

from svmdist.estimation.filter.kinematic_error_filter import KinematicErrorFilter
from svmdist.estimation.filtering.robot_scene import RobotScene
from svmdist.estimation.filtering.tool_sights import ToolSights
from svmdist.profile import Profile
from svmdist.samples import Estimate, JointSample, Observation
from svmdist.vision.segmentation.segmenter import Segmenter


class FusedEstimator:
    """`--method fused`: keeps the filter, and the tissue's place and shape, between frames."""

    name = "fused"

    def __init__(self, profile: Profile, segmenter: Segmenter | None = None) -> None:
        self._scene = RobotScene(profile, segmenter, sees_shape=True)
        self._sights = ToolSights(profile, self._scene.chain, self._scene.segmenter)
        self._filter = KinematicErrorFilter(self._scene.chain, profile.kinematic_error)

    def estimate(self, observation: Observation) -> Estimate:
        """Measure one frame; a row needs joints and a tissue seen before, and nothing of this image."""
        look = self._scene.look(observation)
        if look.belief is None:
            return look.row

        # Predict by the joints, correct by what the image gives.
        self._filter.predict(look.belief)
        region, seen = self._sights.see(observation, look, self._filter.tool_pose())
        gating = self._filter.update(seen)

        row = replace(
            look.row,
            tool_area_px=region.area_px if region else None,
            match_count=len(gating),
            inlier_count=sum(result.is_accepted for result in gating),
            detail="" if gating else "nothing of the tool seen: joints alone",
        )
        joints = JointSample(
            observation.stamp_ns, self._scene.chain.joint_names, self._filter.corrected_joints()
        )
        pose, camera = self._filter.tool_pose(), observation.camera
        return self._scene.finish(row, pose, look.tissue, camera, joints, self._sights.has_seen_tag)

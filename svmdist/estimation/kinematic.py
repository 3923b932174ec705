"""The robot's word for it: the tool where forward kinematics put it, the tissue from the image.

As bad as joints and camera-to-base transform are; the standard deviations say how bad that may be.
"""

from __future__ import annotations

from svmdist.estimation.filter.nominal import nominal_tool
from svmdist.estimation.filtering.robot_scene import RobotScene
from svmdist.profile import Profile
from svmdist.samples import Estimate, Observation
from svmdist.vision.segmentation.segmenter import Segmenter


class KinematicEstimator:
    """`--method kinematic`: nothing of the tool is taken from the image."""

    name = "kinematic"

    def __init__(self, profile: Profile, segmenter: Segmenter | None = None) -> None:
        self._scene = RobotScene(profile, segmenter)

    def estimate(self, observation: Observation) -> Estimate:
        """Measure one frame; without joints or a camera-to-base transform there is nothing to say."""
        look = self._scene.look(observation)
        if look.belief is None or look.tissue is None or observation.joints is None:
            return look.row
        error = self._scene.profile.kinematic_error
        tool = nominal_tool(self._scene.chain, error, look.belief)
        return self._scene.finish(look.row, tool, look.tissue, observation.camera, observation.joints)

"""Nominal kinematics: the tool where forward kinematics put it, the tissue from the image.

As wrong as joints and camera-to-base transform are; the standard deviations say how wrong that may be.
"""

from __future__ import annotations

from svmdist.estimation.arm import Arm
from svmdist.estimation.distances import measured
from svmdist.estimation.filter.nominal import nominal_tool
from svmdist.estimation.first_step import tracked_tissue, with_tissue
from svmdist.estimation.frame import Frame, Needs
from svmdist.estimation.tissue.pose import require_tissue
from svmdist.estimation.tissue.tracking import TissueTracker
from svmdist.results import Failure, FrameResult, ToolEstimate
from svmdist.samples import Status


class KinematicEstimator:
    """`--method kinematic`: nothing of the tool is taken from the image. Keeps the tissue's pose between frames."""

    name = "kinematic"
    keeps_state = True
    needs = Needs(scene=("tissue",))

    def __init__(self, arm: Arm) -> None:
        require_tissue(arm.profile)
        self._chain = arm.required_chain
        self._error = arm.profile.kinematic_error
        self._tissue = TissueTracker(arm.profile.settings.tissue)

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; without joints or a camera-to-base transform there is nothing to say."""
        tissue, result = tracked_tissue(frame, self._tissue), with_tissue(frame)
        robot = frame.robot_in_camera
        if isinstance(robot, Failure):
            return result.rejected(Status.NO_JOINTS, robot.reason)
        if tissue is None:
            return result
        tool = ToolEstimate(nominal_tool(self._chain, self._error, robot), frame.joints)
        return measured(result.rejected(Status.OK), frame, tool, tissue)

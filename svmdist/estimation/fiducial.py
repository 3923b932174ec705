"""The tag on the instrument: six degrees of freedom from one image, and through the wrist to the tool."""

from __future__ import annotations

import numpy as np

from svmdist.errors import ProfileError
from svmdist.estimation.arm import Arm
from svmdist.estimation.distances import measured
from svmdist.estimation.first_step import with_tissue
from svmdist.estimation.frame import Frame, Needs
from svmdist.estimation.instrument.tool_from_tag import tool_from_tag
from svmdist.estimation.tissue.pose import require_tissue
from svmdist.results import Failure, FrameResult, ToolEstimate
from svmdist.samples import Status


class FiducialEstimator:
    """`--method fiducial`. Keeps no state between frames."""

    name = "fiducial"
    keeps_state = False
    needs = Needs(scene=("tissue", "tags"), tool=("tag",))

    def __init__(self, arm: Arm) -> None:
        profile = arm.profile
        if profile.fiducial is None or profile.robot is None:
            raise ProfileError(
                f"profile {profile.name} has no {'[fiducial]' if profile.robot else '[robot]'}: the method"
                " fiducial needs the tag, the link that carries it, and the chain from there to the tool"
            )
        require_tissue(profile)
        self._fiducial = profile.fiducial
        self._error = profile.kinematic_error

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; a frame that cannot be measured says why."""
        # The tissue, on the plane that it lies on.
        result, tissue = with_tissue(frame), frame.scene.tissue
        if tissue is None or tissue.pose is None:
            return result

        # The tag: corners, then both poses that they allow, and the one of them that is true.
        if frame.tool.tag_corners_px is None:
            return result.rejected(Status.NO_FIDUCIAL)
        if isinstance(frame.robot, Failure):
            return result.rejected(Status.NO_JOINTS, frame.robot.reason)
        tag = frame.tool.tag
        if tag is None:
            return result.rejected(Status.AMBIGUOUS_POSE)

        # Through mounting and wrist to the tool, and the distances from there.
        focal_px = np.diag(frame.left.camera.K)[:2]
        pose = tool_from_tag(tag, self._fiducial, frame.robot, self._error, frame.arm.deviations, focal_px)
        return measured(result, frame, ToolEstimate(pose, frame.joints, has_plate=True), tissue.pose)

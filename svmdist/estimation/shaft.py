"""Markerless, one camera: the shaft's silhouette gives its axis in 3D, rim and distal marker the place along it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from svmdist.errors import ProfileError
from svmdist.estimation.arm import Arm
from svmdist.estimation.distances import measured
from svmdist.estimation.first_step import with_tissue
from svmdist.estimation.frame import Frame, Needs
from svmdist.estimation.tissue.pose import require_tissue
from svmdist.results import Failure, FrameResult, ToolEstimate
from svmdist.samples import Status

if TYPE_CHECKING:  # the detection is imported when it is first asked for
    from svmdist.estimation.detection.shaft import ShaftDetection


class ShaftEstimator:
    """`--method shaft`. Keeps between frames whether it saw the tag's plate, and nothing else."""

    name = "shaft"
    keeps_state = True
    needs = Needs(scene=("tissue", "tags"), tool=("shaft_fit",))

    def __init__(self, arm: Arm) -> None:
        profile = arm.profile
        if profile.segmentation.shaft is None or profile.robot is None or profile.instrument is None:
            raise ProfileError(
                f"profile {profile.name} cannot serve the method shaft: it needs [segmentation.shaft], [robot] and"
                " [instrument]"
            )
        require_tissue(profile)
        self._settings = profile.settings.shaft
        self._has_plate = False

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; a frame that cannot be measured says why."""
        # The tissue, on the plane that it lies on.
        result, tissue = with_tissue(frame), frame.scene.tissue
        if tissue is None or tissue.pose is None:
            return result

        # The shaft's edges and end, the distal marker, and the pose that fits them through the wrist.
        self._has_plate |= frame.tool.tag_corners_px is not None
        fit = frame.tool.shaft_fit
        if isinstance(fit, Failure):
            return result.rejected(_status(frame.tool.shaft), fit.reason)
        std_m = float(np.sqrt(np.linalg.eigvalsh(fit.pose.position_covariance)[-1]))
        farther = max(1.0, float(np.linalg.norm(fit.pose.position_m)) / self._settings.near_m)
        if not std_m <= farther * self._settings.max_position_std_m:
            detail = f"the position is uncertain by {std_m * 1e3:.1f} mm"
            return result.rejected(Status.UNCERTAIN, detail)
        return measured(result, frame, ToolEstimate(fit.pose, frame.joints, self._has_plate), tissue.pose)


def _status(shaft: ShaftDetection) -> Status:
    """Why there is no pose: both edges were found, and do not tell one; or there is no instrument with two of them."""
    return Status.UNCERTAIN if len(shaft.contours) == 2 else Status.NO_INSTRUMENT

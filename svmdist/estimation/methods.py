"""The estimators by name, behind one interface."""

from __future__ import annotations

from typing import Protocol

from svmdist.errors import UsageError, did_you_mean
from svmdist.estimation.frame import Frame, Needs
from svmdist.estimation.plane_mapping import PlaneMapping
from svmdist.estimation.scene import Arm
from svmdist.results import FrameResult


class Estimator(Protocol):
    """What every method is: a name, the detections that it takes, and one frame to one result."""

    @property
    def name(self) -> str:
        """The method's name on the command line and in results."""

    @property
    def needs(self) -> Needs:
        """Detections that it always asks for, so that they may be computed ahead."""

    @property
    def keeps_state(self) -> bool:
        """Whether a result depends on earlier frames; without state, frames may be measured in any order."""

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame. A frame that cannot be measured is an outcome, not an exception."""


PLANAR_METHODS = ("overlay", "centroid")
"""Methods of the paper's plane: they need the mapping from pixels to it."""

SPATIAL_METHODS = ("fiducial", "shaft", "stereo", "kinematic", "fused")
"""Methods that measure in 3D."""

METHODS = (*PLANAR_METHODS, *SPATIAL_METHODS)


def make_estimator(method: str, arm: Arm, mapping: PlaneMapping | None = None) -> Estimator:
    """Make the estimator of that name; raises UsageError that lists the names.

    A planar method needs a mapping; one in 3D takes none. Only the modules of the method are imported.
    """
    if method not in METHODS:
        raise UsageError(f"no method {method}: {did_you_mean(method, METHODS)}")
    if method in PLANAR_METHODS and mapping is None:
        raise UsageError(f"method {method} is planar: it needs a calibration")
    return _made(method, arm, mapping)


def _made(method: str, arm: Arm, mapping: PlaneMapping | None) -> Estimator:  # noqa: PLR0911
    match method, mapping:
        case "overlay", PlaneMapping():
            from svmdist.estimation.planar import OverlayEstimator

            return OverlayEstimator(arm.profile, mapping)
        case "centroid", PlaneMapping():
            from svmdist.estimation.planar import CentroidEstimator

            return CentroidEstimator(mapping)
        case "fiducial", _:
            from svmdist.estimation.one_view import FiducialEstimator

            return FiducialEstimator(arm)
        case "shaft", _:
            from svmdist.estimation.one_view import ShaftEstimator

            return ShaftEstimator(arm)
        case "stereo", _:
            from svmdist.estimation.stereo import StereoEstimator

            return StereoEstimator(arm)
        case "kinematic", _:
            from svmdist.estimation.one_view import KinematicEstimator

            return KinematicEstimator(arm)
        case _:
            from svmdist.estimation.fused import FusedEstimator

            return FusedEstimator(arm)

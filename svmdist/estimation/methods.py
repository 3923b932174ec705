"""The estimators by name, behind one interface."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from svmdist.errors import UsageError, did_you_mean
from svmdist.estimation.centroid import CentroidEstimator
from svmdist.estimation.fiducial import FiducialEstimator
from svmdist.estimation.fused import FusedEstimator
from svmdist.estimation.kinematic import KinematicEstimator
from svmdist.estimation.overlay import OverlayEstimator
from svmdist.estimation.planar.equations import PlaneMapping
from svmdist.estimation.shaft import ShaftEstimator
from svmdist.estimation.stereo import StereoEstimator
from svmdist.profile import Profile
from svmdist.samples import Estimate, Observation
from svmdist.vision.segmentation.segmenter import Segmenter


class Estimator(Protocol):
    """What every method is: a name, and one observation to one estimate."""

    @property
    def name(self) -> str:
        """The method's name on the command line and in results."""

    def estimate(self, observation: Observation) -> Estimate:
        """Measure one frame. A frame that cannot be measured is an outcome, not an exception."""


PLANAR_METHODS: dict[str, Callable[[Profile, PlaneMapping, Segmenter | None], Estimator]] = {
    "overlay": OverlayEstimator,
    "centroid": CentroidEstimator,
}
"""Methods of the paper's plane: they need the mapping from pixels to it."""

SPATIAL_METHODS: dict[str, Callable[[Profile, Segmenter | None], Estimator]] = {
    "fiducial": FiducialEstimator,
    "shaft": ShaftEstimator,
    "stereo": StereoEstimator,
    "kinematic": KinematicEstimator,
    "fused": FusedEstimator,
}
"""Methods that measure in 3D."""

METHODS = (*PLANAR_METHODS, *SPATIAL_METHODS)


def make_estimator(
    method: str, profile: Profile, mapping: PlaneMapping | None = None, segmenter: Segmenter | None = None
) -> Estimator:
    """Make the estimator of that name; raises UsageError that lists the names.

    A planar method needs a mapping; a 3D one takes none. Estimators that share a segmenter share its work on an image.
    """
    if method in SPATIAL_METHODS:
        return SPATIAL_METHODS[method](profile, segmenter)
    if method not in PLANAR_METHODS:
        raise UsageError(f"no method {method}: {did_you_mean(method, METHODS)}")
    if mapping is None:
        raise UsageError(f"method {method} is planar: it needs a calibration")
    return PLANAR_METHODS[method](profile, mapping, segmenter)

"""The ablation: the paper's estimator without marker, ORB and homography. Anyone can see what they add."""

from __future__ import annotations

from svmdist.estimation.frame import Frame, Needs
from svmdist.estimation.planar.equations import PlaneMapping
from svmdist.estimation.planar.steps import in_plane, locate
from svmdist.results import FrameResult


class CentroidEstimator:
    """`--method centroid`: the instrument's centroid is the tool's position. Keeps no state between frames."""

    name = "centroid"
    needs = Needs(tool=("regions_as_recorded",), robot=False)
    keeps_state = False

    def __init__(self, mapping: PlaneMapping) -> None:
        self._mapping = mapping

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; a frame that cannot be measured says why."""
        result, tissue, instrument = locate(frame)
        if tissue is None or instrument is None:
            return result
        return in_plane(result, instrument.centroid_px, tissue.centroid_px, self._mapping)

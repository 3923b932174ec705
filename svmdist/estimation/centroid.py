"""The ablation: the paper's estimator without marker, ORB and homography. Anyone can see what they add."""

from __future__ import annotations

from svmdist.estimation.locate import locate_both
from svmdist.estimation.planar.equations import PlaneMapping, planar_distance_m
from svmdist.estimation.rows import finish, first_rows
from svmdist.profile import Profile
from svmdist.samples import Estimate, Observation
from svmdist.vision.segmentation.segmenter import Segmenter, make_segmenter, own_masks


class CentroidEstimator:
    """`--method centroid`: the instrument's centroid is the tool's position."""

    name = "centroid"

    def __init__(self, profile: Profile, mapping: PlaneMapping, segmenter: Segmenter | None = None) -> None:
        self._segmentation = profile.segmentation
        self._segmenter = segmenter or make_segmenter(profile.segmentation, level=False)
        self._mapping = mapping

    def estimate(self, observation: Observation) -> Estimate:
        """Measure one frame; a frame that cannot be measured says why."""
        masks = own_masks(self._segmenter, observation.image_bgr, observation.foreign)
        tissue, instrument = locate_both(masks, self._segmentation)
        row = first_rows(observation.stamp_ns, tissue, instrument)
        if tissue is None or instrument is None:
            return row
        tool_m = self._mapping.to_plane_m(instrument.centroid_px)
        tissue_m = self._mapping.to_plane_m(tissue.centroid_px)
        return finish(row, instrument.centroid_px, planar_distance_m(tool_m, tissue_m))

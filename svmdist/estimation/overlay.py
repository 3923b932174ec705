"""The paper's estimator: segment, overlay the virtual marker, find it by ORB, map to the plane, measure.

The marker is pasted where the instrument's centroid is, so finding it again gives back that place: it
adds robustness of detection, no depth and no pose. `centroid` is the same without it.
"""

from __future__ import annotations

from dataclasses import replace

from svmdist.estimation.locate import locate_both
from svmdist.estimation.planar.equations import PlaneMapping, planar_distance_m
from svmdist.estimation.planar.marker_detection import detect_marker, mark, template_features
from svmdist.estimation.rows import finish, first_rows
from svmdist.profile import Profile
from svmdist.samples import Estimate, Observation, Status
from svmdist.vision.segmentation.segmenter import Segmenter, make_segmenter, own_masks


class OverlayEstimator:
    """`--method overlay`: one observation in, one estimate out; keeps nothing between frames."""

    name = "overlay"

    def __init__(self, profile: Profile, mapping: PlaneMapping, segmenter: Segmenter | None = None) -> None:
        self._segmentation = profile.segmentation
        self._segmenter = segmenter or make_segmenter(profile.segmentation, level=False)
        self._marker = profile.marker
        self._rules = profile.features
        self._settings = profile.settings.marker
        self._mapping = mapping
        self._template = template_features(profile.marker, profile.features)

    def estimate(self, observation: Observation) -> Estimate:
        """Measure one frame by the paper's three phases; a frame that cannot be measured says why."""
        # First phase: tissue, instrument, marker on the instrument.
        masks = own_masks(self._segmenter, observation.image_bgr, observation.foreign)
        tissue, instrument = locate_both(masks, self._segmentation)
        row = first_rows(observation.stamp_ns, tissue, instrument)
        if tissue is None or instrument is None:
            return row
        marked = mark(observation.image_bgr, instrument.centroid_px, self._marker)

        # Second phase: features, matches, homography, outline.  Final phase: third contour.
        found = detect_marker(marked, self._template, self._marker, self._rules, self._settings)
        row = replace(
            row,
            status=found.status,
            keypoint_count=found.keypoint_count,
            match_count=found.match_count,
            inlier_count=found.inlier_count,
        )
        if found.status is not Status.OK or found.centroid_px is None:
            return row

        # Both positions to the plane, and the distance between them.
        tool_m = self._mapping.to_plane_m(found.centroid_px)
        tissue_m = self._mapping.to_plane_m(tissue.centroid_px)
        return finish(row, found.centroid_px, planar_distance_m(tool_m, tissue_m))

"""The paper's estimator: segment, overlay the virtual marker, find it by ORB, map to the plane, measure.

The marker is pasted where the instrument's centroid is, so finding it again gives back that place: it
adds robustness of detection, no depth and no pose. `centroid` is the same without it.
"""

from __future__ import annotations

from svmdist.estimation.frame import Frame, Needs
from svmdist.estimation.planar.equations import PlaneMapping
from svmdist.estimation.planar.marker_detection import detect_marker, mark, template_features
from svmdist.estimation.planar.steps import in_plane, locate
from svmdist.profile import Profile
from svmdist.results import FrameResult
from svmdist.samples import Status


class OverlayEstimator:
    """`--method overlay`: the paper's three phases. Keeps no state between frames."""

    name = "overlay"
    needs = Needs(tool=("regions_as_recorded",), robot=False)
    keeps_state = False

    def __init__(self, profile: Profile, mapping: PlaneMapping) -> None:
        self._marker = profile.marker
        self._rules = profile.features
        self._settings = profile.settings.marker
        self._mapping = mapping
        self._template = template_features(profile.marker, profile.features)

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; a frame that cannot be measured says why."""
        # First phase: tissue, instrument, marker on the instrument.
        result, tissue, instrument = locate(frame)
        if tissue is None or instrument is None:
            return result
        marked = mark(frame.left.context.bgr_as_recorded, instrument.centroid_px, self._marker)

        # Second phase: features, matches, homography, outline.  Final phase: third contour.
        found = detect_marker(marked, self._template, self._marker, self._rules, self._settings)
        result = result.with_image(
            keypoint_count=found.keypoint_count,
            match_count=found.match_count,
            inlier_count=found.inlier_count,
        )
        if found.status is not Status.OK or found.centroid_px is None:
            return result.rejected(found.status)

        # Both places to the plane, and the distance between them.
        return in_plane(result, found.centroid_px, tissue.centroid_px, self._mapping)

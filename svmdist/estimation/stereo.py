"""`--method stereo`: both cameras. Shaft and disparity give the tool, matching and alignment the tissue's surface."""

from __future__ import annotations

from dataclasses import replace

from svmdist.estimation.detection.distal_marker import detect_distal_marker
from svmdist.estimation.detection.stereo_match import match_distal_marker
from svmdist.estimation.detection.stereo_surface import detect_stereo_surface
from svmdist.estimation.distances import measure
from svmdist.estimation.filtering.believed import believed_tool
from svmdist.estimation.filtering.robot_scene import belief_of, require_chain
from svmdist.estimation.instrument.model import InstrumentModel
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.estimation.locate import locate_instrument
from svmdist.estimation.shaft import ShaftEstimator
from svmdist.estimation.shaft_pose.fit import ShaftFit
from svmdist.estimation.stereo_pose import nominal_orientation_pose, refine_depth
from svmdist.estimation.tissue.fix import require_tissue, see_tissue, tissue_row
from svmdist.geometry.surfaces import Cloud
from svmdist.profile import Profile
from svmdist.results import Failure
from svmdist.samples import Estimate, Observation, Rejection, RightView, Status
from svmdist.vision.rectified import RectifiedPair, rectified_pair
from svmdist.vision.segmentation.colour import to_grey, to_hsv
from svmdist.vision.segmentation.exposure import levelled
from svmdist.vision.segmentation.segmenter import Masks, Segmenter, make_segmenter, own_masks


class StereoEstimator:
    """One observation with both views in, one estimate out; keeps only whether it saw the tag's plate."""

    name = "stereo"

    def __init__(self, profile: Profile, segmenter: Segmenter | None = None) -> None:
        require_tissue(profile)
        self._profile = profile
        self._segmenter = segmenter or make_segmenter(profile.segmentation)
        self._chain = require_chain(profile)
        self._model = InstrumentModel.of(profile)
        sees_shaft = profile.segmentation.shaft is not None and profile.instrument is not None
        self._shaft = ShaftEstimator(profile, self._segmenter) if sees_shaft else None

    def estimate(self, observation: Observation) -> Estimate:
        """Measure one frame; a frame that cannot be measured says why."""
        # The tissue's outline in the left view, and the pair's geometry.
        masks = own_masks(self._segmenter, observation.image_bgr, observation.foreign)
        sight = see_tissue(masks, self._profile, observation.camera)
        row = tissue_row(observation.stamp_ns, sight)
        right = observation.right
        if sight is None or sight.fix is None:
            return row
        if right is None:
            return replace(row, status=Status.NO_STEREO, detail="no right view")
        pair = rectified_pair(observation, right)
        if isinstance(pair, Failure):
            return replace(row, status=Status.NO_STEREO, detail=pair.reason)

        # The tool: its distal marker in both views, and the shaft's direction.
        right_masks = own_masks(self._segmenter, right.image_bgr, right.foreign)
        pose = self._tool(observation, right, pair, (masks, right_masks))
        if isinstance(pose, Rejection):
            return replace(row, status=pose.status, detail=pose.detail)

        # The tissue's surface, and the distances.
        seen = detect_stereo_surface(
            to_grey(observation.image_bgr),
            to_grey(right.image_bgr),
            pair,
            sight.region.hull,
            (masks.tissue, right_masks.tissue),
            self._profile.settings.stereo,
        )
        if seen is None:
            return replace(
                row, status=Status.NO_STEREO, detail="the views do not agree on the tissue's surface"
            )
        # The surface has its own error; the dome's and the outline's are no part of it.
        fix = replace(sight.fix, surface=Cloud(seen.points_m), surface_std_m=seen.std_m, dome=None)
        has_plate = self._shaft is not None and self._shaft.has_seen_tag
        return measure(row, pose, fix, self._model, observation.joints, observation.camera, has_plate)

    def _tool(
        self, observation: Observation, view: RightView, pair: RectifiedPair, masks: tuple[Masks, Masks]
    ) -> ToolPose | Rejection:
        """The shaft's pose corrected by the disparity; else the triangulated point with the nominal orientation."""
        settings, instrument = self._profile.settings, self._profile.instrument
        left, right = (
            detect_distal_marker(
                to_hsv(levelled(image)),
                seen.instrument,
                locate_instrument(seen, self._profile.segmentation),
                settings.distal_marker,
            )
            for seen, image in zip(masks, (observation.image_bgr, view.image_bgr), strict=True)
        )
        radius_m = instrument.knuckle_radius_m if instrument else None
        match = match_distal_marker(left, right, pair, radius_m, observation.camera, settings.stereo)
        if isinstance(match, Failure):
            return Rejection(observation.stamp_ns, Status.NO_INSTRUMENT, match.reason)
        fit = self._shaft.find_tool(observation) if self._shaft is not None else None
        pose = refine_depth(fit.pose, match, pair, settings.stereo) if isinstance(fit, ShaftFit) else None
        if pose is not None:
            return pose
        belief = belief_of(observation, self._chain)
        if isinstance(belief, str):
            return Rejection(observation.stamp_ns, Status.NO_JOINTS, belief)
        nominal = believed_tool(self._chain, self._profile.kinematic_error, belief.q, belief.T_camera_base)
        return nominal_orientation_pose(match, pair, nominal)

"""`--method stereo`: both cameras. Shaft and disparity give the tool, matching and alignment the tissue's surface."""

from __future__ import annotations

from dataclasses import replace

from svmdist.estimation.distances import measure
from svmdist.estimation.filtering.robot_scene import belief_of, require_chain
from svmdist.estimation.instrument.model import InstrumentModel
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.estimation.instrument.shaft_sight import see_knuckle
from svmdist.estimation.shaft import ShaftEstimator
from svmdist.estimation.stereo_tool import believed_pose, deepen, match_knuckle
from svmdist.estimation.tissue.fix import require_tissue, see_tissue, tissue_row
from svmdist.estimation.tissue.stereo_surface import see_surface
from svmdist.geometry.surfaces import Cloud
from svmdist.profile import Profile
from svmdist.samples import Estimate, Observation, Rejection, RightView, Status
from svmdist.vision.rectified import RectifiedPair, rectified_pair
from svmdist.vision.segmentation.colour import to_hsv
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
        if isinstance(pair, str):
            return replace(row, status=Status.NO_STEREO, detail=pair)

        # The tool: its knuckle in both views, and the shaft's direction.
        right_masks = own_masks(self._segmenter, right.image_bgr, right.foreign)
        pose = self._tool(observation, right, pair, (masks, right_masks))
        if isinstance(pose, Rejection):
            return replace(row, status=pose.status, detail=pose.detail)

        # The tissue's surface, and the distances.
        seen = see_surface(observation, right, pair, sight.region.hull, (masks.tissue, right_masks.tissue))
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
        """The shaft's pose corrected by the disparity; else the triangulated point, turned as the robot believes."""
        rule, instrument = self._profile.segmentation.instrument, self._profile.instrument
        left, right = (
            see_knuckle(seen.instrument, rule, to_hsv(levelled(image)))
            for seen, image in zip(masks, (observation.image_bgr, view.image_bgr), strict=True)
        )
        radius_m = instrument.knuckle_radius_m if instrument else None
        seen = match_knuckle(left, right, pair, radius_m, observation.camera)
        if isinstance(seen, str):
            return Rejection(observation.stamp_ns, Status.NO_INSTRUMENT, seen)
        fit = self._shaft.find_tool(observation) if self._shaft is not None else ""
        pose = None if isinstance(fit, str) else deepen(fit.pose, seen, pair)
        if pose is not None:
            return pose
        belief = belief_of(observation, self._chain)
        if isinstance(belief, str):
            return Rejection(observation.stamp_ns, Status.NO_JOINTS, belief)
        return believed_pose(seen, pair, belief, self._chain, self._profile.kinematic_error)

"""`--method stereo`: both cameras. Shaft and disparity give the tool, matching and alignment the tissue's surface."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.estimation.distances import measure
from svmdist.estimation.filtering.robot_scene import belief_of, require_chain
from svmdist.estimation.instrument.model import InstrumentModel
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.estimation.instrument.rectified import RectifiedPair, rectified_pair
from svmdist.estimation.instrument.shaft_sight import see_knuckle
from svmdist.estimation.shaft import ShaftEstimator
from svmdist.estimation.stereo_tool import FAR_M, believed_pose, deepen, match_knuckle
from svmdist.estimation.tissue.fix import TissueFix, TissueSight, require_tissue, see_tissue, tissue_row
from svmdist.geometry.surfaces import Cloud
from svmdist.profile import Profile
from svmdist.samples import Estimate, Image, Observation, Rejection, RightView, Status
from svmdist.transforms import Array
from svmdist.vision.segmentation.colour import to_hsv
from svmdist.vision.segmentation.exposure import levelled
from svmdist.vision.segmentation.segmenter import Masks, Segmenter, make_segmenter, own_masks
from svmdist.vision.stereo import DisparitySurface, fit_surface

NEAR_M = 0.04
"""With FAR_M, the working distance of an endoscope: bounds the disparities that are searched."""
SURFACE_STD_PX = 0.12
"""What an aligned low-order surface leaves: measured 0.36 mm at 105 mm and a baseline of 5 mm."""
GRID_STEP_PX = 5


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
        fix = self._surface(observation, right, pair, sight, (masks.tissue, right_masks.tissue))
        if fix is None:
            return replace(
                row, status=Status.NO_STEREO, detail="the views do not agree on the tissue's surface"
            )
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

    def _surface(
        self,
        observation: Observation,
        right: RightView,
        pair: RectifiedPair,
        sight: TissueSight,
        tissue_masks: tuple[Image, Image],
    ) -> TissueFix | None:
        """The origin by the outline on the profile's plane, as elsewhere; the surface by stereo."""
        assert sight.fix is not None  # the caller has checked it
        far_px, near_px = (pair.disparity_at(depth_m) + pair.offset_px for depth_m in (FAR_M, NEAR_M))
        bounds = (int(np.floor(far_px)), int(np.ceil(near_px)))
        surface = fit_surface(_grey(observation.image_bgr), _grey(right.image_bgr), *tissue_masks, *bounds)
        if surface is None:
            return None
        points_m = _cloud(surface, sight.region.hull, pair, tissue_masks[0].shape)
        depth_m = float(np.median(points_m[:, 2]))
        surface_std_m = depth_m / pair.disparity_at(depth_m) * SURFACE_STD_PX
        # The surface has its own error; the outline's is not part of a clearance.
        return replace(sight.fix, surface=Cloud(points_m), surface_std_m=surface_std_m)


def _cloud(
    surface: DisparitySurface, hull: NDArray[np.int32], pair: RectifiedPair, shape: tuple[int, ...]
) -> Array:
    """Points of the surface inside the tissue's hull, shape (n, 3), under the instrument too."""
    inside = np.zeros(shape[:2], np.uint8)
    cv2.fillConvexPoly(inside, np.asarray(hull, np.int32), 255)
    rows, columns = np.nonzero(inside[::GRID_STEP_PX, ::GRID_STEP_PX])
    points_px = np.stack([columns, rows], -1).astype(np.float64) * GRID_STEP_PX
    disparity_px = surface.at(points_px) - pair.offset_px
    return pair.points(points_px, np.maximum(disparity_px, pair.disparity_at(FAR_M)))


def _grey(image_bgr: Image) -> Image:
    return np.asarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY), np.uint8)

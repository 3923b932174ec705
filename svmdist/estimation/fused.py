"""Kinematics corrected by what the camera sees: a Kalman filter over the error of what the robot believes.

Between sights the joints carry the pose, with the error last found: occlusion and rejected frames cost
certainty, not rows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np

from svmdist.estimation.distances import measure
from svmdist.estimation.filter import KinematicErrorFilter
from svmdist.estimation.instrument_model import InstrumentModel
from svmdist.estimation.kinematic import Belief, belief_of, require_chain, with_tissue, with_tool_pixel
from svmdist.estimation.locate import locate_instrument
from svmdist.estimation.observations import LinkObservation, PointsObservation, PoseObservation
from svmdist.estimation.tag_pose import believed_tag_rotation, find_tag_pose
from svmdist.estimation.tissue import require_tissue, see_tissue
from svmdist.estimation.tissue_memory import TissueMemory
from svmdist.profile import Profile
from svmdist.samples import Estimate, Image, JointSample, Observation, Status
from svmdist.vision.regions import Region
from svmdist.vision.segmenter import Segmenter, make_segmenter
from svmdist.vision.tag import TagFinder, TagPattern

REGION_STD_PX = 2.0
"""The centroid of a coloured part of unknown shape against the tool's origin."""
KNUCKLE_STD_PX = 0.6
"""The centroid of a whole round knuckle: what pixel noise and shading leave of it, alike over some frames."""
TAG_STD_M = 1e-4
TAG_DEPTH_STD = 5e-3
"""Along the line of sight, over the depth."""
TAG_STD_RAD = 0.01
CORRELATED_FRAMES = 4.0
"""Neighbouring frames show nearly the same pixels: so many of them count as one."""
WHOLE_FRACTION = 0.4
"""A knuckle of which less is seen tells nothing: its centroid is anybody's guess."""


class FusedEstimator:
    """`--method fused`: keeps the filter and the tissue's place between frames."""

    name = "fused"

    def __init__(self, profile: Profile, segmenter: Segmenter | None = None) -> None:
        require_tissue(profile)
        self._profile = profile
        self._segmenter = segmenter or make_segmenter(profile.segmentation)
        self._chain = require_chain(profile)
        self._model = InstrumentModel.of(profile)
        self._tissue = TissueMemory()
        self._filter = KinematicErrorFilter(self._chain, profile.kinematic_error)
        tag = profile.fiducial
        self._finder = TagFinder(tag.family, tag.id) if tag else None
        self._pattern = TagPattern(tag.family, tag.id, tag.size_m) if tag else None

    def estimate(self, observation: Observation) -> Estimate:
        """Measure one frame; a row needs joints and a tissue seen before, and nothing of this image."""
        belief = belief_of(observation, self._chain)
        masks = self._segmenter.masks(observation.image_bgr)
        sight = see_tissue(masks, self._profile, observation.camera)
        tissue = self._tissue.add(sight.fix if sight else None)
        row = with_tissue(Estimate(observation.stamp_ns, Status.NO_TISSUE), sight)
        if isinstance(belief, str):
            return replace(row, status=Status.NO_JOINTS, detail=belief)

        # Predict by the joints, correct by what the image gives.
        self._filter.predict(observation.stamp_ns, belief.q, belief.T_camera_base)
        region = locate_instrument(masks, self._profile.segmentation)
        verdicts = self._filter.update(
            [*self._region_sight(observation, region), *self._tag_sight(observation, belief)]
        )
        pose = self._filter.tool_pose()

        row = replace(
            with_tool_pixel(row, observation.camera, pose.position_m),
            tool_area_px=region.area_px if region else None,
            match_count=len(verdicts),
            inlier_count=sum(verdict.is_accepted for verdict in verdicts),
            detail="" if verdicts else "nothing of the tool seen: joints alone",
        )
        if tissue is None:
            return row
        q = self._filter.corrected_joints()
        joints = JointSample(observation.stamp_ns, self._chain.joint_names, q)
        return measure(row, pose, tissue, self._model, joints)

    def _region_sight(self, observation: Observation, region: Region | None) -> Iterator[LinkObservation]:
        """The coloured region's centroid is a sight of the tool's origin, as sure as the region is whole."""
        if region is None:
            return
        std_px = self._region_std_px(observation, region)
        if std_px is None:
            return
        pixel = region.centroid_px[None]
        yield PointsObservation(
            "region", None, observation.camera, np.zeros((1, 3)), pixel, std_px**2 * np.eye(2)
        )

    def _region_std_px(self, observation: Observation, region: Region) -> float | None:
        camera, (x, y, width, height) = observation.camera, cv2.boundingRect(region.hull)
        if x <= 0 or y <= 0 or x + width >= camera.width_px or y + height >= camera.height_px:
            return None
        instrument = self._profile.instrument
        if instrument is None:
            return REGION_STD_PX
        pose = self._filter.tool_pose()
        depth_m, depth_std_m = pose.position_m[2], np.sqrt(pose.covariance[2, 2])
        if depth_m <= 0.0 or depth_std_m > 0.05 * depth_m:
            return REGION_STD_PX
        radius_px = camera.K[0, 0] * instrument.knuckle_radius_m / depth_m
        whole = region.area_px / (np.pi * radius_px**2)
        if whole < WHOLE_FRACTION:
            return None
        # What is missing, or too much, lies on one side: at worst it moves the centroid by half of it.
        wrong = max(0.0, abs(1.0 - whole) - 0.1)
        return float(np.hypot(KNUCKLE_STD_PX, 0.5 * wrong * radius_px))

    def _tag_sight(self, observation: Observation, belief: Belief) -> Iterator[LinkObservation]:
        """The tag's pose, where the profile has one and the image shows it."""
        fiducial = self._profile.fiducial
        if self._finder is None or self._pattern is None or fiducial is None:
            return
        image_grey: Image = np.asarray(cv2.cvtColor(observation.image_bgr, cv2.COLOR_BGR2GRAY), np.uint8)
        corners_px = self._finder.corners_px(image_grey)
        if corners_px is None:
            return
        believed = believed_tag_rotation(belief.T_camera_base, fiducial, self._chain, belief.q)
        tag = find_tag_pose(image_grey, corners_px, observation.camera, self._pattern, believed)
        if tag is None:
            return
        # Its error is alike from frame to frame; a filter that averages must not take it for noise.
        floor = np.repeat([TAG_STD_M, TAG_STD_RAD], 3) ** 2
        floor[2] = (TAG_DEPTH_STD * tag.T_camera_tag[2, 3]) ** 2
        covariance = CORRELATED_FRAMES * tag.covariance + np.diag(floor)
        yield PoseObservation("tag", fiducial.link, fiducial.T_link_tag, tag.T_camera_tag, covariance)

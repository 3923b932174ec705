"""The tag on the instrument: six degrees of freedom from one image, and through the wrist to the tool."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from svmdist.errors import KinematicsError, ProfileError
from svmdist.estimation.detection.tag import TagDetector
from svmdist.estimation.distances import measure
from svmdist.estimation.instrument.model import InstrumentModel
from svmdist.estimation.instrument.tool_from_tag import nominal_tag_rotation, tool_from_tag
from svmdist.estimation.tissue.fix import require_tissue, see_tissue, tissue_row
from svmdist.kinematics.chain import chain_of
from svmdist.kinematics.dh import select_joints
from svmdist.profile import Profile
from svmdist.samples import Estimate, Image, Observation, Status
from svmdist.vision.segmentation.segmenter import Segmenter, make_segmenter


class FiducialEstimator:
    """`--method fiducial`: one observation in, one estimate out; keeps nothing between frames."""

    name = "fiducial"

    def __init__(self, profile: Profile, segmenter: Segmenter | None = None) -> None:
        if profile.fiducial is None or profile.robot is None:
            raise ProfileError(
                f"profile {profile.name} has no {'[fiducial]' if profile.robot else '[robot]'}: the method"
                " fiducial needs the tag, the link that carries it, and the chain from there to the tool"
            )
        require_tissue(profile)
        self._profile = profile
        self._segmenter = segmenter or make_segmenter(profile.segmentation)
        self._fiducial = profile.fiducial
        self._chain = chain_of(profile.robot)
        self._model = InstrumentModel.of(profile)
        self._detector = TagDetector(self._fiducial, profile.settings.tag)

    def estimate(self, observation: Observation) -> Estimate:
        """Measure one frame; a frame that cannot be measured says why."""
        # The tissue, on the plane that it lies on.
        sight = see_tissue(self._segmenter.masks(observation.image_bgr), self._profile, observation.camera)
        row = tissue_row(observation.stamp_ns, sight)
        if sight is None or sight.fix is None:
            return row

        # The tag: corners, then both poses that they allow, and the one of them that is true.
        image_grey: Image = np.asarray(cv2.cvtColor(observation.image_bgr, cv2.COLOR_BGR2GRAY), np.uint8)
        detection = self._detector.detect(image_grey, observation.camera)
        if detection is None:
            return replace(row, status=Status.NO_FIDUCIAL)
        if observation.joints is None:
            return replace(row, status=Status.NO_JOINTS)
        try:
            q = select_joints(self._chain, observation.joints.names, observation.joints.positions)
        except KinematicsError as problem:
            return replace(row, status=Status.NO_JOINTS, detail=str(problem))
        nominal = nominal_tag_rotation(observation.T_camera_base, self._fiducial, self._chain, q)
        tag = self._detector.pose(image_grey, detection, observation.camera, nominal)
        if tag is None:
            return replace(row, status=Status.AMBIGUOUS_POSE)

        # Through mounting and wrist to the tool, and the distances from there.
        pose = tool_from_tag(tag, self._fiducial, self._chain, q, self._profile.kinematic_error)
        return measure(
            row, pose, sight.fix, self._model, observation.joints, observation.camera, has_plate=True
        )

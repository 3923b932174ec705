"""Markerless, one camera: the shaft's silhouette gives its axis in 3D, rim and knuckle the place along it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from svmdist.errors import ProfileError
from svmdist.estimation.detection.distal_marker import detect_distal_marker
from svmdist.estimation.detection.shaft import detect_shaft
from svmdist.estimation.distances import measure
from svmdist.estimation.instrument.model import InstrumentModel
from svmdist.estimation.locate import locate_instrument
from svmdist.estimation.shaft_pose.fit import ShaftFit, fit_shaft
from svmdist.estimation.shaft_pose.model import shaft_model
from svmdist.estimation.tissue.fix import require_tissue, see_tissue, tissue_row
from svmdist.kinematics.chain import chain_of
from svmdist.profile import Profile
from svmdist.results import Failure
from svmdist.samples import Estimate, Image, Observation, Status
from svmdist.vision.segmentation.colour import to_hsv
from svmdist.vision.segmentation.exposure import brightest_channel, levelled
from svmdist.vision.segmentation.segmenter import Masks, Segmenter, make_segmenter, own_masks
from svmdist.vision.shaft_segmentation import ShaftRegion, bright_fraction, find_shaft
from svmdist.vision.tag.detection import TagFinder, tag_plate


class ShaftEstimator:
    """`--method shaft`: one observation in, one estimate out; keeps only whether it saw the tag's plate."""

    name = "shaft"

    def __init__(self, profile: Profile, segmenter: Segmenter | None = None) -> None:
        rule = profile.segmentation.shaft
        if rule is None or profile.robot is None or profile.instrument is None:
            raise ProfileError(
                f"profile {profile.name} cannot serve the method shaft: it needs [segmentation.shaft], [robot] and"
                " [instrument]"
            )
        require_tissue(profile)
        self._profile = profile
        self._segmenter = segmenter or make_segmenter(profile.segmentation)
        self._rule = rule
        self._instrument = profile.instrument
        self._chain = chain_of(profile.robot)
        self._model = InstrumentModel.of(profile)
        tag = profile.fiducial
        self._finder = TagFinder(tag.family, tag.id) if tag is not None else None
        self.has_seen_tag = False

    def estimate(self, observation: Observation) -> Estimate:
        """Measure one frame; a frame that cannot be measured says why."""
        camera = observation.camera
        # The tissue, on the plane that it lies on.
        sight = see_tissue(self._segmenter.masks(observation.image_bgr), self._profile, camera)
        row = tissue_row(observation.stamp_ns, sight)
        if sight is None or sight.fix is None:
            return row

        # The tool's pose, and the distances from there.
        fit = self.find_tool(observation)
        if isinstance(fit, Failure):
            return replace(row, status=Status.NO_INSTRUMENT, detail=fit.reason)
        std_m = float(np.sqrt(np.linalg.eigvalsh(fit.pose.position_covariance)[-1]))
        if not std_m <= self._profile.settings.shaft.max_position_std_m:
            detail = f"the position is uncertain by {std_m * 1e3:.1f} mm"
            return replace(row, status=Status.NO_INSTRUMENT, detail=detail)
        return measure(row, fit.pose, sight.fix, self._model, observation.joints, camera, self.has_seen_tag)

    def find_tool(self, observation: Observation) -> ShaftFit | Failure:
        """The tool's pose in one frame, or why there is none."""
        # The shaft's contour lines and end, and the coloured distal marker, in the image.
        settings = self._profile.settings
        image_bgr = levelled(observation.image_bgr)
        masks = own_masks(self._segmenter, observation.image_bgr, observation.foreign)
        region = self._find_shaft(image_bgr, masks)
        marker_region = locate_instrument(masks, self._profile.segmentation)
        marker = detect_distal_marker(
            to_hsv(image_bgr), masks.instrument, marker_region, settings.distal_marker
        )
        shaft = detect_shaft(brightest_channel(image_bgr), region, observation.camera, settings.shaft)

        # The pose that fits them, through the wrist.
        model = shaft_model(
            observation, self._chain, self._instrument, self._profile.kinematic_error, settings.shaft
        )
        return fit_shaft(shaft, marker, model, observation.camera, settings.shaft)

    def _find_shaft(self, image_bgr: Image, masks: Masks) -> ShaftRegion | None:
        if masks.shaft is None:
            return None
        covered = self._covered(image_bgr)
        region = find_shaft(masks.shaft, self._rule, covered, masks.black, self._profile.settings.shaft)
        if region is None or self._finder is None or covered is not None or not region.is_stub:
            return region
        # The border may cut the plate, whose black print is then as wide as the shaft and ends where it does.
        return (
            None
            if bright_fraction(region, masks.shaft) > self._profile.settings.shaft.max_printed_fraction
            else region
        )

    def _covered(self, image_bgr: Image) -> Image | None:
        """Mask of the plate that the profile mounts on the shaft, where the tag on it is found."""
        if self._finder is None:
            return None
        corners_px = self._finder.corners_px(
            np.asarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY), np.uint8)
        )
        if corners_px is None:
            return None
        self.has_seen_tag = True
        return tag_plate(corners_px, image_bgr.shape[:2])

"""What one frame shows of the tool, as observations for the filter: knuckle, disparity, tag, and the shaft's edges."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.detection.tag import TagDetection, TagDetector
from svmdist.estimation.filtering.knuckle_middle import knuckle_middle
from svmdist.estimation.filtering.observations import (
    ContourObservation,
    DisparityObservation,
    LinkObservation,
    PointsObservation,
    PoseObservation,
    SizeObservation,
)
from svmdist.estimation.filtering.robot_scene import Belief, Look
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.estimation.instrument.shaft_sight import RADIUS_PER_BLUR, see_knuckle, see_shaft
from svmdist.estimation.locate import locate_instrument
from svmdist.kinematics.dh import DHChain, frame_transforms
from svmdist.kinematics.jacobian import row_index
from svmdist.kinematics.shaft_axis import shaft_of
from svmdist.profile import Profile
from svmdist.samples import Image, Observation
from svmdist.transforms import Array, inverse
from svmdist.vision.regions import Region
from svmdist.vision.segmentation.colour import to_hsv
from svmdist.vision.segmentation.exposure import levelled
from svmdist.vision.segmentation.segmenter import Masks, Segmenter, own_masks
from svmdist.vision.shaft_segmentation import find_shaft
from svmdist.vision.tag.detection import tag_plate

REGION_STD_PX = 2.0
"""The centroid of a coloured part of unknown shape against the tool's origin."""
VISIBLE_MIDDLE = 0.03
"""Of a knuckle that jaws and fork hide a part of, the visible middle stands off the true one: over its radius,
along each axis of the tool, of which it is a fixed point. They hide 6 % of its disc (`VISIBLE_RADIUS`); all of it on
one side would move the middle by 0.05."""
SHADE = 0.12
"""The limb that is turned from the light is dark, and draws the visible middle to the lit side: over the radius and
the angle between light and view. By Lambert's law it is √(1 - ρ²) where the limb in shade alone ends the disc at ρ of
its radius, 0.24 for 0.97; none where jaws and fork end it, or the light is at the camera: half of it."""
NOISE = 0.02
"""What is left of the centroid's error then, over the radius: pixels, shading, the view's own angle."""
WHOLE_FRACTION = 0.4
"""A knuckle of which less is seen tells nothing: its centroid is anybody's guess."""
WHOLE_SPREAD = 0.1
"""By how much a whole knuckle's area differs from its disc's: jaws that hide some, fork that adds."""
DISPARITY_NOISE = 0.008
"""The same in the difference of two views that see the knuckle from 3° apart, over the radius."""
EVEN = 0.02
"""By how much the region's areas in both views differ when nothing is wrong, over their sum."""
SIZE_STD = 0.01
"""Depth over depth: where it is known this well, the knuckle's size adds nothing to it."""
ROW_TOLERANCE_PX = 3.0
"""Rectified images show the knuckle on one row; what is further off is something else."""
SHARED = 0.5
"""The share of a tag's variance that lasts, how its edges fall on the pixels changes with motion; and of an edge's:
shading shifts it for as long as the light falls on it so, turning and noise do not."""


class ToolSights:
    """Looks for the tool in a frame with what the profile knows of it."""

    def __init__(self, profile: Profile, chain: DHChain, segmenter: Segmenter) -> None:
        self._profile = profile
        self._chain = chain
        self._segmenter = segmenter
        self._shaft = shaft_of(chain)
        tag = profile.fiducial
        self._detector = TagDetector(tag, profile.settings.tag) if tag else None
        self.has_seen_tag = False
        """Whether any frame so far showed the tag: then its plate is on the instrument."""

    def see(
        self, observation: Observation, look: Look, pose: ToolPose
    ) -> tuple[Region | None, list[LinkObservation]]:
        """The instrument's region and all observations of the tool; `pose` is where it is expected."""
        region = locate_instrument(look.masks, self._profile.segmentation)
        tag = self._detect_tag(observation)
        corners_px = None if tag is None else tag.corners_px
        self.has_seen_tag |= tag is not None
        image_bgr = levelled(observation.image_bgr)
        seen: list[LinkObservation] = []
        if region is not None:
            image_hsv = to_hsv(image_bgr)
            seen += self._knuckle(observation, image_hsv, look.masks, region, pose)
            seen += self._size(observation, image_hsv, look.masks, pose)
        if tag is not None and look.belief is not None:
            seen += self._tag(observation, look.belief, pose, tag)
        seen += self._contours(image_bgr, observation.camera, look.masks, corners_px)
        return region, seen

    def _knuckle(
        self, observation: Observation, image_hsv: Image, masks: Masks, region: Region, pose: ToolPose
    ) -> Iterator[LinkObservation]:
        """The knuckle's middle is a sight of a point on the tool, as sure as its region is whole."""
        whole_std_px = self._centroid_std_px(observation.camera, region, pose)
        if whole_std_px is None:
            return
        instrument = self._profile.instrument
        radius_m = instrument.knuckle_radius_m if instrument is not None else 0.0
        depth_m, radius_px = pose.position_m[2], float(np.sqrt(region.area_px / np.pi))
        point_std_m, shade_px = VISIBLE_MIDDLE * radius_m, SHADE * radius_px if radius_m > 0.0 else 0.0
        centre_px, blur_px = knuckle_middle(
            image_hsv, masks.instrument, region, observation.camera, depth_m, radius_m
        )
        std_px = float(np.hypot(whole_std_px, RADIUS_PER_BLUR * blur_px))
        yield PointsObservation(
            "knuckle",
            None,
            observation.camera,
            np.zeros((1, 3)),
            centre_px[None],
            std_px**2 * np.eye(2),
            point_std_m,
            shade_px,
        )
        right = observation.right
        if right is None:
            return
        masks = own_masks(self._segmenter, right.image_bgr, right.foreign)
        other = locate_instrument(masks, self._profile.segmentation)
        if other is None or abs(other.centroid_px[1] - region.centroid_px[1]) > ROW_TOLERANCE_PX:
            return
        if self._centroid_std_px(right.camera, other, pose) is None:
            return
        # What one view shows more of moves its centroid by up to half of it.
        uneven = abs(region.area_px - other.area_px) / (region.area_px + other.area_px)
        std_px = radius_px * float(np.hypot(DISPARITY_NOISE, max(0.0, uneven - EVEN)))
        other_px, _ = knuckle_middle(
            to_hsv(levelled(right.image_bgr)), masks.instrument, other, right.camera, depth_m, radius_m
        )
        yield DisparityObservation(
            "disparity",
            None,
            observation.camera,
            right.camera,
            inverse(right.T_left_right),
            float(centre_px[0] - other_px[0]),
            np.array([[std_px**2]]),
            point_std_m,
            shade_px,
        )

    def _size(
        self, observation: Observation, image_hsv: Image, masks: Masks, pose: ToolPose
    ) -> Iterator[LinkObservation]:
        """The whole knuckle's radius: a depth right within some percent, where nothing better tells one yet."""
        instrument = self._profile.instrument
        if instrument is None or np.sqrt(pose.covariance[2, 2]) < SIZE_STD * pose.position_m[2]:
            return
        knuckle = see_knuckle(masks.instrument, self._profile.segmentation.instrument, image_hsv)
        if knuckle is not None and knuckle.radius_px is not None:
            yield SizeObservation(
                "size",
                None,
                observation.camera,
                instrument.knuckle_radius_m,
                knuckle.radius_px,
                np.array([[0.25 * knuckle.radius_std_px**2]]),
                knuckle.radius_std_px,
            )

    def _centroid_std_px(self, camera: Camera, region: Region, pose: ToolPose) -> float | None:
        """What part of the knuckle is missing says how far its centroid may be off; None where too much is."""
        x, y, width, height = cv2.boundingRect(region.hull)
        if x <= 0 or y <= 0 or x + width >= camera.width_px or y + height >= camera.height_px:
            return None
        instrument = self._profile.instrument
        if instrument is None:
            return REGION_STD_PX
        depth_m, depth_std_m = pose.position_m[2], np.sqrt(pose.covariance[2, 2])
        if depth_m <= 0.0 or depth_std_m > 0.05 * depth_m:
            return REGION_STD_PX
        radius_px = camera.K[0, 0] * instrument.knuckle_radius_m / depth_m
        whole = region.area_px / (np.pi * radius_px**2)
        if whole < WHOLE_FRACTION:
            return None
        # What is missing, or too much, lies on one side: at worst it moves the centroid by half of it.
        wrong = max(0.0, abs(1.0 - whole) - WHOLE_SPREAD)
        return float(radius_px * np.hypot(NOISE, 0.5 * wrong))

    def _detect_tag(self, observation: Observation) -> TagDetection | None:
        if self._detector is None:
            return None
        image_grey: Image = np.asarray(cv2.cvtColor(observation.image_bgr, cv2.COLOR_BGR2GRAY), np.uint8)
        return self._detector.detect(image_grey, observation.camera)

    def _tag(
        self, observation: Observation, belief: Belief, pose: ToolPose, detection: TagDetection
    ) -> Iterator[LinkObservation]:
        fiducial = self._profile.fiducial
        if fiducial is None or self._detector is None:
            return
        image_grey: Image = np.asarray(cv2.cvtColor(observation.image_bgr, cv2.COLOR_BGR2GRAY), np.uint8)
        # Where the tag is turned to is known from the tool, but for the wrist's joints between them.
        frames = frame_transforms(self._chain, belief.q)
        T_base_tag = frames[row_index(self._chain, fiducial.link)] @ fiducial.T_link_tag
        T_base_tool = frames[-1] @ self._chain.T_last_tool
        turned = pose.T_camera_tool[:3, :3] @ T_base_tool[:3, :3].T @ T_base_tag[:3, :3]
        std_rad = float(np.sqrt(np.linalg.eigvalsh(pose.covariance[3:, 3:])[-1]))
        tag = self._detector.pose(image_grey, detection, observation.camera, turned, std_rad)
        if tag is not None:
            yield PoseObservation(
                "tag",
                fiducial.link,
                fiducial.T_link_tag,
                tag.T_camera_tag,
                (1.0 - SHARED) * tag.covariance,
                SHARED * tag.covariance,
            )

    def _contours(
        self, image_bgr: Image, camera: Camera, masks: Masks, corners_px: Array | None
    ) -> Iterator[LinkObservation]:
        """Both edges of a shaft that is longer than wide; on a stub something else is easily taken for one."""
        rule, instrument = self._profile.segmentation.shaft, self._profile.instrument
        if rule is None or instrument is None or self._shaft is None or masks.shaft is None:
            return
        covered = None if corners_px is None else tag_plate(corners_px, masks.shaft.shape)
        region = find_shaft(masks.shaft, rule, covered, masks.black)
        sight = see_shaft(image_bgr, region, None, camera)
        if sight.is_stub:
            return
        for contour in sight.contours:
            _, axes = np.linalg.eigh(contour.plane.covariance)
            across = axes[:, 1:].T
            covariance = across @ contour.plane.covariance @ across.T
            yield ContourObservation(
                f"edge {contour.side:+d}",
                self._shaft.link,
                contour.plane.normal,
                across,
                (1.0 - SHARED) * covariance,
                self._shaft.p_axis_m,
                self._shaft.axis,
                instrument.shaft_radius_m,
                contour.side,
                SHARED * covariance,
            )

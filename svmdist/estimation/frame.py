"""One instant of a log: images, each looked at once, arms, and both as the methods of one instrument see them."""

from __future__ import annotations

import time
from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from svmdist.errors import ProfileError
from svmdist.estimation.instrument import shaft as shafts
from svmdist.estimation.instrument.error_model import nominal_tool
from svmdist.estimation.instrument.model import InstrumentModel
from svmdist.estimation.instrument.tag_pose import TagPose, find_tag_pose
from svmdist.estimation.tissue.detection import TissueDetection, detect_tissue
from svmdist.estimation.tissue.surface import QUICK_PX, StereoSurface, detect_stereo_surface
from svmdist.geometry import Surface
from svmdist.kinematics import DHChain, chain_of, shaft_of
from svmdist.kinematics.robot_state import NO_CAMERA, RobotState
from svmdist.profile import Profile
from svmdist.results import Failure, ToolPose
from svmdist.samples import Image, JointSample, Observation, RightView
from svmdist.transforms import Array, inverse
from svmdist.vision.colour import Masks
from svmdist.vision.frame_context import FrameContext, Segmenter, as_pinholes, mixes_colours, with_first_fields
from svmdist.vision.instruments.find_instruments import SeenInstrument
from svmdist.vision.regions import Region, find_region
from svmdist.vision.shaft_segmentation import find_shaft
from svmdist.vision.silhouette import Silhouette, WristShape, find_silhouette
from svmdist.vision.stereo import LEVEL, RectifiedPair, RowAlignment, rectified_pair
from svmdist.vision.tags import TagPattern, tag_plate

if TYPE_CHECKING:
    from svmdist.estimation.instrument.image_pose import ImagePose  # which is made of a frame

OF_BOTH_VIEWS = "stereo_pair", "stereo_surface"  # what a scene finds by both of its views


class Arm:
    """An instrument's profile, with its chain, its body and its fiducial made ready; shared by all methods."""

    def __init__(self, profile: Profile, has_plate: bool = False) -> None:
        self.profile = profile
        self.has_plate = has_plate  # its tag, or that of another instrument, is seen anywhere in the log
        self.chain = chain_of(profile.robot) if profile.robot else None
        self.body = InstrumentModel.of(profile)  # as capsules; None where the profile has no sizes of it

    @property
    def required_chain(self) -> DHChain:
        """The robot's chain; raises ProfileError where the profile has none."""
        if self.chain is None:
            raise ProfileError(f"profile {self.profile.name} has no [robot]: kinematics need its chain")
        return self.chain

    def nominal_tool(self, robot: RobotState) -> ToolPose:
        """The tool by nominal kinematics, with their covariance."""
        return nominal_tool(robot.chain, self.profile.kinematic_error, robot)

    @cached_property
    def straight(self) -> shafts.ShaftModel | None:
        """The instrument with straight joints, in no place; None without its sizes, or a chain with a shaft."""
        instrument = self.profile.instrument
        if instrument is None or self.chain is None or shaft_of(self.chain) is None:
            return None
        return shafts.ShaftModel.of(Failure(""), self.chain, instrument)

    @property
    def plate_beside(self) -> float:
        """By how much its tag's plate is wider than the shaft, over its width."""
        tag, instrument = self.profile.fiducial, self.profile.instrument
        if tag is None or instrument is None:
            return 0.0
        plate_m = self.profile.settings.tag.plate_ratio * tag.size_m
        return max(0.5 * plate_m / instrument.shaft_radius_m - 1.0, 0.0)

    @cached_property
    def tag_pattern(self) -> TagPattern | None:
        """The fiducial's printed pattern; None where the profile has no fiducial."""
        tag = self.profile.fiducial
        return TagPattern(tag.family, tag.id, tag.size_m) if tag else None


class Scene:
    """One instant of a log before the instruments are associated; all methods and instruments share its detections."""

    def __init__(self, seen: Observation, profile: Profile, segmenter: Segmenter, rows: RowAlignment = LEVEL) -> None:
        self.lens = seen.camera  # the left one as it is
        self.profile, self._rows = profile, rows
        interlace = profile.settings.interlace
        first = with_first_fields(seen, interlace)
        self.mixes_colours = first.image_bgr is not seen.image_bgr and mixes_colours(seen.image_bgr, interlace)
        self.observation = as_pinholes(first, rows)  # what ideal cameras would have seen, their rows aligned
        right = self.observation.right
        self.left = FrameContext(self.observation.image_bgr, segmenter, profile)
        self.right = None if right is None else FrameContext(right.image_bgr, segmenter, profile)

    def left_alone(self) -> Scene:
        """The same without the right view, with what was found in the left one."""
        alone = copy(self)
        alone.observation, alone.right = replace(self.observation, right=None), None
        for name in OF_BOTH_VIEWS:
            vars(alone).pop(name, None)
        return alone

    @cached_property
    def tissue(self) -> TissueDetection | None:
        """The tissue's outline and pose, by the left view."""
        return detect_tissue(self.left.masks, self.profile, self.observation.camera)

    @cached_property
    def stereo_pair(self) -> RectifiedPair | Failure:
        """The geometry of both views, where they are a rectified pair."""
        right = self.observation.right
        return Failure("no right view") if right is None else rectified_pair(self.observation.camera, right)

    @cached_property
    def stereo_surface(self) -> StereoSurface | None:
        """The tissue's surface by both views, as a distance needs it; None where they do not show it."""
        return self.surface()

    def surface(self, most_px: int = QUICK_PX) -> StereoSurface | None:
        """The same by up to so many pixels."""
        pair = self.stereo_pair
        if self.right is None or isinstance(pair, Failure):
            return None
        return detect_stereo_surface((self.left, self.right), pair, self.profile, self._rows, most_px)


class View:
    """One camera's image as the methods of one instrument see it: `vars` has the detections that were asked for."""

    def __init__(self, arm: Arm, seen: Observation | RightView, context: FrameContext) -> None:
        self.camera, self.context = seen.camera, context
        # Mask, (h, w), of what has an instrument's colours and belongs to another one, or to none that is known, where
        # there are several: it is set before anything is detected.
        self.others: Image | None = None
        # From the left camera's coordinates to its own, and by how much its stamp is later.
        self.T_view_left, self.delay_s = np.eye(4), 0.0
        if isinstance(seen, RightView):
            self.T_view_left, self.delay_s = inverse(seen.T_left_right), seen.delay_s
        self._arm, self._settings = arm, arm.profile.settings
        self.measured_surface: Surface | None = None  # that a clearance was measured to, for drawings

    @property
    def has_plate(self) -> bool:
        """Whether the instrument carries its tag's plate."""
        return self._arm.has_plate or self.tag_corners_px is not None

    @cached_property
    def masks(self) -> Masks:
        """What is what, at normalised exposure, without the other instruments."""
        masks = self.context.masks
        return masks if self.others is None else masks.without(self.others)

    @cached_property
    def masks_as_recorded(self) -> Masks:
        """The same of the image as it is, for the paper's methods."""
        masks = self.context.masks_as_recorded
        return masks if self.others is None else masks.without(self.others)

    @property
    def tag_corners_px(self) -> Array | None:
        """The corners of the instrument's own tag, shape (4, 2)."""
        fiducial = self._arm.profile.fiducial
        return None if fiducial is None else self.context.tags.get(fiducial.id)

    @cached_property
    def region(self) -> Region | None:
        """The coloured region of the instrument's distal part."""
        return find_region(self.masks.instrument, self._arm.profile.segmentation.instrument, self._settings.outline)

    @cached_property
    def regions_as_recorded(self) -> tuple[Region | None, Region | None]:
        """Tissue (eqs. 1, 2) and distal part (eqs. 7, 8) by the image as it is, for the paper's methods."""
        rules, masks, outline = self._arm.profile.segmentation, self.masks_as_recorded, self._settings.outline
        instrument = find_region(masks.instrument, rules.instrument, outline)
        return find_region(masks.tissue, rules.tissue, outline), instrument

    @cached_property
    def distal_marker(self) -> shafts.DistalMarker | None:
        """The coloured marker about the tool's origin; None of a tip that has none."""
        if self.masks.seen is not None or (region := self.region) is None:  # found by shape, it has no colour
            return None
        settings = self._settings.distal_marker
        return shafts.detect_distal_marker(self.context.hsv, self.masks.instrument, region, settings)

    @cached_property
    def silhouette(self) -> Silhouette | None:
        """The silhouette of the instrument's shaft, found by its shape or as a dark bar."""
        masks, straight, settings = self.masks, self._arm.straight, self._settings.shaft
        if straight is None:
            return None
        picture: Image | None
        wrist: WristShape | None = None
        if masks.seen:
            seen, picture = straight.with_likelier_end(masks.seen[0], settings.end_model_std_m), masks.picture
            wrist = straight.wrist_shape(ends_dark=seen.ends_dark)
        elif masks.seen is None and self.dark_bar is not None:
            seen, picture = self.dark_bar
        else:
            return None
        plates = self.context.plates
        if picture is not None and plates is not None:  # their edges are not the shaft's
            picture = np.asarray(picture & ~plates, np.uint8)
        return find_silhouette(self.context.bgr_as_recorded, seen, picture, wrist, settings.min_contrast_levels)

    @cached_property
    def dark_bar(self) -> tuple[SeenInstrument, Image] | None:
        """The dark bar that comes in from the border, without the tag's plate on it, and what the endoscope shows."""
        profile, masks, corners_px = self._arm.profile, self.masks, self.tag_corners_px
        rule = profile.segmentation.shaft
        if rule is None or masks.shaft is None:
            return None
        covered = None if corners_px is None else tag_plate(corners_px, masks.shaft.shape, self._settings.tag)
        # The border may cut the plate, whose black print is then as wide as the shaft and ends where it does.
        may_be_print = profile.fiducial is not None and covered is None
        return find_shaft(masks.shaft, rule, covered, masks.black, may_be_print=may_be_print)

    @cached_property
    def shaft(self) -> shafts.ShaftDetection:
        """The shaft's edges and end."""
        straight, silhouette = self._arm.straight, self.silhouette
        if straight is None or silhouette is None:
            return shafts.NO_SHAFT
        # A plate hides sides; one whose tag is not read, bloody or cut by the border, has sharp ones of its own.
        soft = self._arm.plate_beside if self.has_plate else 0.0
        sharp = soft if self.tag_corners_px is None else 0.0
        return shafts.detect_silhouette(silhouette, self.camera, straight.radius_m, (sharp, soft))

    @cached_property
    def rim_ahead(self) -> tuple[float, float] | None:
        """How far beyond the hinge the shaft's rim is, and the deviation of that, in m; None where no rim is seen."""
        if self.shaft.rim is None or self._arm.straight is None:
            return None
        return self._arm.straight.rim_ahead(self.shaft, self._settings.shaft.end_model_std_m)


@dataclass(frozen=True)
class Needs:
    """What a method takes of the log, and the detections of scene and frame, by name, that may be computed ahead."""

    scene: tuple[str, ...] = ()
    frame: tuple[str, ...] = ()
    robot: bool = True  # whether it uses joints or transforms
    right_view: bool = False  # whether it uses the right image

    def left_alone(self) -> Needs:
        """What the left view has of it."""
        scene = tuple(name for name in self.scene if name not in OF_BOTH_VIEWS and not name.startswith("right."))
        frame = tuple(name for name in self.frame if not name.startswith("right."))
        return Needs(scene, frame, self.robot)

    def __or__(self, other: Needs) -> Needs:
        return Needs(
            tuple(dict.fromkeys(self.scene + other.scene)),
            tuple(dict.fromkeys(self.frame + other.frame)),
            self.robot or other.robot,
            self.right_view or other.right_view,
        )


@dataclass(frozen=True)
class Frame:
    """What an estimator may use of one instant, detections that all methods share; no field for ground truth."""

    scene: Scene
    arm: Arm
    left: View
    right: View | None
    joints: JointSample | None
    robot: RobotState | Failure
    ambiguity: str = ""  # why it is not sure which instrument this is; empty where it is

    @classmethod
    def of(cls, scene: Scene, arm: Arm, observation: Observation) -> Frame:
        """The frame of one instrument, with what its robot reported."""
        seen, joints, right = scene.observation, observation.joints, None
        robot: RobotState | Failure = Failure(f"profile {arm.profile.name} has no [robot]")
        if arm.chain is not None:
            T, stamp_ns = observation.T_camera_base, observation.stamp_ns
            robot = RobotState.of(arm.chain, joints, T, stamp_ns, observation.joint_track)
        if scene.right is not None and seen.right is not None:
            right = View(arm, seen.right, scene.right)
        return cls(scene, arm, View(arm, seen, scene.left), right, joints, robot)

    def left_alone(self) -> Frame:
        """The same without the right view."""
        return replace(self, scene=self.scene.left_alone(), right=None)

    @property
    def stamp_ns(self) -> int:
        """The image's stamp."""
        return self.scene.observation.stamp_ns

    @property
    def robot_in_camera(self) -> RobotState | Failure:
        """Joints and nominal poses in the camera frame; or what of them the log lacks."""
        if isinstance(self.robot, RobotState) and self.robot.T_camera_base is None:
            return NO_CAMERA
        return self.robot

    @cached_property
    def tag(self) -> TagPose | None:
        """The tag's pose by the left view, its ambiguity decided by nominal kinematics where the image does not."""
        fiducial, robot, R_camera_tag = self.arm.profile.fiducial, self.robot_in_camera, None
        if fiducial is not None and isinstance(robot, RobotState):
            R_camera_tag = (robot.T_camera_link(fiducial.link) @ fiducial.T_link_tag)[:3, :3]
        return self.tag_near(R_camera_tag)

    def tag_near(self, R_camera_tag: Array | None, std_rad: float = np.inf) -> TagPose | None:
        """The tag's pose near a predicted rotation, shape (3, 3), of a standard deviation in rad."""
        left, pattern = self.left, self.arm.tag_pattern
        corners_px = left.tag_corners_px
        if corners_px is None or pattern is None:
            return None
        return find_tag_pose(left.context.grey, corners_px, left.camera, pattern, R_camera_tag, std_rad)

    @cached_property
    def shaft_pose(self) -> ImagePose | Failure:
        """The tool's pose by the left view, through shaft, wrist and distal marker."""
        from svmdist.estimation.instrument.image_pose import pose_by_images

        return pose_by_images(self)

    @cached_property
    def pair_pose(self) -> ImagePose | Failure:
        """The tool's pose by both views."""
        from svmdist.estimation.instrument.image_pose import pose_by_images

        pair = self.scene.stereo_pair
        return pair if isinstance(pair, Failure) else pose_by_images(self, pair)


def prefetch(source: object, names: Iterable[str]) -> dict[str, float]:
    """Compute detections ahead, `right.shaft` where there is a right view; gives by name what each took, in s."""
    seconds, start_s = {}, time.thread_time()
    for name in names:
        found: object = source
        for part in name.split("."):
            found = None if found is None else getattr(found, part)
        now_s = time.thread_time()
        seconds[name], start_s = now_s - start_s, now_s
    return seconds

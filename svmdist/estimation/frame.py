"""One moment of a log as the methods of one instrument see it: images, joints, and what both show."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from svmdist.estimation.scene import Arm, Scene, View, detected
from svmdist.image_input import require_bgr
from svmdist.results import Failure
from svmdist.samples import Image, JointSample, Observation
from svmdist.transforms import Array
from svmdist.vision.regions import Region, find_region
from svmdist.vision.segmentation import Segmenter

if TYPE_CHECKING:
    from svmdist.estimation.instrument.shaft_detection import DistalMarker, ShaftDetection
    from svmdist.estimation.instrument.shaft_fit import ShaftFit
    from svmdist.estimation.instrument.tag_pose import TagPose
    from svmdist.kinematics.robot_state import RobotState
    from svmdist.vision.shaft_segmentation import ShaftRegion
    from svmdist.vision.silhouette import Silhouette


class ToolDetections:
    """The detections of one instrument in one frame."""

    def __init__(
        self,
        arm: Arm,
        scene: Scene,
        left: View,
        right: View | None,
        robot: RobotState | Failure,
    ) -> None:
        self.ledger = scene.ledger
        self.found: dict[str, Any] = {}
        self._arm = arm
        self._settings = arm.profile.settings
        self._scene = scene
        self._left = left
        self._right = right
        self._robot = robot

    @detected
    def tag_corners_px(self) -> Array | None:
        """The corners of the instrument's own tag, shape (4, 2)."""
        fiducial = self._arm.profile.fiducial
        return None if fiducial is None else self._scene.tags.get(fiducial.id)

    @detected
    def right_tag_corners_px(self) -> Array | None:
        """The same in the right view."""
        fiducial = self._arm.profile.fiducial
        return None if fiducial is None else self._scene.right_tags.get(fiducial.id)

    @detected
    def region(self) -> Region | None:
        """The coloured region of the instrument's distal part."""
        return self._region(self._left)

    @detected
    def regions_as_recorded(self) -> tuple[Region | None, Region | None]:
        """Tissue and distal part by the image as it is, as the paper's methods find them.

        First loop: the tissue's region, if larger than its gate (eqs. 1, 2). Second loop: the instrument's (eqs. 7, 8).
        """
        rules, masks = self._arm.profile.segmentation, self._left.masks_as_recorded
        outline = self._settings.outline
        return (
            find_region(masks.tissue, rules.tissue, outline),
            find_region(masks.instrument, rules.instrument, outline),
        )

    @detected
    def right_region(self) -> Region | None:
        """The same in the right view."""
        return None if self._right is None else self._region(self._right)

    def _region(self, view: View) -> Region | None:
        rule = self._arm.profile.segmentation.instrument
        return find_region(view.masks.instrument, rule, self._settings.outline)

    @detected
    def distal_marker(self) -> DistalMarker | None:
        """The coloured marker about the tool's origin; None of a tip that has none."""
        return self._marker(self._left, self.region)

    @detected
    def right_distal_marker(self) -> DistalMarker | None:
        """The same in the right view."""
        return None if self._right is None else self._marker(self._right, self.right_region)

    def _marker(self, view: View, region: Region | None) -> DistalMarker | None:
        from svmdist.estimation.instrument.shaft_detection import detect_distal_marker

        if region is None or view.masks.seen is not None:  # told by shape, it has no colour
            return None
        return detect_distal_marker(
            view.context.hsv, view.masks.instrument, region, self._settings.distal_marker
        )

    @detected
    def tag(self) -> TagPose | None:
        """The tag's pose by the image, its ambiguity decided by nominal kinematics where the image does not."""
        fiducial, R_camera_tag = self._arm.profile.fiducial, None
        if fiducial is not None and not isinstance(self._robot, Failure) and not self._robot.camera_failure:
            R_camera_tag = (self._robot.T_camera_link(fiducial.link) @ fiducial.T_link_tag)[:3, :3]
        return self.tag_turned(R_camera_tag)

    def tag_turned(self, R_camera_tag: Array | None, std_rad: float = np.inf) -> TagPose | None:
        """The tag's pose near a predicted rotation, shape (3, 3), of a standard deviation in rad."""
        from svmdist.estimation.instrument.tag_pose import find_tag_pose

        corners_px, pattern = self.tag_corners_px, self._arm.tag_pattern
        if corners_px is None or pattern is None:
            return None
        return find_tag_pose(
            self._left.context.grey,
            corners_px,
            self._left.camera,
            pattern,
            R_camera_tag,
            std_rad,
            self._settings.tag,
        )

    @detected
    def shaft(self) -> ShaftDetection:
        """The shaft's edges and end."""
        return self._shaft(self._left, self.silhouette, self.tag_corners_px)

    @detected
    def right_shaft(self) -> ShaftDetection | None:
        """The same in the right view; None where there is none."""
        right = self._right
        if right is None:
            return None
        corners_px = None if right.masks.seen is not None else self.right_tag_corners_px
        return self._shaft(right, self._silhouette(right), corners_px)

    def _shaft(self, view: View, silhouette: Silhouette | None, corners_px: Array | None) -> ShaftDetection:
        from svmdist.estimation.instrument.shaft_detection import detect_shaft, detect_silhouette

        if view.masks.seen is not None:
            return detect_silhouette(silhouette, view.camera, self._settings.shaft)
        region = self.shaft_region if view is self._left else self._shaft_region(view, corners_px)
        return detect_shaft(view.context.brightness, region, view.camera, self._settings.shaft)

    @detected
    def silhouette(self) -> Silhouette | None:
        """The silhouette of the instrument's shaft, where the segmentation tells instruments by their shape."""
        return self._silhouette(self._left)

    def _silhouette(self, view: View) -> Silhouette | None:
        from svmdist.estimation.instrument.shaft_model import wrist_shape
        from svmdist.vision.silhouette import find_silhouette

        masks, instrument = view.masks, self._arm.profile.instrument
        if not masks.seen or instrument is None:
            return None
        return find_silhouette(
            view.context.bgr_as_recorded,
            masks.seen[0],
            masks.picture,
            wrist_shape(self._arm.required_chain, instrument),
            self._settings.silhouette,
            self._settings.shaft,
        )

    @detected
    def shaft_region(self) -> ShaftRegion | None:
        """The dark bar that comes in from the border, without the tag's plate on it."""
        return self._shaft_region(self._left, self.tag_corners_px)

    def _shaft_region(self, view: View, corners_px: Array | None) -> ShaftRegion | None:
        from svmdist.vision.shaft_segmentation import bright_fraction, find_shaft
        from svmdist.vision.tags import tag_plate

        rule, masks = self._arm.profile.segmentation.shaft, view.masks
        if rule is None or masks.shaft is None:
            return None
        settings = self._settings.shaft
        covered = None if corners_px is None else tag_plate(corners_px, masks.shaft.shape, self._settings.tag)
        region = find_shaft(masks.shaft, rule, covered, masks.black, settings)
        if region is None or self._arm.profile.fiducial is None or covered is not None or not region.is_stub:
            return region
        # The border may cut the plate, whose black print is then as wide as the shaft and ends where it does.
        return None if bright_fraction(region, masks.shaft) > settings.max_printed_fraction else region

    @detected
    def shaft_fit(self) -> ShaftFit | Failure:
        """The tool's pose by the shaft and the distal marker, through the wrist."""
        from svmdist.estimation.instrument.shaft_detection import wrist_marker
        from svmdist.estimation.instrument.shaft_fit import fit_shaft
        from svmdist.estimation.instrument.shaft_model import shaft_model

        profile, chain = self._arm.profile, self._arm.required_chain
        if profile.instrument is None:
            return Failure(f"profile {profile.name} has no [instrument]")
        model = shaft_model(
            self._robot, chain, profile.instrument, profile.kinematic_error, self._settings.shaft
        )
        return fit_shaft(
            self.shaft,
            self.distal_marker or wrist_marker(self.shaft),
            model,
            self._left.camera,
            self._settings.shaft,
            self._arm.deviations,
        )


OtherMasks = tuple[Image | None, Image | None]
"""Pixels of other instruments in the left and the right image, shape (h, w) each; None where there are none."""


@dataclass(frozen=True)
class Needs:
    """What a method takes: of the log, and which detections, by name, so that they can be computed ahead of it."""

    scene: tuple[str, ...] = ()
    tool: tuple[str, ...] = ()
    robot: bool = True
    """Whether it uses joints or transforms."""
    right_view: bool = False
    """Whether it uses the right image."""

    def __or__(self, other: Needs) -> Needs:
        """What several methods take."""
        return Needs(
            tuple(dict.fromkeys(self.scene + other.scene)),
            tuple(dict.fromkeys(self.tool + other.tool)),
            self.robot or other.robot,
            self.right_view or other.right_view,
        )


@dataclass(frozen=True)
class Frame:
    """What an estimator may use of one instant; it has no field for ground truth.

    `robot` holds joints and nominal poses, or says what of them the log lacks. `scene` and `tool` compute their
    detections when they are first asked for; all methods share them.
    """

    scene: Scene
    arm: Arm
    left: View
    right: View | None
    joints: JointSample | None
    robot: RobotState | Failure
    tool: ToolDetections
    doubt: str = ""
    """Why it is not sure which instrument this is; empty where it is."""

    @property
    def stamp_ns(self) -> int:
        """The image's stamp."""
        return self.scene.observation.stamp_ns

    @property
    def robot_in_camera(self) -> RobotState | Failure:
        """Joints and nominal poses in the camera frame; or what of them the log lacks."""
        if isinstance(self.robot, Failure):
            return self.robot
        return self.robot.camera_failure or self.robot


def frames_of(
    scene: Scene,
    arms: Iterable[Arm],
    observations: Iterable[Observation],
    robots: Iterable[RobotState | Failure],
    others: Iterable[OtherMasks],
    doubts: Iterable[str] | None = None,
) -> list[Frame]:
    """A frame for each instrument, of what it reported and of the pixels that belong to others.

    `doubts` say for each why it may be another one.
    """
    seen = scene.observation
    frames = []
    arms = list(arms)
    doubts = [""] * len(arms) if doubts is None else doubts
    for arm, observation, robot, (in_left, in_right), doubt in zip(
        arms, observations, robots, others, doubts, strict=True
    ):
        left = View(seen.camera, scene.left, in_left)
        right = None
        if scene.right is not None and seen.right is not None:
            right = View(seen.right.camera, scene.right, in_right)
        tool = ToolDetections(arm, scene, left, right, robot)
        frames.append(Frame(scene, arm, left, right, observation.joints, robot, tool, doubt))
    return frames


def frame_of(observation: Observation, arm: Arm, segmenter: Segmenter) -> Frame:
    """The frame of the only instrument of an observation; raises WrongImageError for what is no image of its camera.

    Images of logs are checked when they are decoded; these were made by a caller.
    """
    require_bgr(observation.image_bgr, observation.camera, "image_bgr")
    if observation.right is not None:
        require_bgr(observation.right.image_bgr, observation.right.camera, "right.image_bgr")
    scene = Scene(observation, arm.profile, segmenter)
    return frames_of(scene, [arm], [observation], [arm.state_at(observation)], [(None, None)])[0]


def prefetch(source: object, names: Sequence[str]) -> None:
    """Compute detections of a scene, or of a frame's tool, before they are asked for."""
    for name in names:
        getattr(source, name)


def prefetch_masks(scene: Scene) -> None:
    """Find whole instruments in a scene's images before they are told apart, where segmentation does so."""
    for context in (scene.left, scene.right):
        if context is not None:
            _ = context.masks.seen

"""One moment of a log as the methods of one instrument see it: images, joints, and what both show."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from svmdist.estimation.arm import Arm
from svmdist.estimation.detection.scene import Scene
from svmdist.estimation.detection.tool import ToolDetections
from svmdist.estimation.detection.view import View
from svmdist.image_input import require_bgr
from svmdist.results import Failure
from svmdist.samples import Image, JointSample, Observation
from svmdist.vision.segmentation.segmenter import Segmenter

if TYPE_CHECKING:
    from svmdist.kinematics.robot_state import RobotState

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

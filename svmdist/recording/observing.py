"""Images of a log and what belongs to each: joints, the right image, the believed camera pose."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from svmdist.camera import Camera, stereo_transform
from svmdist.recording.arms import LoggedArm
from svmdist.recording.decoded import OTHER_JOINTS, DecodedMessages
from svmdist.recording.health import Loss, LossKind
from svmdist.recording.messages.checks import DecodeError, EncodedImage, broken_image
from svmdist.recording.messages.decoding import Decoder
from svmdist.recording.messages.images import ImageError
from svmdist.recording.pairing import (
    ArmBuffer,
    Item,
    LoggedImage,
    LoggedJoints,
    LoggedTransforms,
    Matcher,
    RightImage,
)
from svmdist.recording.sources import RawMessage
from svmdist.recording.topics import Role, TopicChoice
from svmdist.recording.transform_buffer import TransformBuffer
from svmdist.samples import (
    ImageSample,
    JointSample,
    Observation,
    Rejection,
    RightView,
    Status,
    TransformsSample,
)
from svmdist.transforms import Array


class Observer:
    """Puts together what an estimator may see; memory does not grow with the log."""

    def __init__(self, messages: DecodedMessages, choice: TopicChoice) -> None:
        self._messages = messages
        self._choice = choice

    def images(self, topic: str) -> Iterator[ImageSample | Rejection]:
        """Yield every image of a topic in file order, decoded; a Rejection stands for one that cannot be."""
        items = self.items(topic)
        return (self._pixels(logged, topic) for logged in items if isinstance(logged, LoggedImage))

    def observations(
        self,
        image_topic: str,
        camera: Camera,
        right_camera: Callable[[], Camera | None],
        arms: Sequence[LoggedArm],
    ) -> Iterator[tuple[Observation, ...] | Rejection]:
        """Yield what belongs to every image of a topic, in file order, for each of the arms.

        The right camera is asked for only where the log has right images: it takes another pass over the log.
        """
        joint_topics = [arm.choice.find(Role.JOINTS) for arm in arms]
        right = self._right_eye(image_topic, camera, right_camera)
        right_topic = None if right is None else right[0]
        buffers = [
            ArmBuffer(TransformBuffer(arm.frames.camera, arm.frames.base), has_joints=topic is not None)
            for arm, topic in zip(arms, joint_topics, strict=True)
        ]
        matcher = Matcher(buffers, has_right=right is not None, has_transforms=self._moving_tf() is not None)
        for matched in matcher.match(self.items(image_topic, joint_topics, right_topic, with_tf=True)):
            image = self._pixels(matched.logged, image_topic)
            if isinstance(image, ImageSample):
                height_px, width_px = image.image_bgr.shape[:2]
                if (width_px, height_px) != (camera.width_px, camera.height_px):
                    detail = f"{width_px}x{height_px} px; the camera has {camera.width_px}x{camera.height_px}"
                    yield Rejection(image.stamp_ns, Status.CORRUPT_IMAGE, detail)
                    continue
                view = None if right is None else self._right_view(matched.right, *right)
                yield tuple(
                    Observation(image.stamp_ns, image.image_bgr, camera, arm.joints, view, arm.T_camera_base)
                    for arm in matched.arms
                )
            else:
                yield image

    def items(
        self,
        image_topic: str,
        joint_topics: Sequence[str | None] = (),
        right_topic: str | None = None,
        *,
        with_tf: bool = False,
    ) -> Iterator[Item]:
        """Yield images of both cameras, joints of every arm and believed transforms, in file order."""
        static = self._choice.static_transforms() if with_tf else ()
        topics = {image_topic, *joint_topics, right_topic, self._moving_tf() if with_tf else None, *static}
        names: dict[str, tuple[str, ...]] = {}
        decoder = Decoder(self._messages.limits)
        for raw in self._messages.source.messages(frozenset(topic for topic in topics if topic is not None)):
            if raw.topic in (image_topic, right_topic):
                image = _encoded_image(decoder, raw)
                logged = LoggedImage(raw.log_time_ns, len(raw.data), raw.offset, image)
                yield logged if raw.topic == image_topic else RightImage(logged)
                continue
            sample = self._messages.decode(decoder, raw)
            if isinstance(sample, TransformsSample):
                yield LoggedTransforms(sample, raw.topic in static)
            if not isinstance(sample, JointSample):
                continue
            if sample.names == names.setdefault(raw.topic, sample.names):
                yield LoggedJoints(sample, joint_topics.index(raw.topic))
            else:
                self._messages.lose(LossKind.MESSAGE, OTHER_JOINTS, raw)

    def _moving_tf(self) -> str | None:
        """The topic of believed transforms that are no static ones."""
        topic = self._choice.find(Role.TF)
        return None if topic in self._choice.static_transforms() else topic

    def _right_eye(
        self, image_topic: str, camera: Camera, right_camera: Callable[[], Camera | None]
    ) -> tuple[str, Camera, Array] | None:
        """The topic of right images, their camera, and `T_left_right`; None where the log has no pair."""
        topic = self._choice.find(Role.RIGHT_IMAGE)
        if topic is None or topic == image_topic:
            return None
        right = right_camera()
        T_left_right = None if right is None else stereo_transform(camera, right)
        return None if right is None or T_left_right is None else (topic, right, T_left_right)

    def _right_view(
        self, logged: LoggedImage | None, topic: str, camera: Camera, T_left_right: Array
    ) -> RightView | None:
        image = None if logged is None else self._pixels(logged, topic)
        if not isinstance(image, ImageSample):
            return None
        if image.image_bgr.shape[:2] != (camera.height_px, camera.width_px):
            return None
        return RightView(image.image_bgr, camera, T_left_right)

    def _pixels(self, logged: LoggedImage, topic: str) -> ImageSample | Rejection:
        image = logged.image
        try:
            return ImageSample(image.stamp_ns, image.frame_id, image.decode())
        except ImageError as problem:
            self._messages.health.add(Loss(LossKind.IMAGE, str(problem), logged.offset, topic))
            return Rejection(image.stamp_ns, Status.CORRUPT_IMAGE, str(problem))


def _encoded_image(decoder: Decoder, raw: RawMessage) -> EncodedImage:
    """Decode all but the pixels; a message that is broken becomes an image that is broken."""
    try:
        image = decoder.decode(raw)
    except DecodeError as error:
        return broken_image(raw.log_time_ns, str(error))
    return image if isinstance(image, EncodedImage) else broken_image(raw.log_time_ns, "no image")

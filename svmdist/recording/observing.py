"""Images of a log and what belongs to each: joints, the right image, the nominal camera pose."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from svmdist.camera import Camera, stereo_transform
from svmdist.perturbations.joints import ReplayedJoints, ReplayedWorld
from svmdist.profile import Limits
from svmdist.recording.messages.checks import DecodeError, EncodedImage, RawTransforms, broken_image
from svmdist.recording.messages.decoding import Decoder, Message
from svmdist.recording.observations import (
    ArmBuffer,
    EncodedObservation,
    Item,
    LoggedImage,
    LoggedJoints,
    LoggedTransforms,
    Matched,
    Matcher,
    Needs,
    RightCamera,
    RightImage,
    TransformBuffer,
    decode_image,
    decode_in_order,
)
from svmdist.recording.source import Health, Loss, LossKind, RawMessage, Source
from svmdist.recording.topics import LoggedArm, Role, TopicChoice
from svmdist.samples import ImageSample, JointSample, Rejection, Sample

OTHER_JOINTS = "its joints are others than those of the first message"


class DecodedMessages:
    """What a source holds, decoded within limits; every call streams the file anew."""

    def __init__(self, source: Source, limits: Limits) -> None:
        self.source = source
        self.limits = limits

    @property
    def health(self) -> Health:
        """What was lost so far."""
        return self.source.health

    def samples(self, *topics: str) -> Iterator[tuple[RawMessage, Sample | EncodedImage]]:
        """Decode the messages of some topics; one that cannot be decoded is a loss."""
        decoder = Decoder(self.limits)
        for raw in self.source.messages(frozenset(topics)):
            message = self.read(decoder, raw)
            if message is not None:
                yield raw, message.to_sample() if isinstance(message, RawTransforms) else message

    def read(self, decoder: Decoder, raw: RawMessage) -> Message | None:
        """Read and check a message; None, and a loss, where it cannot be used."""
        try:
            return decoder.read(raw)
        except DecodeError as problem:
            self.record_loss(LossKind.MESSAGE, str(problem), raw)
            return None

    def record_loss(self, kind: LossKind, detail: str, raw: RawMessage) -> None:
        """Count a message as lost."""
        self.health.add(Loss(kind, detail, raw.offset, raw.topic))


class Observer:
    """Puts together what an estimator may see, in another world if one is given; memory does not grow with the log."""

    def __init__(
        self, messages: DecodedMessages, choice: TopicChoice, world: ReplayedWorld | None = None
    ) -> None:
        self._messages = messages
        self._choice = choice
        self._world = world

    def images(self, topic: str) -> Iterator[ImageSample | Rejection]:
        """Yield every image of a topic in file order, decoded; a Rejection stands for one that cannot be."""
        for logged in self.items(topic):
            if isinstance(logged, LoggedImage):
                losses: list[Loss] = []
                image = decode_image(logged, topic, losses)
                for loss in losses:
                    self._messages.health.add(loss)
                yield image

    def observations(
        self,
        image_topic: str,
        camera: Camera,
        right_camera: Callable[[], Camera | None],
        arms: Sequence[LoggedArm],
        needs: Needs,
    ) -> Iterator[EncodedObservation]:
        """Yield what belongs to every image of a topic, in file order, for each of the arms.

        The right camera is asked for only where the log has right images: it takes another pass over the log.
        """
        joint_topics = [arm.choice.find(Role.JOINTS) for arm in arms]
        right = self._right_camera(image_topic, camera, right_camera) if needs.right else None
        buffers = [
            ArmBuffer(
                TransformBuffer(arm.frames.camera, arm.frames.base),
                has_joints=needs.joints and topic is not None,
                fixed=arm.fixed,
            )
            for arm, topic in zip(arms, joint_topics, strict=True)
        ]
        has_transforms = needs.transforms and self._moving_tf() is not None
        lag_ns = 0 if self._world is None else self._world.lag_ns

        def repeated(logged: LoggedImage) -> None:
            stamp = f"an image of {logged.image.stamp_ns} ns"
            detail = f"{stamp} repeats a stamp, or comes too far behind later ones; it is left out"
            self._messages.health.add(Loss(LossKind.MESSAGE, detail, logged.offset, image_topic))

        matcher = Matcher(
            buffers,
            has_right=right is not None,
            has_transforms=has_transforms,
            lag_ns=lag_ns,
            pair_tolerance_ns=round(self._messages.limits.pair_tolerance_s * 1e9),
            on_repeat=repeated,
        )
        items = self.items(image_topic, joint_topics, None if right is None else right.topic, with_tf=True)
        if self._world is not None:
            joints = [self._world.joints_of(arm.name) for arm in arms]
            items = _in_world(items, joints, self._world.lag_ns)
        for matched in matcher.match(item for item in items if _is_needed(item, needs)):
            place = self._messages.health.next_place()
            yield EncodedObservation(_decoded_in_order(matched), camera, image_topic, right, place)

    def items(
        self,
        image_topic: str,
        joint_topics: Sequence[str | None] = (),
        right_topic: str | None = None,
        *,
        with_tf: bool = False,
    ) -> Iterator[Item]:
        """Yield images of both cameras, joints of every arm and nominal transforms, in file order."""
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
            message = self._messages.read(decoder, raw)
            if isinstance(message, RawTransforms):
                yield LoggedTransforms(message, raw.topic in static)
            if not isinstance(message, JointSample):
                continue
            if message.names == names.setdefault(raw.topic, message.names):
                yield LoggedJoints(message, joint_topics.index(raw.topic))
            else:
                self._messages.record_loss(LossKind.MESSAGE, OTHER_JOINTS, raw)

    def _moving_tf(self) -> str | None:
        """The topic of nominal transforms that are no static ones."""
        topic = self._choice.find(Role.TF)
        return None if topic in self._choice.static_transforms() else topic

    def _right_camera(
        self, image_topic: str, camera: Camera, right_camera: Callable[[], Camera | None]
    ) -> RightCamera | None:
        """The right camera of a stereo pair; None where the log has no pair."""
        topic = self._choice.find(Role.RIGHT_IMAGE)
        if topic is None or topic == image_topic:
            return None
        right = right_camera()
        T_left_right = None if right is None else stereo_transform(camera, right)
        return None if right is None or T_left_right is None else RightCamera(topic, right, T_left_right)


def _in_world(items: Iterator[Item], joints: Sequence[ReplayedJoints | None], lag_ns: int) -> Iterator[Item]:
    """The same with the joints of each arm perturbed, and joints and transforms on the clock of the images."""
    for item in items:
        replayed = joints[item.arm] if isinstance(item, LoggedJoints) else None
        if isinstance(item, LoggedTransforms) and lag_ns:
            yield replace(item, stated=item.stated.stamped_later(lag_ns))
        elif replayed is None or not isinstance(item, LoggedJoints):
            yield item
        else:
            yield from (LoggedJoints(sample, item.arm) for sample in replayed.replayed(item.sample))


def _is_needed(item: Item, needs: Needs) -> bool:
    match item:
        case LoggedJoints():
            return needs.joints
        case LoggedTransforms():
            return needs.transforms
        case _:
            return True


def _decoded_in_order(matched: Matched) -> Matched:
    """The same, with frames of videos decoded."""
    left, right = (
        None if logged is None else replace(logged, image=decode_in_order(logged.image))
        for logged in (matched.logged, matched.right)
    )
    assert left is not None
    return replace(matched, logged=left, right=right)


def _encoded_image(decoder: Decoder, raw: RawMessage) -> EncodedImage:
    """Decode all but the pixels; a message that is broken becomes an image that is broken."""
    try:
        image = decoder.decode(raw)
    except DecodeError as error:
        return broken_image(raw.log_time_ns, str(error))
    return image if isinstance(image, EncodedImage) else broken_image(raw.log_time_ns, "no image")

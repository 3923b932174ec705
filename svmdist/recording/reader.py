"""Opening recordings: the one way in which everything else reads logs, whatever their format."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path

import numpy as np

from svmdist.camera import Camera, stereo_transform
from svmdist.errors import RecordingError
from svmdist.profile import Frames, Limits, Profile
from svmdist.recording.health import Health, Loss, LossKind
from svmdist.recording.messages.checks import DecodeError, EncodedImage, broken_image
from svmdist.recording.messages.decoding import Decoder
from svmdist.recording.messages.images import ImageError
from svmdist.recording.names import plain, plain_list
from svmdist.recording.opening import open_source
from svmdist.recording.pairing import Item, LoggedImage, LoggedTransforms, Matcher, RightImage
from svmdist.recording.sources import RawMessage, Source, TopicInfo
from svmdist.recording.topics import Role, TopicChoice
from svmdist.recording.transform_buffer import TransformBuffer
from svmdist.recording.transform_tree import TransformTree
from svmdist.samples import (
    CameraSample,
    DistanceSample,
    ImageSample,
    JointSample,
    Observation,
    PoseSample,
    Rejection,
    RightView,
    Sample,
    Status,
    TransformsSample,
)
from svmdist.tracks import DistanceTrack, JointTrack, PoseTrack, TransformTrack, sort_stamps
from svmdist.transforms import Array

OTHER_JOINTS = "its joints are others than those of the first message"


def open_recording(
    path: Path | str,
    profile: Profile,
    *,
    limits: Limits | None = None,
    topics: Mapping[str, str] | None = None,
) -> Recording:
    """Open a recording; `topics` overrides the profile's, by role: `{"image": "/left/image_raw"}`.

    `limits` replaces the profile's.
    Raises RecordingError in one line for a file that is missing, empty, or no recording, and UsageError
    for an unknown role. What is lost later while reading is counted in `health`.
    """
    limits = limits or profile.limits
    source = open_source(Path(path), limits)
    choice = TopicChoice(source.topics(), profile.topics, topics or {}, source.path.name)
    return Recording(source, choice, limits, profile.frames)


class Recording:
    """A log that can be read, over and over; every call streams the file anew and keeps nothing of it."""

    def __init__(self, source: Source, choice: TopicChoice, limits: Limits, frames: Frames) -> None:
        self._source = source
        self._choice = choice
        self._limits = limits
        self._frames = frames

    @property
    def path(self) -> Path:
        """The file or folder."""
        return self._source.path

    @property
    def name(self) -> str:
        """The file's name without its suffix."""
        return self._source.path.stem

    @property
    def health(self) -> Health:
        """What was lost so far; complete after a pass over the whole log."""
        return self._source.health

    @cached_property
    def metadata(self) -> dict[str, str]:
        """The pairs of the metadata record `svmdist`; empty where there is none."""
        return self._source.metadata()

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics, sorted by name."""
        return self._source.topics()

    def topic_of(self, role: Role | str) -> str | None:
        """Name the topic that plays a role; None where the log has none."""
        return self._choice.find(Role(role))

    @cached_property
    def camera(self) -> Camera:
        """The first camera calibration; RecordingError where there is none."""
        topic = self._choice.require(Role.CAMERA_INFO)
        camera = self._first_camera(topic)
        if camera is None:
            raise RecordingError(f"{self.path.name}: no usable camera calibration on {plain(topic)}")
        return camera

    @cached_property
    def right_camera(self) -> Camera | None:
        """The right camera's first calibration; None where the log has none of its own."""
        topic = self._choice.find(Role.RIGHT_CAMERA_INFO)
        if topic is None or topic == self._choice.find(Role.CAMERA_INFO):
            return None
        return self._first_camera(topic)

    def images(self) -> Iterator[ImageSample | Rejection]:
        """Yield every image in file order, decoded; a Rejection stands for one that cannot be."""
        topic = self._choice.require(Role.IMAGE)
        items = self._items(topic)
        return (self._pixels(logged, topic) for logged in items if isinstance(logged, LoggedImage))

    def observations(self) -> Iterator[Observation | Rejection]:
        """Yield what an estimator may see of every image, in file order; memory does not grow with the log.

        Joints and the believed camera-to-base transform are interpolated to the image's stamp between samples
        at most 0.1 s apart. The right image is the one within half a millisecond, where the cameras form a
        stereo pair. Each is None where the log has none. Raises RecordingError at once where the log has no
        images or no camera.
        """
        return self._observations(self._choice.require(Role.IMAGE), self.camera)

    def joint_track(self) -> JointTrack:
        """Read all joint states."""
        topic = self._choice.require(Role.JOINTS)
        samples: list[JointSample] = []
        for raw, sample in self._samples(topic):
            if not isinstance(sample, JointSample):
                continue
            if samples and sample.names != samples[0].names:
                self._lose(LossKind.MESSAGE, OTHER_JOINTS, raw)
                continue
            samples.append(sample)
        if not samples:
            raise RecordingError(f"{self.path.name}: no usable joint states on {plain(topic)}")
        stamps_ns = np.array([sample.stamp_ns for sample in samples], np.int64)
        order = sort_stamps(stamps_ns)
        positions = np.array([sample.positions for sample in samples])
        return JointTrack(stamps_ns[order], samples[0].names, positions[order])

    def transform_track(self, parent: str, child: str, *, ground_truth: bool = False) -> TransformTrack:
        """Read `T_parent_child` over time, composed along the tree of the believed or the true transforms.

        Raises RecordingError where the log has no transforms, or none that link the two frames.
        """
        return self.transform_tree(ground_truth=ground_truth).track(parent, child)

    def transform_tree(self, *, ground_truth: bool = False) -> TransformTree:
        """Read all transforms, those that the robot believes or those that are true."""
        if ground_truth:
            static: tuple[str, ...] = ()
            moving: str | None = self._choice.require(Role.GROUND_TRUTH_TF)
        else:
            static = self._choice.static_transforms()
            moving = self._choice.find(Role.TF) if static else self._choice.require(Role.TF)
        tree = TransformTree()
        for raw, sample in self._samples(*static, *([moving] if moving else [])):
            if isinstance(sample, TransformsSample):
                for transform in sample.transforms:
                    tree.add(transform, is_static=raw.topic in static)
        return tree

    def pose_track(self) -> PoseTrack:
        """Read all poses; RecordingError where their frame changes."""
        topic = self._choice.require(Role.POSE)
        samples = [sample for _, sample in self._samples(topic) if isinstance(sample, PoseSample)]
        frames = sorted({sample.frame_id for sample in samples})
        if len(frames) != 1:
            found = f"poses in several frames: {plain_list(frames)}" if frames else "no usable poses"
            raise RecordingError(f"{self.path.name}: {found} on {plain(topic)}")
        stamps_ns = np.array([sample.stamp_ns for sample in samples], np.int64)
        order = sort_stamps(stamps_ns)
        return PoseTrack(frames[0], stamps_ns[order], np.array([s.T_frame_pose for s in samples])[order])

    def distance_track(self) -> DistanceTrack:
        """Read all true distances."""
        topic = self._choice.require(Role.GROUND_TRUTH_DISTANCE)
        samples = [sample for _, sample in self._samples(topic) if isinstance(sample, DistanceSample)]
        stamps_ns = np.array([sample.stamp_ns for sample in samples], np.int64)
        rows = np.array([(s.planar_m, s.spatial_m, s.clearance_m) for s in samples]).reshape(-1, 3)
        order = sort_stamps(stamps_ns)
        return DistanceTrack(stamps_ns[order], *rows[order].T)

    def raw_messages(self) -> Iterator[RawMessage]:
        """Yield every message of every topic in file order, not decoded."""
        return self._source.messages()

    def size_bytes(self) -> int:
        """Size of the file, or of all files of a folder."""
        return sum(file.stat().st_size for file in self._files())

    def sha256(self) -> str:
        """Hash the file, or the files of a folder in the order of their names, as hexadecimal digits."""
        digest = hashlib.sha256()
        for file in self._files():
            try:
                with file.open("rb") as stream:
                    while piece := stream.read(1 << 20):
                        digest.update(piece)
            except OSError as problem:
                raise RecordingError(f"{file}: cannot read: {problem.strerror or problem}") from None
        return digest.hexdigest()

    def _files(self) -> list[Path]:
        return (
            sorted(file for file in self.path.iterdir() if file.is_file())
            if self.path.is_dir()
            else [self.path]
        )

    def _samples(self, *topics: str) -> Iterator[tuple[RawMessage, Sample | EncodedImage]]:
        """Decode the messages of some topics; one that cannot be decoded is a loss."""
        decoder = Decoder(self._limits)
        for raw in self._source.messages(frozenset(topics)):
            sample = self._decode(decoder, raw)
            if sample is not None:
                yield raw, sample

    def _decode(self, decoder: Decoder, raw: RawMessage) -> Sample | EncodedImage | None:
        try:
            return decoder.decode(raw)
        except DecodeError as problem:
            self._lose(LossKind.MESSAGE, str(problem), raw)
            return None

    def _observations(self, image_topic: str, camera: Camera) -> Iterator[Observation | Rejection]:
        joint_topic = self._choice.find(Role.JOINTS)
        right = self._right_eye(image_topic, camera)
        right_topic = None if right is None else right[0]
        wants = {JointSample: joint_topic, RightImage: right_topic, LoggedTransforms: self._moving_tf()}
        matcher = Matcher(
            TransformBuffer(self._frames.camera, self._frames.base),
            frozenset(kind for kind, topic in wants.items() if topic is not None),
        )
        for matched in matcher.match(self._items(image_topic, joint_topic, right_topic, with_tf=True)):
            image = self._pixels(matched.logged, image_topic)
            if isinstance(image, ImageSample):
                height_px, width_px = image.image_bgr.shape[:2]
                if (width_px, height_px) != (camera.width_px, camera.height_px):
                    detail = f"{width_px}x{height_px} px; the camera has {camera.width_px}x{camera.height_px}"
                    yield Rejection(image.stamp_ns, Status.CORRUPT_IMAGE, detail)
                    continue
                yield Observation(
                    image.stamp_ns,
                    image.image_bgr,
                    camera,
                    matched.joints,
                    None if right is None else self._right_view(matched.right, *right),
                    matched.T_camera_base,
                )
            else:
                yield image

    def _items(
        self,
        image_topic: str,
        joint_topic: str | None = None,
        right_topic: str | None = None,
        *,
        with_tf: bool = False,
    ) -> Iterator[Item]:
        """Yield images of both cameras, joints and believed transforms, in file order."""
        static = self._choice.static_transforms() if with_tf else ()
        topics = {image_topic, joint_topic, right_topic, self._moving_tf() if with_tf else None, *static}
        names: tuple[str, ...] | None = None
        decoder = Decoder(self._limits)
        for raw in self._source.messages(frozenset(topic for topic in topics if topic is not None)):
            if raw.topic in (image_topic, right_topic):
                image = _encoded_image(decoder, raw)
                logged = LoggedImage(raw.log_time_ns, len(raw.data), raw.offset, image)
                yield logged if raw.topic == image_topic else RightImage(logged)
                continue
            sample = self._decode(decoder, raw)
            if isinstance(sample, TransformsSample):
                yield LoggedTransforms(sample, raw.topic in static)
            if not isinstance(sample, JointSample):
                continue
            names = names or sample.names
            if sample.names == names:
                yield sample
            else:
                self._lose(LossKind.MESSAGE, OTHER_JOINTS, raw)

    def _first_camera(self, topic: str) -> Camera | None:
        return next(
            (sample.camera for _, sample in self._samples(topic) if isinstance(sample, CameraSample)), None
        )

    def _moving_tf(self) -> str | None:
        """The topic of believed transforms that are no static ones."""
        topic = self._choice.find(Role.TF)
        return None if topic in self._choice.static_transforms() else topic

    def _right_eye(self, image_topic: str, camera: Camera) -> tuple[str, Camera, Array] | None:
        """The topic of right images, their camera, and `T_left_right`; None where the log has no pair."""
        topic = self._choice.find(Role.RIGHT_IMAGE)
        if topic is None or topic == image_topic or self.right_camera is None:
            return None
        T_left_right = stereo_transform(camera, self.right_camera)
        return None if T_left_right is None else (topic, self.right_camera, T_left_right)

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
            self.health.add(Loss(LossKind.IMAGE, str(problem), logged.offset, topic))
            return Rejection(image.stamp_ns, Status.CORRUPT_IMAGE, str(problem))

    def _lose(self, kind: LossKind, detail: str, raw: RawMessage) -> None:
        self.health.add(Loss(kind, detail, raw.offset, raw.topic))


def _encoded_image(decoder: Decoder, raw: RawMessage) -> EncodedImage:
    """Decode all but the pixels; a message that is broken becomes an image that is broken."""
    try:
        image = decoder.decode(raw)
    except DecodeError as error:
        return broken_image(raw.log_time_ns, str(error))
    return image if isinstance(image, EncodedImage) else broken_image(raw.log_time_ns, "no image")

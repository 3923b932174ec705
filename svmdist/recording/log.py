"""Opening recordings: the one way in which everything else reads logs, whatever their format."""

from __future__ import annotations

import math
import os
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.errors import RecordingError, did_you_mean
from svmdist.input_file import LogPath, open_regular, why
from svmdist.perturbations.calibration import stated_camera, stated_right_camera
from svmdist.perturbations.chosen import UNPERTURBED, Perturbations
from svmdist.perturbations.joints import ReplayedWorld, later_ns
from svmdist.profile import Limits, Profile
from svmdist.recording.mcap_file.framing import MAGIC as MCAP_MAGIC
from svmdist.recording.mcap_file.source import McapSource
from svmdist.recording.observations import EVERYTHING, Decoded, EncodedObservation, Needs
from svmdist.recording.observing import OTHER_JOINTS, DecodedMessages, Observer
from svmdist.recording.rosbag import METADATA_FILE
from svmdist.recording.source import (
    ZSTD_MAGIC,
    Health,
    Loss,
    LossKind,
    RawMessage,
    Source,
    TopicInfo,
    is_message_compressed,
    sanitize,
    sanitize_list,
)
from svmdist.recording.tf_tree import TransformTree
from svmdist.recording.topics import FixedTransform, LoggedArm, Role, find_arms
from svmdist.remote_file import RemoteFile, is_url
from svmdist.samples import (
    CameraSample,
    DistanceSample,
    ImageSample,
    JointSample,
    Observation,
    PoseSample,
    Rejection,
    TransformsSample,
)
from svmdist.tracks import DistanceTrack, JointTrack, PoseTrack, TransformTrack, sort_stamps
from svmdist.transforms import inverse


class HasStamp(Protocol):
    """An image, in whatever form."""

    @property
    def stamp_ns(self) -> int:
        """Its stamp."""


Stamped = TypeVar("Stamped", bound=HasStamp)
OUT_OF_ORDER_S = 1.0
"""Images may stand so much out of order in a file: reading goes on this long after the end of a window."""


@dataclass(frozen=True, slots=True)
class Window:
    """Images from `start_s` to `end_s` after the first one, both included, and of these every `every`-th one."""

    start_s: float = 0.0
    end_s: float = math.inf
    every: int = 1

    def of(self, images: Iterable[Stamped]) -> Iterator[Stamped]:
        """The images inside."""
        return (image for _, _, image in self.numbered(images))

    def numbered(self, images: Iterable[Stamped]) -> Iterator[tuple[int, int, Stamped]]:
        """The images inside, each with its number among all and its time since the first one in ns."""
        first_ns: int | None = None
        count = 0
        for number, image in enumerate(images):
            first_ns = image.stamp_ns if first_ns is None else first_ns
            # In whole nanoseconds: an image at exactly 0.1 s is inside of a window that begins at 0.1 s.
            at_ns = image.stamp_ns - first_ns
            if at_ns > (self.end_s + OUT_OF_ORDER_S) * 1e9:
                return
            if not round(self.start_s * 1e9) <= at_ns <= self.end_s * 1e9 + 0.5:
                continue
            if count % self.every == 0:
                yield number, at_ns, image
            count += 1

    def count_of(self, image_count: int) -> int | None:
        """How many of so many images are inside; None where that depends on their stamps."""
        if self.start_s > 0.0 or self.end_s < math.inf:
            return None
        return -(-image_count // self.every)

    def places(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.intp]:
        """Which of rising stamps, shape (n,), are inside, counted from the first one."""
        if len(stamps_ns) == 0:
            return np.zeros(0, np.intp)
        at_ns = stamps_ns - stamps_ns[0]
        inside = (at_ns >= round(self.start_s * 1e9)) & (at_ns <= self.end_s * 1e9 + 0.5)
        return np.flatnonzero(inside)[:: self.every]


@dataclass(frozen=True, slots=True)
class Reading:
    """The name that a recording goes by, None for its file's, and its window, None for all images."""

    name: str | None = None
    window: Window | None = None


def unique_names(paths: Sequence[LogPath]) -> list[str]:
    """A name for each recording: the file's without its ending, with as many folders before it as tell it from others.

    >>> unique_names([Path("logs/a/contact.mcap"), Path("logs/b/contact.mcap"), Path("sweep.mcap")])
    ['a/contact', 'b/contact', 'sweep']
    """
    parts = [(*_folders(path), path.stem) for path in paths]
    depths = dict.fromkeys(parts, 1)
    while True:
        sharing: dict[str, list[tuple[str, ...]]] = {}
        for part, depth in depths.items():
            sharing.setdefault("/".join(part[-depth:]), []).append(part)
        clashing = [part for of in sharing.values() if len(of) > 1 for part in of if depths[part] < len(part)]
        if not clashing:
            return ["/".join(part[-depths[part] :]) for part in parts]
        for part in clashing:
            depths[part] += 1


def _folders(path: LogPath) -> tuple[str, ...]:
    if isinstance(path, RemoteFile):
        return path.folders
    return Path(os.path.abspath(path)).parent.parts[1:]


ROSBAG_MAGIC = b"#ROSBAG V2.0\n"
SQLITE_MAGIC = b"SQLite format 3\x00"

LOOKS_LIKE = {
    b"#ROSBAG V1": "a ROS bag of version 1, from before 2010",
    b"\x1f\x8b": "gzip-compressed",
    ZSTD_MAGIC: "zstd-compressed",
    b"\x04\x22\x4d\x18": "lz4-compressed",
    b"BZh": "bzip2-compressed",
    b"\xfd7zXZ": "xz-compressed",
    b"PK\x03\x04": "a zip archive",
    b"\x89HDF": "an HDF5 file",
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"version https://git-lfs": "a Git LFS pointer, whose file has not been fetched",
}


# The modules of other formats are imported when a file of theirs is opened: MCAP starts sooner without them.
WHAT_IS_EXPECTED = "an MCAP file, a ROS 1 bag or a rosbag2 folder"


def open_source(path: LogPath, limits: Limits) -> Source:
    """Open a recording; RecordingError says in one line why a path cannot be one."""
    try:
        if not isinstance(path, RemoteFile) and path.is_dir():
            if (path / METADATA_FILE).is_file():
                from svmdist.recording.rosbag.bag2_source import Rosbag2Source

                return Rosbag2Source(path, limits)
            detail = f"a directory without {METADATA_FILE}"
            raise RecordingError(f"{path}: is {detail}; expected {WHAT_IS_EXPECTED}")
        with open_regular(path) as file:
            start = file.read(64)
    except FileNotFoundError:
        raise RecordingError(f"{path}: no such file") from None
    except (OSError, ValueError) as problem:
        raise RecordingError(f"{path}: cannot read: {why(problem)}") from None
    source = _open_file(path, start, limits)
    if is_message_compressed(source):
        raise RecordingError(
            f"{path}: a rosbag2 file whose messages are compressed one by one;"
            f" open the folder that holds it and its {METADATA_FILE}"
        )
    return source


def _open_file(path: LogPath, start: bytes, limits: Limits) -> Source:
    if not start:
        raise RecordingError(f"{path}: is empty; expected {WHAT_IS_EXPECTED}")
    if start.startswith(MCAP_MAGIC):
        return McapSource(path, limits)
    if start.startswith(ROSBAG_MAGIC):
        from svmdist.recording.rosbag.bag1_source import Rosbag1Source

        return Rosbag1Source(path, limits)
    if start.startswith(SQLITE_MAGIC):
        if isinstance(path, RemoteFile):
            raise RecordingError(
                f"{path}: a rosbag2 database is read from a disk only; copy it to this machine"
            )
        from svmdist.recording.rosbag.sqlite_source import SqliteSource

        return SqliteSource(path, limits)
    if MCAP_MAGIC.startswith(start):
        raise RecordingError(
            f"{path}: truncated at byte {len(start)}, inside the first bytes of an MCAP file"
        )
    found = next((what for magic, what in LOOKS_LIKE.items() if start.startswith(magic)), None)
    raise RecordingError(f"{path}: is {found or 'no recording'}; expected {WHAT_IS_EXPECTED}")


AS_IT_IS = Reading()


def open_recording(
    path: LogPath | str,
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
    if isinstance(path, str):
        path = RemoteFile(path) if is_url(path) else Path(path)
    source = open_source(path, limits)
    recording = Recording(source, find_arms(source, profile, topics or {}), limits)
    recording.origin = (path, profile, limits, dict(topics or {}))
    return recording


def files_of(path: LogPath) -> list[LogPath]:
    """A file, or the files of a folder in the order of their names."""
    if isinstance(path, RemoteFile) or not path.is_dir():
        return [path]
    return [*sorted(file for file in path.iterdir() if file.is_file())]


def content_sha256(path: LogPath) -> str:
    """Hash a file, or the files of a folder in the order of their names, as hexadecimal digits."""
    import hashlib

    digest = hashlib.sha256()
    for file in files_of(path):
        try:
            with open_regular(file) as stream:
                while piece := stream.read(1 << 20):
                    digest.update(piece)
        except OSError as problem:
            raise RecordingError(f"{file}: cannot read: {problem.strerror or problem}") from None
    return digest.hexdigest()


def _reopen(
    path: LogPath,
    profile: Profile,
    limits: Limits,
    topics: dict[str, str],
    lag: KnownLag | None,
    how: Reading,
) -> Recording:
    recording = open_recording(path, profile, limits=limits, topics=topics).read_as(how)
    return recording if lag is None else recording.with_lag(lag, profile)


@dataclass(frozen=True, slots=True)
class KnownLag:
    """By how much the stamps of a log's images are late, in s, and the standard deviation of what was estimated."""

    lag_s: float
    std_s: float = 0.0

    @property
    def lag_ns(self) -> int:
        """The same in ns."""
        return round(self.lag_s * 1e9)


class Recording:
    """A log that can be read, over and over; every call streams the file anew and keeps nothing of it.

    With several instruments in it, all but `observations_of` is about the first one; `for_instrument` gives the
    same log as another one sees it.
    """

    def __init__(
        self,
        source: Source,
        arms: Sequence[LoggedArm],
        limits: Limits,
        world: ReplayedWorld | None = None,
        lag: KnownLag | None = None,
        how: Reading = AS_IT_IS,
    ) -> None:
        self._how = how
        self._source = source
        self._arms = tuple(arms)
        self._limits = limits
        self._choice = arms[0].choice
        self._messages = DecodedMessages(source, limits)
        self._world = world
        self._observer = Observer(self._messages, self._choice, world)
        self.lag = lag
        """The lag of the images that is known, and taken off; None where nothing is known of it."""
        self.origin: tuple[LogPath, Profile, Limits, dict[str, str]] | None = None
        """What it was opened by, so that another process can open it too."""

    def __reduce__(self) -> tuple[Callable[..., Recording], tuple[object, ...]]:
        """Another process opens the same file anew."""
        if self.origin is None:
            raise TypeError("only a recording as it was opened can be sent to another process")
        return _reopen, (*self.origin, self.lag, self._how)

    @property
    def instruments(self) -> tuple[str, ...]:
        """Names of the instruments in the log: the profile's own, and the others that have a topic in it."""
        return tuple(arm.name for arm in self._arms)

    def for_instrument(self, name: str) -> Recording:
        """The same log as one of its instruments sees it; RecordingError lists those that there are."""
        return Recording(self._source, [self._arm(name)], self._limits, self._world, self.lag, self._how)

    def perturbed(self, perturbations: Perturbations, profile: Profile) -> Recording:
        """The same log as it would be in a perturbed world: joints, their stamps, and what it says of its cameras.

        Images and ground truth stay. `profile` is the one that the log was opened with. What is drawn, as noise is,
        is drawn by the seed that `record` wrote into the log, else by 0.
        """
        seed = self.metadata.get("seed", "")
        world = ReplayedWorld(perturbations, profile, int(seed) if seed.isdecimal() else 0, self._lag_ns)
        return Recording(self._source, self._arms, self._limits, world, self.lag, self._how)

    def with_lag(self, lag: KnownLag, profile: Profile) -> Recording:
        """The same log with its clocks put right: joints, poses and transforms get the stamps that its images have.

        Images keep their stamps, and so does ground truth. `profile` is the one that the log was opened with.
        """
        before = self._world or ReplayedWorld(UNPERTURBED, profile)
        world = replace(before, lag_ns=lag.lag_ns)
        recording = Recording(self._source, self._arms, self._limits, world, lag, self._how)
        recording.origin = self.origin
        return recording

    def read_as(self, how: Reading) -> Recording:
        """The same log under another name, or some of its images; whatever else it has is read whole."""
        recording = Recording(self._source, self._arms, self._limits, self._world, self.lag, how)
        recording.origin = self.origin
        return recording

    def with_bases(self, fixed: Mapping[str, FixedTransform]) -> Recording:
        """The same log with the camera-to-base transforms of some instruments, by name, in place of its own."""
        arms = [replace(arm, fixed=fixed.get(arm.name, arm.fixed)) for arm in self._arms]
        return Recording(self._source, arms, self._limits, self._world, self.lag, self._how)

    @property
    def _lag_ns(self) -> int:
        return 0 if self.lag is None else self.lag.lag_ns

    @property
    def world_seed(self) -> int:
        """The seed of what is drawn of a perturbed world; 0 for the log as it is."""
        return 0 if self._world is None else self._world.seed

    def _arm(self, name: str) -> LoggedArm:
        for arm in self._arms:
            if arm.name == name:
                return arm
        known = did_you_mean(name, self.instruments)
        raise RecordingError(f"{self.path.name}: no topic of an instrument {sanitize(name)}: {known}")

    @property
    def limits(self) -> Limits:
        """What a message may take at most."""
        return self._limits

    @property
    def path(self) -> LogPath:
        """The file or folder, or the URL."""
        return self._source.path

    @property
    def name(self) -> str:
        """The file's name without its suffix, or the one that it goes by."""
        return self._how.name or self._source.path.stem

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

    def image_count(self) -> int | None:
        """How many images are read of those that the file says it has; None where neither is known beforehand."""
        topic = self._choice.find(Role.IMAGE)
        count = next((info.message_count for info in self.topics() if info.topic == topic), None)
        return count if count is None or self._how.window is None else self._how.window.count_of(count)

    @cached_property
    def camera(self) -> Camera:
        """The first camera calibration, as a perturbed world states it; RecordingError where there is none."""
        camera = self.logged_camera
        return camera if self._world is None else stated_camera(camera, self._world.perturbations)

    @cached_property
    def logged_camera(self) -> Camera:
        """The first camera calibration as the file has it; RecordingError where there is none."""
        topic = self._choice.require(Role.CAMERA_INFO)
        camera = self._first_camera(topic)
        if camera is None:
            raise RecordingError(f"{self.path.name}: no usable camera calibration on {sanitize(topic)}")
        return camera

    @cached_property
    def right_camera(self) -> Camera | None:
        """The right camera's first calibration; None where the log has none of its own."""
        topic = self._choice.find(Role.RIGHT_CAMERA_INFO)
        if topic is None or topic == self._choice.find(Role.CAMERA_INFO):
            return None
        camera = self._first_camera(topic)
        if camera is None or self._world is None:
            return camera
        return stated_right_camera(camera, self._world.perturbations)

    def images(self) -> Iterator[ImageSample | Rejection]:
        """Yield every image in file order, decoded; a Rejection stands for one that cannot be."""
        topic = self._choice.require(Role.IMAGE)
        return self._observer.images(topic)

    def observations(self) -> Iterator[Observation | Rejection]:
        """Yield what an estimator may see of every image, in file order; memory does not grow with the log.

        Joints and the nominal camera-to-base transform are interpolated to the image's stamp between samples
        at most 0.1 s apart. The right image is the one within `[limits] pair_tolerance_s`, where the cameras form a
        stereo pair. Each is None where the log has none. Raises RecordingError at once where the log has no
        images or no camera.
        """
        found = self.observations_of(self.instruments[:1])
        return (item if isinstance(item, Rejection) else item[0] for item in found)

    def observations_of(
        self, names: Sequence[str], needs: Needs = EVERYTHING
    ) -> Iterator[tuple[Observation, ...] | Rejection]:
        """Yield for every image what estimators may see of each instrument; each image is decoded once.

        What `needs` leaves out is None in the observations.
        """
        return (self.record_losses(one.decode()) for one in self.encoded_observations(names, needs))

    def encoded_observations(
        self, names: Sequence[str], needs: Needs = EVERYTHING
    ) -> Iterator[EncodedObservation]:
        """Yield the same as `observations_of`, not decoded yet, for a caller that decodes in threads.

        One thread at a time goes through the iterator, any thread decodes, and `record_losses` takes the results.
        The caller holds what is not decoded yet, and bounds how many. Frames of a video are decoded here,
        for they refer to each other.
        """
        return (one for _, _, one in self.numbered_observations(names, needs))

    def numbered_observations(
        self, names: Sequence[str], needs: Needs = EVERYTHING
    ) -> Iterator[tuple[int, int, EncodedObservation]]:
        """Yield the same, each with its image's number in the log and its time since the log's first image in ns."""
        arms = [self._arm(name) for name in names]
        images = self._observer.observations(
            self._choice.require(Role.IMAGE), self.camera, lambda: self.right_camera, arms, needs
        )
        return (self._how.window or Window()).numbered(images)

    def record_losses(self, decoded: Decoded) -> tuple[Observation, ...] | Rejection:
        """Add what was lost in decoding to `health`, in file order whatever the order of calls; give the rest back."""
        for loss in decoded.losses:
            self.health.add(loss, decoded.place)
        return decoded.found

    def joint_samples(self, on_sample: Callable[[], None] | None = None) -> Iterator[JointSample]:
        """Yield the joint states in the order of the file, all of the same joints; others are counted as lost.

        `on_sample` hears of each.
        """
        topic = self._choice.require(Role.JOINTS)
        names: tuple[str, ...] | None = None
        replayed = None if self._world is None else self._world.joints_of(self._arms[0].name)
        for raw, sample in self._messages.samples(topic):
            if not isinstance(sample, JointSample):
                continue
            if on_sample is not None:
                on_sample()
            names = names or sample.names
            if sample.names != names:
                self._messages.record_loss(LossKind.MESSAGE, OTHER_JOINTS, raw)
                continue
            yield from [sample] if replayed is None else replayed.replayed(sample)

    def joint_track(self, on_sample: Callable[[], None] | None = None) -> JointTrack:
        """Read all joint states; `on_sample` hears of each."""
        names: tuple[str, ...] = ()
        stamps, values = array("q"), array("d")  # a sample as an object is five times as large
        for sample in self.joint_samples(on_sample):
            names = sample.names
            stamps.append(sample.stamp_ns)
            values.extend(sample.positions)
        if not stamps:
            raise self.no_joints()
        stamps_ns = np.array(stamps, np.int64)
        positions = np.frombuffer(values, np.float64).reshape(len(stamps), len(names))
        order = sort_stamps(stamps_ns)
        if len(order) < len(stamps_ns):
            self.record_repeated_joints(len(stamps_ns) - len(order))
        elif (np.diff(order) == 1).all():
            return JointTrack(stamps_ns, names, positions)
        return JointTrack(stamps_ns[order], names, positions[order])

    def no_joints(self) -> RecordingError:
        """What is to be said of a log whose joint states cannot be used."""
        topic = self._choice.require(Role.JOINTS)
        return RecordingError(f"{self.path.name}: no usable joint states on {sanitize(topic)}")

    def record_repeated_joints(self, count: int) -> None:
        """Count joint states whose stamp comes again; the last of them counts."""
        detail = f"{count} joint states repeat a stamp; the last one counts"
        self.health.add(Loss(LossKind.MESSAGE, detail, None, self._choice.require(Role.JOINTS)))

    def transform_track(self, parent: str, child: str, *, ground_truth: bool = False) -> TransformTrack:
        """Read `T_parent_child` over time, composed along the tree of the nominal or the true transforms.

        Raises RecordingError where the log has no transforms, or none that link the two frames.
        """
        fixed = None if ground_truth else self._fixed_track(parent, child)
        return fixed or self.transform_tree(ground_truth=ground_truth).track(parent, child)

    def _fixed_track(self, parent: str, child: str) -> TransformTrack | None:
        """The transform from the camera to a base, or back, where it is known for the whole log."""
        for arm in self._arms:
            T = None if arm.fixed is None else arm.fixed.T_camera_base
            if T is not None and {parent, child} == {arm.frames.camera, arm.frames.base}:
                T_parent_child = T if parent == arm.frames.camera else inverse(T)
                return TransformTrack(
                    parent, child, np.zeros(1, np.int64), T_parent_child[None], is_static=True
                )
        return None

    def transform_tree(self, *, ground_truth: bool = False) -> TransformTree:
        """Read all transforms, the nominal ones or the true ones."""
        if ground_truth:
            static: tuple[str, ...] = ()
            moving: str | None = self._choice.require(Role.GROUND_TRUTH_TF)
        else:
            static = self._choice.static_transforms()
            moving = self._choice.find(Role.TF) if static else self._choice.require(Role.TF)
        tree = TransformTree()
        lag_ns = 0 if ground_truth else self._lag_ns
        for raw, sample in self._messages.samples(*static, *([moving] if moving else [])):
            if isinstance(sample, TransformsSample):
                for transform in sample.transforms:
                    later = replace(transform, stamp_ns=later_ns(transform.stamp_ns, lag_ns))
                    tree.add(later, is_static=raw.topic in static)
        return tree

    def pose_samples(self) -> Iterator[PoseSample]:
        """Yield the poses in the order of the file, at the stamps that the clocks put right give them."""
        topic = self._choice.require(Role.POSE)
        for _, sample in self._messages.samples(topic):
            if isinstance(sample, PoseSample):
                yield replace(sample, stamp_ns=later_ns(sample.stamp_ns, self._lag_ns))

    def pose_track(self) -> PoseTrack:
        """Read all poses; RecordingError where their frame changes."""
        samples = list(self.pose_samples())
        frames = sorted({sample.frame_id for sample in samples})
        if len(frames) != 1:
            raise self.other_frames(frames)
        stamps_ns = np.array([sample.stamp_ns for sample in samples], np.int64)
        order = sort_stamps(stamps_ns)
        return PoseTrack(frames[0], stamps_ns[order], np.array([s.T_frame_pose for s in samples])[order])

    def other_frames(self, frames: Sequence[str]) -> RecordingError:
        """What is to be said of poses that are in several frames, or of which there are none."""
        found = f"poses in several frames: {sanitize_list(frames)}" if frames else "no usable poses"
        return RecordingError(f"{self.path.name}: {found} on {sanitize(self._choice.require(Role.POSE))}")

    def distance_track(self) -> DistanceTrack:
        """Read all true distances."""
        topic = self._choice.require(Role.GROUND_TRUTH_DISTANCE)
        samples = [
            sample for _, sample in self._messages.samples(topic) if isinstance(sample, DistanceSample)
        ]
        stamps_ns = np.array([sample.stamp_ns for sample in samples], np.int64)
        rows = np.array([(s.planar_m, s.spatial_m, s.clearance_m) for s in samples]).reshape(-1, 3)
        order = sort_stamps(stamps_ns)
        return DistanceTrack(stamps_ns[order], *rows[order].T)

    def raw_messages(self) -> Iterator[RawMessage]:
        """Yield every message of every topic in file order, not decoded."""
        return self._source.messages()

    def size_bytes(self) -> int:
        """Size of the file, or of all files of a folder."""
        return sum(
            file.size_bytes() if isinstance(file, RemoteFile) else file.stat().st_size
            for file in self._files()
        )

    def sha256(self) -> str:
        """Hash the file, or the files of a folder in the order of their names, as hexadecimal digits."""
        return content_sha256(self.path)

    def _files(self) -> list[LogPath]:
        return files_of(self.path)

    def _first_camera(self, topic: str) -> Camera | None:
        return next(
            (
                sample.camera
                for _, sample in self._messages.samples(topic)
                if isinstance(sample, CameraSample)
            ),
            None,
        )

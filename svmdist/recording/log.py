"""Opening recordings: the one way in which everything else reads logs, whatever their format."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import starmap
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from svmdist.camera import Camera, are_exchanged, stereo_transform
from svmdist.errors import RecordingError, did_you_mean
from svmdist.files import files_of, open_regular, reading
from svmdist.kinematics import DHChain, chain_of
from svmdist.perturbations import Perturbations
from svmdist.perturbations.apply import ReplayedWorld, nominal_camera
from svmdist.profile import Profile
from svmdist.recording import observations as obs
from svmdist.recording.contents import Contents, LogFile, TransformTree, in_order, joint_rows
from svmdist.recording.messages import EncodedImage, Kind, broken_image, kind_of, matrices
from svmdist.recording.source import Health, LossKind, TopicInfo, sanitize, sanitize_list
from svmdist.recording.topics import LoggedArm, Role, find_arms, open_source
from svmdist.remote import LogPath, RemoteFile, is_url
from svmdist.samples import Observation, Rejection
from svmdist.tracks import DistanceTrack, JointTrack, LagEstimate, TransformTrack, apart_ns
from svmdist.transforms import Array, inverse

TRUE_SUFFIX = "_ground_truth"  # of true frames in a copy: a frame has one parent in a viewer, and `tool` the robot's
MOVED = 1e-3  # a joint, in rad or m, that goes farther moves what an image shows of the instrument
LATE_S = 0.05  # how late any image may be: cameras and recorders give some of them twice


def open_recording(path: LogPath | str, profile: Profile, *, topics: Mapping[str, str] | None = None) -> Recording:
    """Open a recording; `topics` overrides the profile's, by role: `{"image": "/left/image_raw"}`.

    Raises RecordingError for a file that is missing, empty, or not a recording, and UsageError for an unknown role.
    What is lost later while reading is counted in `health`.
    """
    if isinstance(path, str):
        path = RemoteFile(path) if is_url(path) else Path(path)
    return Origin(path, profile, dict(topics or {})).open()


class Origin(NamedTuple):
    """What a recording is opened by: once more, or by another process, or with something else in it."""

    path: LogPath
    profile: Profile
    topics: dict[str, str]

    def open(self) -> Recording:
        """Open the recording, of which nothing is read yet, and nothing lost; raises as `open_recording`."""
        path, profile, topics = self
        source = open_source(path, profile.limits)
        arms = find_arms(source, profile, topics)
        beside_images = frozenset(topic for arm in arms for topic in arm.topics_beside_images())
        cameras = {info.topic for info in source.topics if kind_of(info) is Kind.CAMERA}
        file = LogFile(source, profile.limits, beside_images, beside_images & cameras)
        fixed = {arm.name: profile.for_instrument(arm.name).camera_to_base for arm in arms}
        bases = {name: one.T_camera_base for name, one in fixed.items() if one is not None}
        return Recording(file, arms, self, bases, ReplayedWorld(Perturbations(), profile))


@dataclass(frozen=True, eq=False)
class Recording:
    """A log that can be read, over and over; everything in it but the images is read once, and kept.

    With several instruments in it, all but `encoded_observations` is about the first one; `for_instrument` gives the
    same log as another one sees it. Make one with `open_recording`, and others of it with the methods below.
    """

    file: LogFile
    arms: tuple[LoggedArm, ...]
    origin: Origin
    bases: Mapping[str, Array | None]  # `T_camera_base`, (4, 4); None if not to be known; for others the log's
    world: ReplayedWorld
    lag: LagEstimate | None = None
    """The known time offset of the images: joints, poses and transforms are read at their stamps; truth keeps its."""
    alias: str | None = None  # the name that it goes by; None for its file's
    window: obs.Window = obs.ALL_IMAGES  # which of its images are read; whatever else it has is read whole
    wanted: tuple[str, ...] | None = None  # the instruments that are measured; None for all
    on_progress: Callable[[int, int | None], None] = lambda _done, _total: None  # of images; in total where known

    def __repr__(self) -> str:
        topics = ", ".join(f"{role} {topic}" for role in Role if (topic := self.topic_of(role)))
        return f"{self.name}: instruments {', '.join(self.instruments)}; {topics or 'no topic of the profile'}"

    def __reduce__(self) -> tuple[Callable[..., Recording], tuple[object, ...]]:
        """Another process opens the same file anew; it shows no progress."""
        view = {one.name: getattr(self, one.name) for one in fields(self) if one.name not in {"file", "on_progress"}}
        return _reopened, (self.origin, view)

    def for_instrument(self, name: str) -> Recording:
        """The same log as one of its instruments sees it; RecordingError lists those that there are."""
        return replace(self, arms=(self._arm(name),), wanted=None)

    def perturbed(self, perturbations: Perturbations) -> Recording:
        """The same log in a perturbed world, of other joints, stamps and cameras, sampled by the log's seed or 0."""
        seed = self.metadata.get("seed", "")
        world = ReplayedWorld(perturbations, self.origin.profile, int(seed) if seed.isdecimal() else 0)
        return replace(self, world=world)

    @property
    def instruments(self) -> tuple[str, ...]:
        """The profile's own instrument, and the others that have a topic in the log."""
        return tuple(arm.name for arm in self.arms)

    @property
    def measured(self) -> tuple[str, ...]:
        """The instruments that are measured; others are only associated. RecordingError for an unknown one."""
        return self.instruments if self.wanted is None else tuple(self._arm(one).name for one in self.wanted)

    @cached_property
    def profile(self) -> Profile:
        """The profile that it was opened with, as its first instrument sees it."""
        return self.origin.profile.for_instrument(self.instruments[0])

    @property
    def chain(self) -> DHChain:
        """The chain of its instrument's robot; RecordingError where the profile has none."""
        if self.profile.robot is None:
            raise RecordingError(f"profile {self.profile.name} has no [robot]: kinematics need its chain")
        return chain_of(self.profile.robot)

    @property
    def is_part(self) -> bool:
        """Whether its images show instruments of the profile that it is not about."""
        return len(find_arms(self.file.source, self.origin.profile, self.origin.topics)) > len(self.arms)

    @property
    def path(self) -> LogPath:
        """The file or folder, or the URL."""
        return self.file.source.path

    @property
    def name(self) -> str:
        """The file's name without its suffix, or the one that it goes by."""
        return self.alias or self.path.stem

    @property
    def health(self) -> Health:
        """What was lost so far; complete after a pass over the whole log."""
        return self.file.source.health

    @cached_property
    def metadata(self) -> dict[str, str]:
        """The pairs of the metadata record `svmdist`; empty where there is none."""
        return self.file.source.metadata()

    def topics(self) -> tuple[TopicInfo, ...]:
        """List the topics, sorted by name."""
        return self.file.source.topics

    def topic_of(self, role: Role | str) -> str | None:
        """Name the topic that plays a role; None where the log has none."""
        return self.arms[0].find(Role[role.upper()])

    def image_count(self) -> int | None:
        """How many images are read of those that the file says it has; None where that is not known beforehand."""
        topic = self.topic_of(Role.IMAGE)
        count = next((info.message_count for info in self.topics() if info.topic == topic), None)
        is_bounded = self.window.start_s > 0.0 or self.window.end_s < math.inf  # which stamps decide on
        return None if count is None or is_bounded else -(-count // self.window.every)

    def size_bytes(self) -> int:
        """Size of the file, or of all files of a folder."""
        files = files_of(self.path)
        return sum(one.size_bytes() if isinstance(one, RemoteFile) else one.stat().st_size for one in files)

    def sha256(self) -> str:
        """Hash the file, or the files of a folder in the order of their names, as hexadecimal digits."""
        digest = hashlib.sha256()
        for path in files_of(self.path):
            with reading(path, RecordingError), open_regular(path) as file:
                while piece := file.read(1 << 20):
                    digest.update(piece)
        return digest.hexdigest()

    @cached_property
    def camera(self) -> Camera:
        """The first calibration, as a perturbed world states it; images have each their own. RecordingError."""
        return nominal_camera(self.logged_camera, self.world.perturbations)

    @cached_property
    def logged_camera(self) -> Camera:
        """The first camera calibration as the file has it; RecordingError where there is none."""
        return self._left_track.runs[0].camera

    @property
    def _left_track(self) -> obs.CameraTrack:
        """What is known of the camera so far, its first calibration at least; RecordingError where there is none."""
        track = self.file.camera_track(self.arms[0].require(Role.CAMERA_INFO))
        if not track.runs:
            raise self._unusable("camera calibration", Role.CAMERA_INFO)
        return track

    @cached_property
    def right_camera(self) -> Camera | None:
        """The right camera's first calibration; None where the log has none of its own."""
        topic = self.topic_of(Role.RIGHT_CAMERA_INFO)
        if topic is None or topic == self.topic_of(Role.CAMERA_INFO):
            return None
        runs = self.file.camera_track(topic).runs
        return nominal_camera(runs[0].camera, self.world.perturbations, right=True) if runs else None

    @property
    def remarks(self) -> list[str]:
        """What images lacked near them in the last replay, which topics are not used, and where a camera changed."""
        said = self.file.missing.describe()
        said += dict.fromkeys(line for arm in self.arms for line in arm.missing_topics())
        topic, right = self.topic_of(Role.RIGHT_IMAGE), self.right_camera
        if topic not in (None, self.topic_of(Role.IMAGE)):
            if right is None:
                said.append(f"{topic} is not used: the log has no calibration of its camera")
            elif stereo_transform(self.camera, right) is None:
                said.append(f"{topic} is not used: the log does not say how far the cameras are apart")
        if changes := self.camera_changes:
            count = f"; it is the first of {len(changes)} changes" if len(changes) > 1 else ""
            said.append(f"the camera changes: {changes[0]}{count}")
        return said

    @property
    def camera_changes(self) -> tuple[obs.CameraChange, ...]:
        """Where either camera's calibration changes, so far as the log has been read: all of it after a pass."""
        topics = dict.fromkeys(self.topic_of(role) for role in (Role.CAMERA_INFO, Role.RIGHT_CAMERA_INFO))
        return tuple(one for topic in topics if topic for one in self.file.cameras[topic].changes(topic))

    def encoded_observations(
        self, *, robot: bool = True, right: bool = True, rest: bool = True, stale: bool = False
    ) -> Iterator[obs.EncodedObservation]:
        """Yield for every image, by stamp, what estimators may see of each instrument, not decoded yet.

        Joints and the nominal camera-to-base transform are interpolated to the image's stamp between samples at most
        0.1 s apart; the right image of a stereo pair is within `[limits] pair_tolerance_s`. Each is None where the log
        has none. Without `robot`, joints and transforms are neither read nor given, without `right` the right images;
        with `rest` the pass over the images reads everything else, too. With `stale`, for which joints are read in any
        case, images that repeat although the robot has moved say so. RecordingError at once without images or camera.
        One thread at a time iterates, any thread decodes; the caller bounds how many are held.
        """
        first = self.arms[0]
        topic, states = first.require(Role.IMAGE), [self._arm_states(arm, robot) for arm in self.arms]
        right_topic = self._right_topic() if right else None
        of_right = self.file.cameras[first.require(Role.RIGHT_CAMERA_INFO)] if right_topic else None
        cameras = obs.cameras_at(self._left_track, of_right, self.world.perturbations)
        missing = self.file.missing = obs.MissingPartners(self.file.limits.pair_tolerance_s)
        images = self.file.images({topic, right_topic or topic}, rest=rest)
        pairs = obs.Pairs(right_topic, missing.pair_tolerance_s, self.health)

        def observation(number: int, at_ns: int, pair: obs.Pair) -> obs.EncodedObservation:
            left, right, right_apart_s = pair
            reported = tuple(state(left.stamp_ns) for state in states)
            apart_s = zip(*(one[3:] for one in reported), strict=True)
            joints_s, base_s = (max(filter(None, far), default=None) for far in apart_s)
            missing.add(right=right_apart_s, joints=joints_s, base=base_s)
            held, place = cameras(left.stamp_ns), self.health.next_place()
            repeats = self._repeats(left) if stale else ""
            missing.repeat_count += stale and left.since_ns < left.stamp_ns and not self._logged_tracks
            if stale and right is not None and not repeats and (said := self._repeats(right)):
                right = replace(broken_image(right.stamp_ns, said), topic=right.topic, offset=right.offset)
            return obs.EncodedObservation(left, right, reported, held, place, number, at_ns, repeats)

        return starmap(observation, self.window.of(pairs.of(images)))

    def with_states(self, images: Sequence[obs.EncodedObservation]) -> list[obs.EncodedObservation]:
        """Images that were read without what each instrument reported, with it: after a pass that read the rest."""
        states = [self._arm_states(arm) for arm in self.arms]
        return [replace(one, arms=tuple(state(one.stamp_ns) for state in states)) for one in images]

    def record_losses(self, decoded: obs.Decoded) -> tuple[Observation, ...] | Rejection:
        """Add losses of decoding to `health`, in file order; give the rest."""
        for loss in decoded.losses:
            self.health.add(loss, decoded.place)
        return decoded.found

    def _arm_states(self, arm: LoggedArm, robot: bool = True) -> Callable[[int], obs.ArmState]:
        """What an arm reported, as a function of a stamp."""
        has_joints = robot and arm.find(Role.JOINTS) is not None
        joints = self._joints(arm) if robot else None
        fixed, frames = self.bases.get(arm.name), (arm.frames.camera, arm.frames.base)
        in_log = robot and arm.name not in self.bases
        tree = self.nominal_tree if in_log and self.nominal_tree.links(*frames) else None

        def at(stamp_ns: int) -> obs.ArmState:
            T_camera_base, at_ns, base_apart_s = fixed, np.array([stamp_ns], np.int64), None
            if tree is not None:
                found = tree.at(*frames, at_ns)
                T_camera_base = found.values[0] if found.valid[0] else None
                base_apart_s = None if found.valid[0] else 1e-9 * float(tree.apart_ns(*frames, at_ns)[0])
            near, joints_apart_s = obs.joints_at(joints, stamp_ns), None
            if has_joints and near[0] is None:
                joints_apart_s = 1e-9 * float(apart_ns(joints.stamps_ns, at_ns)[0]) if joints else math.inf
            return obs.ArmState(*near, T_camera_base, joints_apart_s, base_apart_s)

        return at

    def _repeats(self, image: EncodedImage) -> str:
        """What is said of an image that repeats another since which the robot has moved; nothing of any other."""
        at_ns, since_s = np.array([image.since_ns, image.stamp_ns]), (image.stamp_ns - image.since_ns) * 1e-9
        if since_s <= LATE_S:
            return ""
        if any((np.ptp(track.at(at_ns).values, 0) > MOVED).any() for track in self._logged_tracks):
            return f"the image repeats that of {since_s:.2g} s before to the last byte, and the robot has moved"
        return ""

    @cached_property
    def _logged_tracks(self) -> list[JointTrack]:
        """What is logged of the joints of each chain, whatever a perturbed world reports."""
        tracks, plain = [], replace(self, world=ReplayedWorld(Perturbations(), self.origin.profile))
        for arm in self.arms:
            if arm.find(Role.JOINTS) and (track := plain._joints(arm)):
                robot = self.origin.profile.for_instrument(arm.name).robot
                known = robot.joint_names if robot else ()
                columns = [at for at, name in enumerate(track.names) if name in known]
                tracks.append(replace(track, positions=track.positions[:, columns or slice(None)]))
        return tracks

    def _right_topic(self) -> str | None:
        """The right images' topic; None without a stereo pair, RecordingError where left and right are exchanged."""
        left, topic = self.topic_of(Role.IMAGE), self.topic_of(Role.RIGHT_IMAGE)
        right = None if topic in (None, left) else self.right_camera
        if right is not None and are_exchanged(self.camera, right):
            said = f"by their camera infos, {left} is the right view and {topic} the left one"
            raise RecordingError(f"{self.name}: {said}: choose them with --topic")
        return topic if right is not None and stereo_transform(self.camera, right) is not None else None

    def joint_track(self) -> JointTrack:
        """All joint states; RecordingError where there are none."""
        self.arms[0].require(Role.JOINTS)
        if (track := self._joints(self.arms[0])) is None:
            raise self._unusable("joint states", Role.JOINTS)
        return track

    def _joints(self, arm: LoggedArm) -> JointTrack | None:
        """The joint states of an arm, as a perturbed world has them, at the stamps of the images' clock."""
        topic = arm.find(Role.JOINTS)
        found = self.file.contents.get(topic or "", {}).items()
        by_names = {names: rows for names, rows in found if isinstance(names, tuple)}
        if not by_names:
            return None
        robot = self.origin.profile.for_instrument(arm.name).robot
        names, stamps_ns, positions, losses = joint_rows(by_names, robot)
        reported = self.world.reported(arm.name, names, stamps_ns, positions)
        stamps_ns, positions = in_order(*reported, self.lag)
        if repeated := len(reported[0]) - len(stamps_ns):
            losses.append(f"{repeated} joint states repeat a stamp; the first one counts")
        for detail in losses:
            self.health.lose(LossKind.MESSAGE, detail, None, topic)
        return JointTrack(stamps_ns, names, positions)

    def transform_track(self, parent: str, child: str, *, ground_truth: bool = False) -> TransformTrack:
        """`T_parent_child` over time, nominal or true; RecordingError where no transforms link the frames."""
        for arm in () if ground_truth else self.arms:
            T = self.bases.get(arm.name)
            if T is not None and {parent, child} == {arm.frames.camera, arm.frames.base}:
                T = (T if parent == arm.frames.camera else inverse(T))[None]
                return TransformTrack(parent, child, np.zeros(1, np.int64), T, is_static=True)
        if ground_truth:
            topics = {self.arms[0].require(Role.GROUND_TRUTH_TF): False}
            tree, in_copy = TransformTree(self.file.contents, topics), child + TRUE_SUFFIX
            return tree.track(parent, in_copy if tree.links(parent, in_copy) else child)
        if not self.arms[0].static_transforms():
            self.arms[0].require(Role.TF)
        return self.nominal_tree.track(parent, child)

    @cached_property
    def nominal_tree(self) -> TransformTree:
        """The log's transforms, but for the true ones, at the stamps of the images' clock."""
        return self.tree_of(self.file.contents)

    def tree_of(self, contents: Contents) -> TransformTree:
        """The same of so much of the log as was read."""
        moving, static = self.topic_of(Role.TF), self.arms[0].static_transforms()
        topics = ({moving: False} if moving else {}) | dict.fromkeys(static, True)
        return TransformTree(contents, topics, self.lag)

    def pose_track(self) -> TransformTrack:
        """All poses, at the stamps of the images' clock; RecordingError unless they are in one frame."""
        known = self.file.contents[self.arms[0].require(Role.POSE)]
        if len(known) != 1:
            several = f", in several frames ({sanitize_list(sorted(map(str, known)))})," if known else ""
            raise self._unusable(f"poses{several}", Role.POSE)
        ((frame, rows),) = known.items()
        stamps_ns, values = in_order(*rows.arrays(), self.lag)
        return TransformTrack(str(frame), "", stamps_ns, matrices(values))

    def distance_track(self) -> DistanceTrack:
        """All true distances."""
        topic = self.arms[0].require(Role.GROUND_TRUTH_DISTANCE)
        stamps_ns, rows = in_order(*self.file.contents[topic][None].arrays())
        return DistanceTrack(stamps_ns, rows.reshape(-1, 3))

    def _arm(self, name: str) -> LoggedArm:
        if named := [arm for arm in self.arms if arm.name == name]:
            return named[0]
        known = did_you_mean(name, self.instruments)
        raise RecordingError(f"{self.path.name}: no topic of an instrument {sanitize(name)}: {known}")

    def _unusable(self, what: str, role: Role) -> RecordingError:
        topic, kind = self.arms[0].require(role), role.kind
        why = next((f": {sanitize(loss.detail)}" for loss in self.health.losses if loss.topic == topic), "")
        others = [one.topic for one in self.topics() if kind_of(one) is kind and one.topic != topic]
        listed = f"; other topics with {kind}: {sanitize_list(others)}" if others else ""
        return RecordingError(f"{self.path.name}: no usable {what} on {sanitize(topic)}{why}{listed}")


def _reopened(origin: Origin, view: Mapping[str, Any]) -> Recording:
    return replace(origin.open(), **view)

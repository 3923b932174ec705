"""Opening a log: its format, which topic plays which role, and which of a profile's instruments it has."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from svmdist.errors import RecordingError, UsageError, did_you_mean
from svmdist.files import nearest_file, open_regular, why
from svmdist.profile import Frames, Limits, Profile, Topics
from svmdist.profile.robot import ARM_TOPICS
from svmdist.recording import mcap
from svmdist.recording.messages import Kind, kind_of, unread
from svmdist.recording.source import METADATA_FILE, Source, TopicInfo, sanitize, sanitize_list
from svmdist.remote import LogPath, RemoteFile

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
LOOKS_LIKE = {
    b"#ROSBAG V1": "a ROS bag of version 1, from before 2010",
    b"\x1f\x8b": "gzip-compressed",
    ZSTD_MAGIC: "zstd-compressed",
    b"\x04\x22\x4d\x18": "lz4-compressed",
    b"BZh": "bzip2-compressed",
    b"\xfd7zXZ": "xz-compressed",
    b"PK\x03\x04": "a zip archive",
    b"\x89HDF": "an HDF5 file",
    b"version https://git-lfs": "a Git LFS pointer, whose file has not been fetched",
}
# How images and videos begin: PNG, JPEG, BMP, TIFF, AVI, WebP, MP4, Matroska.
IMAGES_OR_VIDEO = re.compile(rb"(?s)\x89PNG|\xff\xd8\xff|BM|II\*\0|MM\0\*|RIFF....(AVI |WEBP)|....ftyp|\x1aE\xdf\xa3")
WHAT_IS_EXPECTED = "an MCAP file, a ROS 1 bag or a rosbag2 folder"
TO_IMPORT = "`svmdist import` makes a log of images or a video"


class Role(StrEnum):
    """What a topic is needed for, a key of a profile's `[topics]`; and the `kind` of its messages."""

    kind: Kind
    IMAGE = "image", Kind.IMAGE
    CAMERA_INFO = "camera_info", Kind.CAMERA
    RIGHT_IMAGE = "right_image", Kind.IMAGE
    RIGHT_CAMERA_INFO = "right_camera_info", Kind.CAMERA
    JOINTS = "joints", Kind.JOINTS
    POSE = "pose", Kind.POSE
    TF = "tf", Kind.TRANSFORMS
    GROUND_TRUTH_TF = "ground_truth_tf", Kind.TRANSFORMS
    GROUND_TRUTH_DISTANCE = "ground_truth_distance", Kind.DISTANCE

    def __new__(cls, name: str, kind: Kind) -> Self:
        """A role by its name and kind."""
        role = str.__new__(cls, name)
        role._value_, role.kind = name, kind
        return role


RIGHT = (Role.RIGHT_IMAGE, Role.RIGHT_CAMERA_INFO)
NAMED = {Role.GROUND_TRUTH_TF, *RIGHT}  # must be named: any transforms could pass for truth, any image for right


def is_right(topic: str) -> bool:
    """Whether a topic's name says that it is of a right camera: `/stereo/right/image_raw`, `/cam_r/image`."""
    return "right" in topic.lower() or bool(re.search(r"[/_]r([/_]|$)", topic.lower()))


@dataclass(frozen=True)
class LoggedArm:
    """One instrument of a recording: the roles of the topics and the frames as it sees them."""

    name: str
    frames: Frames
    infos: Sequence[TopicInfo]
    wanted: Topics
    overrides: Mapping[str, str]
    log: str  # the name of the file
    claimed: frozenset[str] = frozenset()  # topics of other arms, which stand in for none

    def __post_init__(self) -> None:
        for role in self.overrides:
            if role not in list(Role):
                raise UsageError(f"no role {role} for a topic: {did_you_mean(role, list(Role))}")

    def require(self, role: Role) -> str:
        """Name the topic of a role; RecordingError lists the candidates, or the topics there are."""
        kind = role.kind
        override, candidates = self.overrides.get(role), self._candidates(kind)
        listed = sanitize_list(f"{info.topic} ({info.schema or 'no schema'})" for info in self.infos)
        there_are = f"the topics are {listed}{unread(self.infos)}" if listed else "the recording has no topics"
        if override is not None and override not in candidates:
            if override not in {info.topic for info in self.infos} and candidates:
                known = did_you_mean(sanitize(override), map(sanitize, candidates))
                raise RecordingError(f"{self.log}: no topic {sanitize(override)} with {kind}: {known}")
            raise RecordingError(f"{self.log}: topic {sanitize(override)} carries no {kind}; {there_are}")
        wanted: str | None = override or getattr(self.wanted, role)
        if wanted in candidates:
            return str(wanted)
        fitting = [] if role in NAMED else self._unclaimed(role, candidates)
        if len(fitting) == 1:
            return fitting[0]
        expected = f" (the profile expects {wanted})" if wanted else ""
        if fitting:
            remedy = "let `svmdist profile new` write a profile of this log, or choose one with --topic"
            found = f"several topics carry {kind}{expected}"
            raise RecordingError(f"{self.log}: {found}: {remedy} {role}=TOPIC: {sanitize_list(fitting)}")
        others = [topic for topic in candidates if topic in {getattr(self.wanted, right) for right in RIGHT}]
        of_right = f"; {sanitize_list(others)} is the right view's" if others and role not in RIGHT else ""
        raise RecordingError(f"{self.log}: no topic with {kind} for {role}{expected}{of_right}; {there_are}")

    def find(self, role: Role) -> str | None:
        """Name the topic of a role; None where there is none, or no single one."""
        try:
            return self.require(role)
        except RecordingError:
            if role in self.overrides:
                raise
            return None

    def missing_topics(self) -> list[str]:
        """The profile's topics that the log lacks though it has others of their kind that play no role, in words."""
        there, said = {info.topic for info in self.infos}, list[str]()
        used = self.claimed | {*self.static_transforms()} | {self.find(role) for role in Role}
        for role in set(Role) - self.overrides.keys():
            topic, found = getattr(self.wanted, role), self.find(role)
            free = [one for one in self._candidates(role.kind) if one not in used]
            if topic and topic not in there and (found or free):
                taken = f"{found} stands in for it" if found else did_you_mean(topic, free)
                said.append(f"{role}: the log has no {topic}, which the profile names: {sanitize(taken)}")
        return sorted(said)

    def static_transforms(self) -> tuple[str, ...]:
        """Name the topics whose transforms hold for the whole log, as ROS publishes them."""
        return tuple(topic for topic in self._candidates(Kind.TRANSFORMS) if topic.endswith("tf_static"))

    def topics_beside_images(self) -> set[str]:
        """The topics that play a role for it, but for images."""
        topics: set[str | None] = set(self.static_transforms())
        for role in set(Role) - {Role.IMAGE, Role.RIGHT_IMAGE}:
            with suppress(RecordingError):  # a chosen topic that is missing is reported where it is needed
                topics.add(self.find(role))
        return {topic for topic in topics if topic is not None}

    def _candidates(self, kind: Kind) -> list[str]:
        return sorted({one.topic for one in self.infos if kind_of(one) is kind})

    def _unclaimed(self, role: Role, candidates: Sequence[str]) -> list[str]:
        """Leave out topics that are known to play another role or are another arm's, and static transforms."""
        others = self.claimed | {self.overrides.get(one) or getattr(self.wanted, one) for one in set(Role) - {role}}
        fitting = [topic for topic in candidates if topic not in others and not topic.endswith("tf_static")]
        right = {getattr(self.wanted, other) for other in RIGHT}
        # Where a log has the right view alone, that is the image, with its own calibration and no other.
        fitting = fitting or [topic for topic in candidates if topic in right and len(candidates) == 1]
        if role is Role.IMAGE and self.wanted.camera_info in self._candidates(Kind.CAMERA):
            return [topic for topic in fitting if topic not in right]
        image = self.find(Role.IMAGE) if role is Role.CAMERA_INFO else None
        if image is not None and not (image in right or is_right(image)):
            return [topic for topic in fitting if not (topic in right or is_right(topic))]
        return fitting


def find_arms(source: Source, profile: Profile, overrides: Mapping[str, str]) -> tuple[LoggedArm, ...]:
    """The profile's own instrument, and every other one whose joints or pose the recording has.

    The own one is left out where the profile names its joints or pose, the recording has neither, and another one is
    there: a profile of a robot's three arms serves a log of one. `overrides` choose topics by role: those of an arm
    are the first one's, and what they name is no other's.
    """
    there = {info.topic for info in source.topics} - {overrides[role] for role in ARM_TOPICS if role in overrides}
    others = [other for other in profile.other_instruments if other.is_in(there)]
    firsts = {role: overrides.get(role) or getattr(profile.topics, role) for role in ARM_TOPICS}
    of_first = {*firsts.values()} - {None}
    there |= of_first & set(overrides.values())
    known_by = {firsts["joints"], firsts["pose"]} - {None}
    is_elsewhere = any(there & set(other.logged_topics.values()) for other in others)
    claims = {} if is_elsewhere and known_by and not known_by & there else {profile.instrument_name: of_first}
    claims |= {other.name: set(other.logged_topics.values()) for other in others}
    arms = []
    for name in claims:
        view = profile.for_instrument(name)
        is_first = name == profile.instrument_name
        chosen = {role: topic for role, topic in overrides.items() if is_first or role not in ARM_TOPICS}
        claimed = frozenset(topic for owner in claims if owner != name for topic in claims[owner] if topic)
        arms.append(LoggedArm(name, view.frames, source.topics, view.topics, chosen, source.path.name, claimed))
    return tuple(arms)


def open_source(path: LogPath, limits: Limits) -> Source:
    """Find out what a path is, and open it; RecordingError says in one line why it cannot be a recording."""
    try:
        if not isinstance(path, RemoteFile) and path.is_dir():
            if not (path / METADATA_FILE).is_file():
                found = f"is a directory without {METADATA_FILE}, so no rosbag2 folder"
                raise RecordingError(f"{path}: {found}; expected {WHAT_IS_EXPECTED}; {TO_IMPORT}")
            from svmdist.recording.rosbag import FolderSource

            return FolderSource(path, limits)
        with open_regular(path) as file:
            start = file.read(64)
    except FileNotFoundError as problem:
        near = nearest_file(problem.filename) if problem.filename else ""  # of a URL nothing is known
        raise RecordingError(f"{path}: no such file{near}") from None
    except (OSError, ValueError) as problem:
        raise RecordingError(f"{path}: cannot read: {why(problem)}") from None
    if start.startswith(mcap.MAGIC):
        source: Source = mcap.McapSource(path, limits)
    elif start.startswith((b"#ROSBAG V2.0\n", b"SQLite format 3\x00")):
        from svmdist.recording.rosbag import BagSource

        source = BagSource(path, "ros1" if start.startswith(b"#") else "cdr")
    elif not start:
        raise RecordingError(f"{path}: is empty; expected {WHAT_IS_EXPECTED}")
    elif mcap.MAGIC.startswith(start):
        raise RecordingError(f"{path}: truncated at byte {len(start)}, inside the magic of an MCAP file")
    elif IMAGES_OR_VIDEO.match(start):
        raise RecordingError(f"{path}: is no recording but an image or a video: {TO_IMPORT}")
    else:
        found = next((what for magic, what in LOOKS_LIKE.items() if start.startswith(magic)), "not a recording")
        raise RecordingError(f"{path}: is {found}; expected {WHAT_IS_EXPECTED}; {TO_IMPORT}")
    topics = {info.topic for info in source.topics if info.message_encoding == "cdr"}
    first = next(iter(source.messages(topics)), None) if topics else None
    if first is not None and first.data.startswith(ZSTD_MAGIC):  # CDR begins with a zero byte
        remedy = f"open the folder that holds it and its {METADATA_FILE}"
        raise RecordingError(f"{path}: a rosbag2 file whose messages are compressed one by one; {remedy}")
    return source

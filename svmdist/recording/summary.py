"""What is in a recording: statistics of every topic in one pass, and a copy of what svmdist understands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from svmdist.camera import Camera
from svmdist.input_file import LogPath
from svmdist.profile import Limits, Profile
from svmdist.recording.encode import EncodedSample
from svmdist.recording.images import ImageError
from svmdist.recording.log import Recording, open_recording
from svmdist.recording.messages import DecodeError, Decoder, RawTransforms, kind_of, message_class, to_sample
from svmdist.recording.source import Health, RawMessage
from svmdist.recording.topics import Role
from svmdist.samples import CameraSample, JointSample, Sample, TransformsSample

GAP_FACTOR = 3.0
"""A gap is a distance of stamps above three mean periods: one or two lost messages are jitter."""
MAX_NAMES = 1000


@dataclass(frozen=True)
class TopicSummary:
    """Statistics of one topic, over the stamps of its messages, or over log times where it has none.

    `rate_hz` is None with fewer than two messages; `largest_gap_s` is the longest time without one.
    """

    topic: str
    schema: str
    message_encoding: str
    kind: str | None
    message_count: int
    rate_hz: float | None
    start_ns: int | None
    end_ns: int | None
    largest_gap_s: float
    gap_count: int
    out_of_order_count: int
    undecodable_count: int


@dataclass(frozen=True)
class RecordingSummary:
    """A whole recording; `roles` names the topic of every role that one could be found for."""

    path: LogPath
    size_bytes: int
    metadata: dict[str, str]
    duration_s: float
    topics: tuple[TopicSummary, ...]
    roles: dict[str, str]
    cameras: dict[str, Camera]
    frames: tuple[str, ...]
    joint_names: dict[str, tuple[str, ...]]
    health: Health


class _Statistics:
    """Statistics of one topic while it is read: constant memory, whatever the length."""

    def __init__(self, first: RawMessage) -> None:
        self.schema = first.schema
        self.message_encoding = first.message_encoding
        self.count = 0
        self.undecodable_count = 0
        self.out_of_order_count = 0
        self.start_ns: int | None = None
        self.end_ns: int | None = None
        self.largest_gap_ns = 0
        self.gap_count = 0
        self._previous_ns: int | None = None

    def add(self, stamp_ns: int) -> None:
        self.count += 1
        previous_ns, self._previous_ns = self._previous_ns, stamp_ns
        newest_ns = stamp_ns if self.end_ns is None else self.end_ns
        self.start_ns = stamp_ns if self.start_ns is None else min(self.start_ns, stamp_ns)
        self.end_ns = max(newest_ns, stamp_ns)
        if previous_ns is None:
            return
        if stamp_ns < previous_ns:
            self.out_of_order_count += 1
        gap_ns = stamp_ns - newest_ns  # to the newest: a stamp out of order makes no gap behind it
        # The mean period so far stands for the true one; the first few messages say nothing yet.
        if self.count > 5 and gap_ns * (self.count - 2) > GAP_FACTOR * (newest_ns - self.start_ns):
            self.gap_count += 1
        self.largest_gap_ns = max(self.largest_gap_ns, gap_ns)

    def summary(self, topic: str) -> TopicSummary:
        span_s = 0.0 if self.start_ns is None or self.end_ns is None else (self.end_ns - self.start_ns) / 1e9
        kind = kind_of(self.schema, self.message_encoding)
        return TopicSummary(
            topic,
            self.schema,
            self.message_encoding,
            None if kind is None else str(kind),
            self.count,
            (self.count - 1) / span_s if span_s > 0 else None,
            self.start_ns,
            self.end_ns,
            self.largest_gap_ns / 1e9,
            self.gap_count,
            self.out_of_order_count,
            self.undecodable_count,
        )


def inspect_recording(
    path: LogPath | str,
    profile: Profile,
    *,
    limits: Limits | None = None,
    topics: Mapping[str, str] | None = None,
) -> RecordingSummary:
    """Read a whole recording once and summarise it; pixels are not decoded.

    Raises RecordingError where the path is no recording; a topic that svmdist cannot read is still counted.
    """
    limits = limits or profile.limits
    recording = open_recording(path, profile, limits=limits, topics=topics)
    decoder = Decoder(limits)
    statistics: dict[str, _Statistics] = {}
    cameras: dict[str, Camera] = {}
    frames: set[str] = set()
    joint_names: dict[str, tuple[str, ...]] = {}
    for raw in recording.raw_messages():
        topic = statistics.setdefault(raw.topic, _Statistics(raw))
        stamp_ns = raw.log_time_ns
        if kind_of(raw.schema, raw.message_encoding) is not None:
            try:
                sample = decoder.decode(raw, with_video=False)
            except DecodeError:
                topic.undecodable_count += 1
            else:
                stamp_ns = sample.stamp_ns
                match sample:
                    case CameraSample(camera=camera):
                        cameras.setdefault(raw.topic, camera)
                    case JointSample(names=names):
                        joint_names.setdefault(raw.topic, names)
                    case RawTransforms(transforms=transforms) if len(frames) < MAX_NAMES:
                        frames.update(name for one in transforms for name in (one.parent, one.child))
                    case _:
                        pass
        topic.add(stamp_ns)
    for info in recording.topics():
        if info.topic not in statistics:
            empty = RawMessage(info.topic, info.schema, info.message_encoding, 0, b"")
            statistics[info.topic] = _Statistics(empty)
    found = [topic.summary(name) for name, topic in sorted(statistics.items())]
    starts = [topic.start_ns for topic in found if topic.start_ns is not None]
    ends = [topic.end_ns for topic in found if topic.end_ns is not None]
    roles = {str(role): name for role in Role if (name := recording.topic_of(role)) is not None}
    return RecordingSummary(
        recording.path,
        recording.size_bytes(),
        recording.metadata,
        (max(ends) - min(starts)) / 1e9 if starts else 0.0,
        tuple(found),
        roles,
        cameras,
        tuple(sorted(frames)),
        joint_names,
        recording.health,
    )


TRUE_SUFFIX = "_ground_truth"
"""Goes to the names of true frames in a copy. A frame has one parent in a viewer, and `tool` has the robot's."""


def copied_messages(recording: Recording) -> Iterator[tuple[str, Sample | EncodedSample]]:
    """Yield (topic, message) of every topic that svmdist understands, in file order.

    Foxglove's messages in protobuf are copied as they are; others, those of ROS for instance, are written as
    Foxglove's. Images that were compressed by ROS become PNG. The child frames of the true transforms
    are renamed, see `TRUE_SUFFIX`. What cannot be decoded is left out; `Recording.health` counts it in the pass that
    measures.
    """
    limits = recording.limits
    decoder = Decoder(limits)
    truth = recording.topic_of(Role.GROUND_TRUTH_TF)
    for raw in recording.raw_messages():
        if kind_of(raw.schema, raw.message_encoding) is None:
            continue
        try:
            copied = _renamed(decoder, raw) if raw.topic == truth else _copied(decoder, raw)
        except (DecodeError, ImageError):
            continue
        yield raw.topic, copied


def _copied(decoder: Decoder, raw: RawMessage) -> Sample | EncodedSample:
    if raw.message_encoding == "protobuf":
        return EncodedSample(raw.log_time_ns, message_class(raw.schema), raw.data)
    return to_sample(decoder.decode(raw))


def _renamed(decoder: Decoder, raw: RawMessage) -> Sample:
    sample = to_sample(decoder.decode(raw))
    if not isinstance(sample, TransformsSample):
        return sample
    transforms = tuple(replace(one, child=one.child + TRUE_SUFFIX) for one in sample.transforms)
    return replace(sample, transforms=transforms)

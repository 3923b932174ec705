"""What is in a recording: statistics of every topic in one pass, and a copy of what svmdist understands."""

from __future__ import annotations

import math
from array import array
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from svmdist.recording import messages
from svmdist.recording.contents import MAX_JOINT_SETS, Contents, Joints, TransformTree, best_joints
from svmdist.recording.images import ImageError
from svmdist.recording.log import TRUE_SUFFIX, Recording
from svmdist.recording.messages import DecodeError, Decoder, kind_of
from svmdist.recording.observations import CameraTrack
from svmdist.recording.source import TopicInfo
from svmdist.recording.topics import Role
from svmdist.recording.writer import EncodedSample
from svmdist.samples import JointSample, Sample, TransformsSample
from svmdist.tracks import apart_ns

LATE_TOPICS = 10.0  # how much more of a log is looked at where none of its joints is near an image
GAP_FACTOR = 3.0  # a gap is a distance of stamps above three mean periods: one or two lost messages are jitter
MAX_NAMES = 1000


@dataclass(frozen=True)
class TopicSummary:
    """Statistics of one topic, over the stamps of its messages, or over log times where it has none."""

    topic: str
    schema: str
    message_encoding: str
    kind: str | None
    message_count: int
    rate_hz: float | None  # None with fewer than two messages
    start_ns: int | None
    end_ns: int | None
    largest_gap_s: float  # the longest time without a message
    gap_count: int
    out_of_order_count: int
    undecodable_count: int


@dataclass(frozen=True)
class RecordingSummary:
    """What was read of a recording."""

    recording: Recording
    duration_s: float
    topics: tuple[TopicSummary, ...]
    roles: dict[str, str]  # the topic of every role that has one with a readable message
    cameras: dict[str, CameraTrack]
    frames: tuple[str, ...]
    joint_names: dict[str, tuple[str, ...]]
    transforms: TransformTree
    joints_apart_s: float = 0.0  # how far from every image joints are; 0 with some near an image, and with none at all
    base_apart_s: float = 0.0  # the same of camera-to-base transforms

    def at_any_lag(self) -> RecordingSummary:
        """The same of a log whose lag is known or to be found: it may bring near the images what is not."""
        return replace(self, joints_apart_s=0.0, base_apart_s=0.0)


def _summary(info: TopicInfo, logged_ns: array[int], undecodable_count: int) -> TopicSummary:
    stamps_ns, count = np.array(logged_ns, np.int64), len(logged_ns)
    start_ns, end_ns = (int(stamps_ns.min()), int(stamps_ns.max())) if count else (None, None)
    # To the newest stamp so far: one out of order makes no gap behind it.
    newest_ns, oldest_ns = np.maximum.accumulate(stamps_ns)[:-1], np.minimum.accumulate(stamps_ns)[:-1]
    gaps_ns = stamps_ns[1:] - newest_ns
    # The mean period so far approximates the true one; the first few messages say nothing yet.
    before = np.arange(count - 1)
    is_gap = (before >= 4) & (gaps_ns * before.astype(float) > GAP_FACTOR * (newest_ns - oldest_ns))
    counts = int(is_gap.sum()), int((np.diff(stamps_ns) < 0).sum()), undecodable_count
    span_s = 0.0 if start_ns is None or end_ns is None else (end_ns - start_ns) / 1e9
    rate_hz, gap_s = (count - 1) / span_s if span_s > 0 else None, max(0, int(gaps_ns.max(initial=0))) / 1e9
    return TopicSummary(*info[:3], kind_of(info), count, rate_hz, start_ns, end_ns, gap_s, *counts)


def inspect_recording(recording: Recording, head_s: float = math.inf) -> RecordingSummary:
    """Read a recording once and summarise it, without pixels; what cannot be decoded is counted, and a loss.

    With `head_s`, reading ends after so many seconds of the log, once each topic of a role has had a message; where
    joints or transforms are near no image so far, as of a topic that begins later, after ten times as many.
    """
    decoder, contents, frames = Decoder(recording.file.limits), Contents(), set[str]()
    infos, undecodable = dict[str, TopicInfo](), Counter[str]()
    stamps_ns = defaultdict[str, "array[int]"](lambda: array("q"))
    joints = defaultdict[str, dict[Joints, None]](dict)
    awaited = {name for role in Role if (name := recording.topic_of(role)) is not None}
    nominal = {recording.topic_of(Role.TF), *recording.arms[0].static_transforms()}
    start_ns: int | None = None
    is_late = False
    for raw in recording.file.source.messages():
        stamp_ns = raw.log_time_ns
        start_ns = stamp_ns if start_ns is None else start_ns
        if stamp_ns > start_ns + 1e9 * head_s and awaited <= infos.keys():
            if is_late or not any(_apart_s(recording, stamps_ns, recording.tree_of(contents))):
                break
            head_s, is_late = LATE_TOPICS * head_s, True
        infos.setdefault(raw.topic, TopicInfo(*raw[:3]))
        if kind_of(raw) is not None:
            # Of all but the transforms the names are enough.
            sample = recording.file.collect(contents if raw.topic in nominal else Contents(), decoder, raw)
            undecodable[raw.topic] += sample is None
            stamp_ns = stamp_ns if sample is None else sample.stamp_ns
            if isinstance(sample, JointSample) and len(joints[raw.topic]) < MAX_JOINT_SETS:
                joints[raw.topic][sample.names] = None
            elif isinstance(sample, messages.RawTransforms):
                named = [name for one in sample.transforms for name in (one.parent, one.child)]
                frames.update(named[: max(0, MAX_NAMES - len(frames))])
        stamps_ns[raw.topic].append(min(stamp_ns, messages.MAX_STAMP_NS))
    for info in recording.topics():
        infos.setdefault(info.topic, info)
    listed = tuple(_summary(infos[name], stamps_ns[name], undecodable[name]) for name in sorted(infos))
    usable = {topic.topic for topic in listed if topic.message_count > topic.undecodable_count}
    roles = {str(role): name for role in Role if (name := recording.topic_of(role)) in usable}
    cameras = {topic: track for topic, track in recording.file.cameras.items() if track.runs}
    names = {topic: best_joints(found, recording.profile.robot) for topic, found in joints.items()}
    ends_ns = [at for logged in stamps_ns.values() if logged for at in (min(logged), max(logged))]
    duration_s = (max(ends_ns) - min(ends_ns)) / 1e9 if ends_ns else 0.0
    tree, all_frames = recording.tree_of(contents), tuple(sorted(frames))
    apart_s = _apart_s(recording, stamps_ns, tree)
    return RecordingSummary(recording, duration_s, listed, roles, cameras, all_frames, names, tree, *apart_s)


def _apart_s(recording: Recording, stamps_ns: Mapping[str, array[int]], tree: TransformTree) -> tuple[float, float]:
    """`joints_apart_s` and `base_apart_s` of a summary, by stamps of topics and the transforms that were read."""
    topics = (recording.topic_of(role) or "" for role in (Role.IMAGE, Role.JOINTS))
    images_ns, joints_ns = (np.unique(np.array(stamps_ns.get(topic, ()), np.int64)) for topic in topics)
    frames = recording.profile.frames.camera, recording.profile.frames.base
    is_logged = recording.profile.camera_to_base is None and tree.links(*frames)
    if not len(images_ns):
        return 0.0, 0.0
    joints_apart_ns = apart_ns(joints_ns, images_ns).min() if len(joints_ns) else 0
    base_apart_ns = tree.apart_ns(*frames, images_ns).min() if is_logged else 0
    return 1e-9 * float(joints_apart_ns), 1e-9 * float(base_apart_ns)


def copied_messages(recording: Recording) -> Iterator[tuple[str, Sample | EncodedSample]]:
    """Yield (topic, message) of every topic that svmdist understands, in file order.

    Foxglove's messages in protobuf are copied; others become Foxglove's, and their images PNG. True child frames get
    `TRUE_SUFFIX`. What cannot be decoded is left out; `Recording.health` counts it in the pass that measures.
    """
    decoder = Decoder(recording.file.limits)
    truth = recording.topic_of(Role.GROUND_TRUTH_TF)
    for raw in recording.file.source.messages():
        if kind_of(raw) is None:
            continue
        if raw.message_encoding == "protobuf" and raw.topic != truth:
            yield raw.topic, EncodedSample(raw.log_time_ns, raw.schema, raw.data)
            continue
        try:
            sample = messages.to_sample(decoder.decode(raw))
        except (DecodeError, ImageError):
            continue
        if raw.topic == truth and isinstance(sample, TransformsSample):
            named = [replace(one, child=one.child.removesuffix(TRUE_SUFFIX) + TRUE_SUFFIX) for one in sample.transforms]
            sample = replace(sample, transforms=tuple(named))
        yield raw.topic, sample

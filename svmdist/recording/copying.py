"""Copying a recording: what svmdist understands of any log, as messages that `RecordingWriter` takes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from svmdist.recording.messages.checks import DecodeError, EncodedImage, RawTransforms
from svmdist.recording.messages.decoding import Decoder, kind_of
from svmdist.recording.messages.encoding import EncodedSample
from svmdist.recording.messages.foxglove import MESSAGES
from svmdist.recording.messages.images import ImageError
from svmdist.recording.reader import Recording
from svmdist.recording.sources import RawMessage
from svmdist.recording.topics import Role
from svmdist.samples import ImageSample, Sample, TransformsSample

TRUE_SUFFIX = "_ground_truth"
"""Goes to the names of true frames in a copy. A frame has one parent in a viewer, and `tool` has the robot's."""


def copied_messages(recording: Recording) -> Iterator[tuple[str, Sample | EncodedSample]]:
    """Yield (topic, message) of every topic that svmdist understands, in file order.

    Foxglove's messages in protobuf are copied as they are; others, those of ROS for instance, are written as
    Foxglove's. Images that were compressed by ROS or stand in JSON become PNG. The child frames of the true transforms
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
    known: Any = MESSAGES.get(raw.schema) if raw.message_encoding == "protobuf" else None
    if known is not None:
        return EncodedSample(raw.log_time_ns, known, bytes(raw.data))
    return _sample(decoder, raw)


def _renamed(decoder: Decoder, raw: RawMessage) -> Sample:
    sample = _sample(decoder, raw)
    if not isinstance(sample, TransformsSample):
        return sample
    transforms = tuple(replace(one, child=one.child + TRUE_SUFFIX) for one in sample.transforms)
    return replace(sample, transforms=transforms)


def _sample(decoder: Decoder, raw: RawMessage) -> Sample:
    message = decoder.read(raw)
    if isinstance(message, RawTransforms):
        return message.to_sample()
    if isinstance(message, EncodedImage):
        return ImageSample(message.stamp_ns, message.frame_id, message.decode())
    return message

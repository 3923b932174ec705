"""Decoded messages: each is a sample or a loss, and every call streams the file anew."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from svmdist.profile import Limits
from svmdist.recording.encode import encode
from svmdist.recording.mcap_file.source import McapSource
from svmdist.recording.messages.checks import EncodedImage
from svmdist.recording.observing import DecodedMessages
from svmdist.recording.source import LossKind
from svmdist.samples import ImageSample, JointSample, TransformsSample

from .builders import Entry, write_messages


def joint_message(stamp_ns: int, *names: str) -> bytes:
    """Joint states, all zero."""
    return encode(JointSample(stamp_ns, names, np.zeros(len(names))))


def messages_of(path: Path, limits: Limits | None = None) -> DecodedMessages:
    """What a file holds."""
    limits = limits or Limits()
    return DecodedMessages(McapSource(path, limits), limits)


def test_the_samples_are_those_that_were_written(native: Path, entries: list[Entry]) -> None:
    """In file order, with their stamps and values; transforms to rounding, for they travel as quaternions."""
    messages = messages_of(native)
    written = [entry for entry in entries if entry.topic in {"/PSM1/measured_js", "/tf"}]
    found = list(messages.samples("/PSM1/measured_js", "/tf"))
    assert len(found) == len(written)
    by_stamp = sorted(found, key=lambda pair: (pair[1].stamp_ns, pair[0].topic))
    expected = sorted(written, key=lambda entry: (entry.sample.stamp_ns, entry.topic))
    for (raw, sample), entry in zip(by_stamp, expected, strict=True):
        assert raw.topic == entry.topic
        match sample, entry.sample:
            case JointSample(), JointSample() as joints:
                assert sample.names == joints.names
                np.testing.assert_array_equal(sample.positions, joints.positions)
            case TransformsSample(), TransformsSample() as transforms:
                np.testing.assert_allclose(
                    sample.transforms[0].T_parent_child, transforms.transforms[0].T_parent_child, atol=1e-12
                )
            case _:
                pytest.fail(f"a {type(sample).__name__} for a {type(entry.sample).__name__}")
    assert messages.health.is_clean


def test_every_call_begins_anew(native: Path) -> None:
    messages = messages_of(native)
    first = [raw.log_time_ns for raw, _ in messages.samples("/tf")]
    assert first == [raw.log_time_ns for raw, _ in messages.samples("/tf")]
    assert list(messages.samples("/nowhere")) == []


def test_images_stay_encoded(native: Path, entries: list[Entry]) -> None:
    """Until their pixels are asked for, which are those that were written: a PNG loses nothing."""
    written = [entry.sample for entry in entries if isinstance(entry.sample, ImageSample)]
    found = [image for _, image in messages_of(native).samples("/ECM/left/image")]
    for image, sample in zip(found, written, strict=True):
        assert isinstance(image, EncodedImage)
        np.testing.assert_array_equal(image.decode(), sample.image_bgr)


def test_a_message_that_cannot_be_used_is_a_loss_on_its_topic(tmp_path: Path) -> None:
    """Broken bytes and a message above the limit are left out; those around them are delivered."""
    rows = [
        ("/js", "foxglove.JointStates", "protobuf", data, stamp_ns)
        for stamp_ns, data in enumerate(
            [joint_message(1, "a"), b"\xff", joint_message(3, *(f"joint {n}" for n in range(200)))], start=1
        )
    ]
    messages = messages_of(write_messages(tmp_path / "a.mcap", rows), Limits(message_bytes=1024))
    assert [sample.stamp_ns for _, sample in messages.samples("/js")] == [1]
    broken, large = messages.health.losses
    assert broken.kind is large.kind is LossKind.MESSAGE
    assert broken.topic == large.topic == "/js"
    assert "not a foxglove.JointStates" in broken.detail
    assert "the limit is 1024" in large.detail

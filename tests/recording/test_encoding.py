"""Samples that are encoded together have the bytes that each has alone."""

from __future__ import annotations

import pytest

from svmdist.recording.writer import EncodedSample, encode, encode_all
from tests.synthetic import make_scene, samples


@pytest.mark.parametrize("jpeg_quality", [None, 80])
def test_together_as_alone(jpeg_quality: int | None) -> None:
    """Bit by bit, quaternions included, although those of all samples are computed at once."""
    stream = list(samples(make_scene(64, 48), 12))
    assert {type(sample).__name__ for _, sample in stream} >= {"TransformsSample", "ImageSample"}
    expected = [
        (topic, EncodedSample(sample.stamp_ns, type(sample), encode(sample, jpeg_quality)))
        for topic, sample in stream
    ]
    assert encode_all(stream, jpeg_quality) == expected

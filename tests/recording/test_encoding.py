"""Samples that are encoded together have the bytes that each has alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from svmdist.recording.encode import EncodedSample, encode, encode_all
from svmdist.recording.writer import RecordingWriter
from svmdist.samples import PoseSample
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


def test_encoded_samples_make_the_same_file(tmp_path: Path) -> None:
    stream = list(samples(make_scene(64, 48), 12))
    files = []
    for name, entries in (("plain", stream), ("encoded", encode_all(stream))):
        with RecordingWriter(tmp_path / name, {"scenario": "x"}) as writer:
            for topic, sample in entries:
                writer.write(topic, sample)
        files.append((tmp_path / name).read_bytes())
    assert files[0] == files[1]


def test_an_encoded_sample_of_another_type_is_told(tmp_path: Path) -> None:
    pose = encode_all([("/a", PoseSample(1, "base", np.eye(4)))])[0][1]
    other = next(sample for _, sample in samples(make_scene(64, 48), 1) if not isinstance(sample, PoseSample))
    with RecordingWriter(tmp_path / "x", {}) as writer:
        writer.write("/a", pose)
        with pytest.raises(ValueError, match="carries PoseSample"):
            writer.write("/a", encode_all([("/a", other)])[0][1])

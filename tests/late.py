"""Logs whose clocks differ: a golden log in 3D, written anew with other stamps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from svmdist.profile import Limits, load_profile
from svmdist.recording.log import open_recording
from svmdist.recording.messages import Decoder, EncodedImage, to_sample
from svmdist.recording.writer import EncodedSample, RecordingWriter
from svmdist.samples import ImageSample, JointSample, PoseSample, Sample, TransformsSample

ROBOT = (JointSample, PoseSample, TransformsSample)
IMAGES = (ImageSample,)
Log = list[tuple[str, Sample | EncodedSample]]


def samples_of(path: Path, seconds: float, *, decoded: bool = False) -> Log:
    """The first seconds of a log; images stay as they are encoded, unless their stamps are to be moved."""
    log: Log = []
    decoder = Decoder(Limits())
    begin_ns = None
    for raw in open_recording(path, load_profile()).file.source.messages():
        begin_ns = raw.log_time_ns if begin_ns is None else begin_ns
        if raw.log_time_ns > begin_ns + seconds * 1e9:
            break
        message = decoder.decode(raw)
        if isinstance(message, EncodedImage) and not decoded:
            log.append((raw.topic, EncodedSample(message.stamp_ns, ImageSample, raw.data)))
        else:
            log.append((raw.topic, to_sample(message)))
    return log


def write_shifted(path: Path, log: Log, kinds: tuple[type, ...], late_s: float) -> Path:
    """Write a log with the stamps of some kinds of samples later, but for ground truth; in the order of the stamps."""
    shifted = [
        (topic, _later(sample, round(late_s * 1e9)))
        if isinstance(sample, kinds) and not isinstance(sample, EncodedSample) and "ground_truth" not in topic
        else (topic, sample)
        for topic, sample in log
    ]
    with RecordingWriter(path, {"scenario": "late"}) as writer:
        for topic, sample in sorted(shifted, key=lambda pair: pair[1].stamp_ns):
            writer.write(topic, sample)
    return path


def _later(sample: Sample, late_ns: int) -> Sample:
    if isinstance(sample, TransformsSample):
        transforms = tuple(replace(each, stamp_ns=each.stamp_ns + late_ns) for each in sample.transforms)
        return TransformsSample(sample.stamp_ns + late_ns, transforms)
    return replace(sample, stamp_ns=sample.stamp_ns + late_ns)

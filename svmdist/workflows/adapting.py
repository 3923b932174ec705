"""Segmentation that learns from a log does so before the first row, so that rows do not depend on their order."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

from svmdist.recording.encoded import Needs
from svmdist.recording.reader import Recording
from svmdist.samples import Image, Observation, Rejection
from svmdist.vision.segmentation.auto import AutoSegmenter
from svmdist.vision.segmentation.segmenter import Segmenter
from svmdist.workflows.conditions import ReplayCondition


def adapted_segmenters(
    segmenter: Segmenter, recording: Recording, conditions: Sequence[ReplayCondition]
) -> list[Segmenter]:
    """The segmenter for each condition: one that learns has seen the log's first images under that condition."""
    if not isinstance(segmenter, AutoSegmenter):
        return [segmenter for _ in conditions]
    count, stride = segmenter.adapting_frames
    first = _first_observations(recording, count, stride)
    return [
        segmenter.adapted_to(
            [image for frame, seen in first for image in _images(condition.apply(seen, frame))]
        )
        for condition in conditions
    ]


def _first_observations(recording: Recording, count: int, stride: int) -> list[tuple[int, Observation]]:
    """Every `stride`-th of a log's first observations with its number, those that can be read of `count`."""
    needs = Needs(joints=False, transforms=False, right=True)
    encoded = enumerate(recording.encoded_observations(recording.instruments[:1], needs))
    found = []
    for frame, one in islice(encoded, 0, count * stride, stride):
        decoded = one.decode().found
        if not isinstance(decoded, Rejection):
            found.append((frame, decoded[0]))
    return found


def _images(seen: Observation) -> list[Image]:
    return [seen.image_bgr] if seen.right is None else [seen.image_bgr, seen.right.image_bgr]

"""Segmentation that learns from a log does so before the first row, so that rows do not depend on their order."""

from __future__ import annotations

from collections.abc import Sequence

from svmdist.recording.log import Recording
from svmdist.recording.observations import EncodedObservation, Needs
from svmdist.samples import Image, Observation, Rejection
from svmdist.vision.segmentation import AutoSegmenter, Segmenter
from svmdist.workflows.conditions import ReplayCondition


def adapted_segmenters(
    segmenter: Segmenter, recording: Recording, conditions: Sequence[ReplayCondition]
) -> list[Segmenter]:
    """The segmenter for each condition: one that learns has seen images of all of the log under that condition."""
    if not isinstance(segmenter, AutoSegmenter):
        return [segmenter for _ in conditions]
    seen = spread_observations(recording, segmenter.adapting_frames)
    return [
        segmenter.adapted_to([image for frame, one in seen for image in _images(condition.apply(one, frame))])
        for condition in conditions
    ]


def spread_observations(recording: Recording, count: int) -> list[tuple[int, Observation]]:
    """Up to twice `count` of a log's observations with their numbers, evenly from its beginning to its end.

    The log is read once, its length unknown: of those kept every second one goes whenever there are too many, so that
    memory does not grow with the log.
    """
    needs = Needs(joints=False, transforms=False, right=True)
    kept: list[tuple[int, EncodedObservation]] = []
    stride = 1
    for frame, one in enumerate(recording.encoded_observations(recording.instruments[:1], needs)):
        if frame % stride == 0:
            kept.append((frame, one))
        if len(kept) > 2 * count:
            kept, stride = kept[::2], 2 * stride
    decoded = ((frame, one.decode().found) for frame, one in kept)
    return [(frame, found[0]) for frame, found in decoded if not isinstance(found, Rejection)]


def _images(seen: Observation) -> list[Image]:
    return [seen.image_bgr] if seen.right is None else [seen.image_bgr, seen.right.image_bgr]

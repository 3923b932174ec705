"""Estimate: a recording's observations through an estimator, one estimate a frame."""

from __future__ import annotations

from collections.abc import Iterator

from svmdist.estimation.methods import Estimator
from svmdist.recording.reader import Recording
from svmdist.samples import Estimate, Rejection


def estimate(recording: Recording, estimator: Estimator) -> Iterator[Estimate]:
    """Yield one estimate for each image of a recording, in order, holding one frame at a time.

    An image that cannot be decoded is an estimate with the status of its rejection.
    """
    for observation in recording.observations():
        if isinstance(observation, Rejection):
            yield Estimate(observation.stamp_ns, observation.status, detail=observation.detail)
        else:
            yield estimator.estimate(observation)

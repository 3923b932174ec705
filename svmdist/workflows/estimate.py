"""Estimate: a recording through one method, one result per frame and instrument."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from svmdist.recording.log import Recording
from svmdist.results import FrameResult
from svmdist.workflows.replay import replay
from svmdist.workflows.request import Setup


def estimate(
    recording: Recording, setup: Setup, wanted: Sequence[str] | None = None, jobs: int | None = None
) -> Iterator[FrameResult]:
    """Give one result per image and instrument, in order, holding a few frames at a time.

    An image that cannot be decoded is a result with the status of its rejection. `wanted` and `jobs` are as in
    `replay`.
    """
    lanes = replay(recording, [setup], wanted=wanted, jobs=jobs)
    return (result for (replayed,) in lanes for result in replayed.results)

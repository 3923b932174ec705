"""Estimate: a recording through one method, one result per frame and instrument."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from svmdist.estimation.lag import LagEstimate
from svmdist.recording.log import Recording
from svmdist.results import FrameResult
from svmdist.workflows.lag import with_lag
from svmdist.workflows.replay import replay
from svmdist.workflows.request import LOG, Request, Setup


@dataclass(frozen=True)
class Measured:
    """The rows of one recording, the recording as it is and as methods read it, and the lag that was applied."""

    recording: Recording
    read: Recording
    rows: tuple[FrameResult, ...]
    lag: LagEstimate | None


Keep = Callable[[Measured], None]
"""Is called with all rows of a recording, where something is made of them together."""


def estimate(
    recording: Recording, setup: Setup, wanted: Sequence[str] | None = None, jobs: int | None = None
) -> Iterator[FrameResult]:
    """Give one result per image and instrument, in order, holding a few frames at a time.

    An image that cannot be decoded is a result with the status of its rejection. `wanted` and `jobs` are as in
    `replay`.
    """
    lanes = replay(recording, [setup], wanted=wanted, jobs=jobs)
    return (result for (replayed,) in lanes for result in replayed.results)


def with_requested_lag(
    recording: Recording, request: Request, jobs: int | None, on_image: Callable[[], None] | None = None
) -> Recording:
    """The recording with the lag that the request names; says which one `auto` found, or why there is none."""
    if request.lag is None:
        return recording
    corrected, found = with_lag(
        recording, request.setup.profile, request.lag, request.instruments, jobs, on_image=on_image
    )
    if not found.told:
        reason = f"the lag cannot be estimated and none is applied: {found.reason}"
        LOG.info("note: %s: %s", recording.name, reason)
    elif request.lag == "auto":
        LOG.info(
            "note: %s: lag %+.1f ms (confidence %.2f)", recording.name, found.lag_s * 1e3, found.confidence
        )
    return corrected

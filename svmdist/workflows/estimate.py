"""Estimate: the rows of one log, after the time offset of its images where one is given or to be found."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.errors import KinematicsError, RecordingError
from svmdist.estimation.lag import LagEstimate, Predict, estimate_lag
from svmdist.estimation.plane_mapping import PUBLISHED_MAPPING
from svmdist.profile import Profile
from svmdist.recording.log import KnownLag, Recording
from svmdist.results import FrameResult
from svmdist.transforms import Array
from svmdist.workflows.references import PoseAt, Reference, TruthRules, tool_track
from svmdist.workflows.replay import replay
from svmdist.workflows.request import LOG, Lag, Request, Setup
from svmdist.workflows.scores import Readings

FOUND_LAG_STD_S = 0.01
"""The middle of an instrument that enters the image or is partly hidden moves otherwise than its tool: lags that are
found on six seconds of such a log are off by as much, beside what noise does."""


def with_lag(
    recording: Recording,
    profile: Profile,
    lag: Lag | None,
    wanted: Sequence[str] | None = None,
    jobs: int | None = None,
    rules: TruthRules | None = None,
    on_image: Callable[[], None] | None = None,
) -> tuple[Recording, LagEstimate]:
    """Correct the clocks of a recording by a lag; `auto` is one pass over the images, and calls `on_image` for each."""
    if lag is None:
        return recording, LagEstimate(0.0, None, 1.0)
    found = LagEstimate(float(lag), None, 1.0) if lag != "auto" else None
    found = found or _find_lag(recording, profile, wanted, jobs, rules, on_image)
    if not found.told:
        return recording, found
    std_s = 0.0 if found.std_s is None else float(np.hypot(found.std_s, FOUND_LAG_STD_S))
    return recording.with_lag(KnownLag(found.lag_s, std_s), profile), found


def _find_lag(
    recording: Recording,
    profile: Profile,
    wanted: Sequence[str] | None,
    jobs: int | None,
    rules: TruthRules | None,
    on_image: Callable[[], None] | None,
) -> LagEstimate:
    # From where the middle of each instrument is seen, whatever the method: nothing of the joints is in that. Of
    # several instruments, which share a clock, the most confident one counts.
    seen = Setup(profile, "centroid", "corrected", None, PUBLISHED_MAPPING)
    names = recording.instruments if wanted is None else tuple(wanted)
    readings = {name: Readings() for name in names}
    for (replayed,) in replay(recording, [seen], wanted=wanted, jobs=jobs):
        for name, result in zip(names, replayed.results, strict=True):
            readings[name].add(result)
        if on_image is not None:
            on_image()
    found = [
        recording_lag(
            readings[name],
            recording.for_instrument(name),
            profile.for_instrument(name),
            rules or TruthRules(),
        )
        for name in names
    ]
    return max(found, key=lambda estimate: (estimate.told, estimate.confidence))


def recording_lag(
    rows: Iterable[FrameResult] | Readings, recording: Recording, profile: Profile, rules: TruthRules
) -> LagEstimate:
    """Estimate the lag of a recording from where its measured rows saw the tool.

    The tool's motion is taken from kinematics, else from the strongest other reference that the log has.
    """
    readings = rows if isinstance(rows, Readings) else Readings(rows)
    seen = np.isfinite(readings.tool_px).all(axis=1)
    problems = []
    for reference in (Reference.KINEMATICS, Reference.POSE, Reference.TF, Reference.GROUND_TRUTH):
        try:
            at = tool_track(recording, profile, reference, rules)
        except (RecordingError, KinematicsError) as problem:
            problems.append(str(problem))
            continue
        return estimate_lag(readings.stamps_ns[seen], readings.tool_px[seen], predictor(at, recording.camera))
    return LagEstimate(0.0, None, 0.0, f"the log has no motion of the tool but in its images: {problems[0]}")


def predictor(at: PoseAt, camera: Camera) -> Predict:
    """Project the tool's origin by poses `T_camera_tool` into the image."""

    def predict(stamps_ns: NDArray[np.int64]) -> tuple[Array, NDArray[np.bool_]]:
        pose = at(stamps_ns)
        p_camera_m = pose.values[:, :3, 3]
        known = pose.valid & (np.where(pose.valid, p_camera_m[:, 2], 0.0) > 1e-3)
        predicted = np.full((len(stamps_ns), 2), np.nan)
        predicted[known] = camera.project(p_camera_m[known])
        return predicted, known

    return predict


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

"""Estimate: the rows of one log, after the time offset of its images where one is given or to be found."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from svmdist.camera import Camera
from svmdist.errors import KinematicsError, RecordingError
from svmdist.estimation.alarms import AlarmRules
from svmdist.estimation.lag import estimate_lag
from svmdist.estimation.plane_mapping import PUBLISHED_MAPPING
from svmdist.recording.log import Recording
from svmdist.results import FrameResult
from svmdist.tracks import LagEstimate, Mask
from svmdist.transforms import Array, Stamps
from svmdist.workflows.replay import replay
from svmdist.workflows.request import Lag, Request, Setup
from svmdist.workflows.scoring.references import PoseAt, Reference, TruthRules, tool_track
from svmdist.workflows.scoring.scores import Readings

FOUND_LAG_STD_S = 0.01
"""The middle of an instrument that enters the image or is partly hidden moves otherwise than its tool: lags that are
found on six seconds of such a log are off by as much, beside what noise does."""


@dataclass(frozen=True)
class Measured:
    """The rows of one recording, the recording as it is and as methods read it, and the lag that was applied."""

    recording: Recording
    read: Recording
    rows: tuple[FrameResult, ...]
    lag: LagEstimate | None
    by: Mapping[tuple[Reference, str], Readings] = field(default_factory=dict)
    """What was measured in the same pass as a truth, by reference and instrument."""


Keep = Callable[[Measured], None]  # is called with all rows of a recording, where something is made of them together


def estimate(
    recording: Recording, setup: Setup, jobs: int | None = None, *, rest: bool = True, alarms: AlarmRules | None = None
) -> Iterator[FrameResult]:
    """One result per image and wanted instrument, in order; of an image that cannot be decoded its rejection."""
    results = replay(recording, [setup], jobs=jobs, rest=rest, alarms=alarms)
    return (result for (replayed,) in results for result in replayed.results)


def with_lag(recording: Recording, request: Request, jobs: int | None = None) -> tuple[Recording, LagEstimate]:
    """Apply the time offset of a request; `auto` is one pass over the images."""
    found = given_lag(request.lag)
    if request.lag == "auto":
        # From the middle of each instrument in the image, whatever the method: nothing of the joints is in that. Of
        # several instruments, which share a clock, the most confident one counts.
        seen = Setup(request.setup.profile, "centroid", mapping=PUBLISHED_MAPPING)
        readings = {name: Readings() for name in recording.measured}
        for result in estimate(recording, seen, jobs):
            readings[result.instrument].add(result)
        each = [recording_lag(rows, recording.for_instrument(name), request.rules) for name, rows in readings.items()]
        found = max(each, key=lambda one: (one.is_observable, one.confidence))
    if request.lag is None or not found.is_observable:
        return recording, found
    std_s = 0.0 if found.std_s is None else float(np.hypot(found.std_s, FOUND_LAG_STD_S))
    return replace(recording, lag=replace(found, std_s=std_s)), found


def given_lag(lag: Lag | None) -> LagEstimate:
    """A time offset as the user states it; 0 for `auto`, until it is found."""
    return LagEstimate(0.0 if lag is None or lag == "auto" else float(lag), None, 1.0)


def recording_lag(readings: Readings, log: Recording, rules: TruthRules) -> LagEstimate:
    """Estimate the lag of a recording from where its measured rows saw the tool, by kinematics or another reference."""
    seen = np.isfinite(readings.tool_px).all(axis=1)
    problems = []
    for reference in (Reference.KINEMATICS, Reference.POSE, Reference.TF, Reference.GROUND_TRUTH):
        try:
            at = tool_track(log, reference, rules)
        except (RecordingError, KinematicsError) as problem:
            problems.append(str(problem))
            continue
        predict = partial(predicted_tool_px, at, log.camera)
        return estimate_lag(readings.stamps_ns[seen], readings.tool_px[seen], predict)
    return LagEstimate(0.0, None, 0.0, f"the log has no motion of the tool but in its images: {problems[0]}")


def predicted_tool_px(at: PoseAt, camera: Camera, stamps_ns: Stamps) -> tuple[Array, Mask]:
    """Project the tool's origin by poses `T_camera_tool` into the image: pixels, shape (n, 2), and which are known."""
    pose = at(stamps_ns)
    p_camera_m = pose.values[:, :3, 3]
    known = pose.valid & (np.where(pose.valid, p_camera_m[:, 2], 0.0) > 1e-3)
    predicted = np.full((len(stamps_ns), 2), np.nan)
    predicted[known] = camera.project(p_camera_m[known])
    return predicted, known

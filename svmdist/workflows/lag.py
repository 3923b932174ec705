"""The lag of a recording: the tool's track in the images against its track by kinematics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.errors import KinematicsError, RecordingError
from svmdist.estimation.lag import LagEstimate, Predict, estimate_lag
from svmdist.profile import Profile
from svmdist.recording.reader import Recording
from svmdist.results import FrameResult
from svmdist.transforms import Array
from svmdist.workflows.scoring.distances import Readings
from svmdist.workflows.scoring.truth import PoseAt, Reference, TruthRules, tool_track

Lag = float | Literal["auto"]
"""A lag in s, positive when the image stamps are late, or `auto` to estimate it."""


def recording_lag(
    rows: Sequence[FrameResult], recording: Recording, profile: Profile, rules: TruthRules
) -> LagEstimate:
    """Estimate the lag of a recording from where its measured rows saw the tool.

    The tool's motion is taken from kinematics, else from the strongest other reference that the log has.
    """
    readings = Readings(rows)
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

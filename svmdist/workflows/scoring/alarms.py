"""Alarms scored: the alarms that the rows of a recording raise, against the true clearance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from svmdist.alarm_metrics import AlarmStatistics, alarm_statistics
from svmdist.errors import ProfileError, RecordingError, UsageError
from svmdist.estimation.alarms import AlarmRules, AlarmWatch
from svmdist.estimation.methods import PLANAR_METHODS, SPATIAL_METHODS
from svmdist.profile import Profile
from svmdist.results import FrameResult
from svmdist.tracks import SampledDistances


def require_clearance(method: str, profile: Profile | None = None) -> None:
    """Refuse alarms where no clearance is estimated: no alarm would ever be raised, which looks like safety.

    Raises UsageError that names the methods that estimate one, and ProfileError for a profile without [instrument].
    """
    if method in PLANAR_METHODS:
        raise UsageError(
            f"alarms need a clearance, and {method} measures in the plane: the choices are"
            f" {', '.join(SPATIAL_METHODS)}"
        )
    if profile is not None and profile.instrument is None:
        raise ProfileError(
            f"profile {profile.name} has no [instrument]: alarms need a clearance, which needs the instrument's sizes"
        )


def score_alarms(
    rows: Sequence[FrameResult], truth: SampledDistances, stamps_ns: NDArray[np.int64], rules: AlarmRules
) -> AlarmStatistics:
    """Score the alarms that all rows of a recording raise, measured or not, with the truth at their stamps.

    A row without a clearance raises no alarm, which misses one where the frame is unsafe. Frames whose true
    clearance is not known are left out. Raises RecordingError where those are all frames.
    """
    known = truth.valid & np.isfinite(truth.clearance_m)
    if not known.any():
        raise RecordingError("there is no frame with a true clearance to score alarms against")
    watch = AlarmWatch(rules)
    order = np.argsort(stamps_ns, kind="stable")
    states = [watch.watch(rows[index]).alarm for index in order]
    alarms = np.array([state is True for state in states], np.bool_)
    judged = np.array([state is not None for state in states], np.bool_)
    kept = known[order]
    seconds = (stamps_ns[order] - stamps_ns[order[0]])[kept] / 1e9
    return alarm_statistics(
        seconds, alarms[kept], truth.clearance_m[order][kept], rules.below_m, judged[kept]
    )

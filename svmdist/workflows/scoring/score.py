"""A score: the estimates of one recording, or of all, paired by time with one reference, and their figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from svmdist.alarm_metrics import AlarmStatistics, pooled_alarms
from svmdist.estimation.alarms import AlarmRules
from svmdist.estimation.lag import LagEstimate
from svmdist.estimation.planar.equations import Equations
from svmdist.metrics import ErrorStatistics, Interval, bootstrap_intervals, coverage, error_statistics
from svmdist.recording.reader import Recording
from svmdist.samples import Estimate
from svmdist.tracks import SampledDistances
from svmdist.workflows.scoring.alarms import score_alarms
from svmdist.workflows.scoring.distances import (
    DISTANCES,
    PLANAR,
    DistanceScore,
    Pairs,
    pair,
    pooled,
    pooled_score,
    score_pairs,
)
from svmdist.workflows.scoring.truth import Reference, TruthRules, distance_truth
from svmdist.workflows.setup import Setup

BOOTSTRAP_SEED = 36


@dataclass(frozen=True)
class Score:
    """How one method did on one recording, or on all of them, against one reference.

    `sample_count` pairs were scored; of `frame_count` frames, `rejected` were not measured, by reason,
    and `unpaired_count` were measured where the reference has no value. Lengths in m. `lag` was taken off
    the image stamps before pairing; `uncorrected` are the statistics without that. `spatial` and `clearance`
    are None where method or reference cannot tell them; `alarms` are scored where rules for them were given.
    """

    recording: str
    method: str
    equations: Equations
    reference: Reference
    frame_count: int
    rejected: Mapping[str, int]
    unpaired_count: int
    fitted_on: bool
    statistics: ErrorStatistics | None
    rmse_interval_m: Interval | None
    r_squared_interval: Interval | None
    pairs: Pairs = field(repr=False)
    lag: LagEstimate | None = None
    uncorrected: ErrorStatistics | None = None
    spatial: DistanceScore | None = None
    clearance: DistanceScore | None = None
    alarms: AlarmStatistics | None = None
    instrument: str = ""

    @property
    def sample_count(self) -> int:
        """Number of scored pairs."""
        return len(self.pairs)

    @property
    def rejected_count(self) -> int:
        """Number of frames that could not be measured."""
        return sum(self.rejected.values())

    @property
    def coverage(self) -> float:
        """Measured frames per frame."""
        return coverage(self.frame_count - self.rejected_count, self.frame_count)


def score_rows(
    rows: Sequence[Estimate],
    recording: Recording,
    setup: Setup,
    reference: Reference,
    rules: TruthRules | None = None,
    lag: LagEstimate | None = None,
    alarms: AlarmRules | None = None,
) -> Score:
    """Score the estimates of one recording, shape (n_frames,), against one reference."""
    stamps_ns = np.array([row.stamp_ns for row in rows], np.int64)

    def truth_at(at_ns: NDArray[np.int64]) -> SampledDistances:
        return distance_truth(recording, setup.profile, reference, at_ns, setup.equations, rules)

    lag_s = lag.lag_s if lag else 0.0
    shifted_ns = stamps_ns - round(lag_s * 1e9)
    truth = truth_at(shifted_ns)
    planar, spatial, clearance = (pair(distance, rows, truth, shifted_ns) for distance in DISTANCES)
    uncorrected = planar if lag_s == 0.0 else pair(PLANAR, rows, truth_at(stamps_ns), stamps_ns)
    return _score(
        planar,
        uncorrected=error_statistics(uncorrected.estimate_m, uncorrected.truth_m),
        lag=lag,
        recording=recording.name,
        setup_method=setup.method,
        equations=setup.equations,
        reference=reference,
        frame_count=len(rows),
        rejected=Counter(str(row.status) for row in rows if not row.measured),
        fitted_on=setup.was_fitted_on(recording),
        spatial=score_pairs(spatial),
        clearance=score_pairs(clearance),
        alarms=score_alarms(rows, truth, shifted_ns, alarms)
        if alarms and reference is Reference.GROUND_TRUTH
        else None,
    )


def pool_scores(scores: Sequence[Score], first_instrument: str = "") -> Score:
    """One score over the pairs of several of one instrument: every frame counts the same.

    It is called `overall`, for any but the first instrument with its name.
    """
    instrument = scores[0].instrument
    rejected: Counter[str] = Counter()
    for score in scores:
        rejected.update(score.rejected)
    alarms = [score.alarms for score in scores if score.alarms]
    pooled_score_of_all = _score(
        pooled([score.pairs for score in scores]),
        recording="overall" if instrument in ("", first_instrument) else f"overall {instrument}",
        setup_method=scores[0].method,
        equations=scores[0].equations,
        reference=scores[0].reference,
        frame_count=sum(score.frame_count for score in scores),
        rejected=rejected,
        spatial=pooled_score([score.spatial for score in scores]),
        clearance=pooled_score([score.clearance for score in scores]),
        alarms=pooled_alarms(alarms) if alarms else None,
    )
    return replace(pooled_score_of_all, instrument=instrument)


def _score(
    pairs: Pairs,
    *,
    recording: str,
    setup_method: str,
    equations: Equations,
    reference: Reference,
    frame_count: int,
    rejected: Counter[str],
    spatial: DistanceScore | None,
    clearance: DistanceScore | None,
    alarms: AlarmStatistics | None,
    fitted_on: bool = False,
    lag: LagEstimate | None = None,
    uncorrected: ErrorStatistics | None = None,
) -> Score:
    rmse_interval_m, r_squared_interval = bootstrap_intervals(pairs.estimate_m, pairs.truth_m, BOOTSTRAP_SEED)
    return Score(
        recording,
        setup_method,
        equations,
        reference,
        frame_count,
        dict(sorted(rejected.items())),
        frame_count - rejected.total() - len(pairs),
        fitted_on,
        error_statistics(pairs.estimate_m, pairs.truth_m),
        rmse_interval_m,
        r_squared_interval,
        pairs,
        lag,
        uncorrected,
        spatial,
        clearance,
        alarms,
    )

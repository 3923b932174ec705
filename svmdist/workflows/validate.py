"""Validate: estimates paired by time with a reference, and scored."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import KinematicsError, RecordingError
from svmdist.estimation.equations import Equations
from svmdist.estimation.lag import LagEstimate
from svmdist.metrics import ErrorStatistics, Interval, bootstrap_intervals, coverage, error_statistics
from svmdist.recording.reader import Recording
from svmdist.samples import Estimate
from svmdist.transforms import Array
from svmdist.workflows.estimate import estimate
from svmdist.workflows.lag import Lag, recording_lag
from svmdist.workflows.setup import Setup
from svmdist.workflows.truth import KINEMATICS_PRINTED_NOTE, Reference, TruthRules, planar_truth

BOOTSTRAP_SEED = 36
PAPER_R_SQUARED = 0.78
"""The paper's own figure (sec. IV); its scene differs from every scene here."""


@dataclass(frozen=True)
class Pairs:
    """Measured frames with a reference: stamps, shape (n,), and both distances, shape (n,) in m."""

    stamps_ns: NDArray[np.int64]
    estimate_m: Array
    truth_m: Array


@dataclass(frozen=True)
class Score:
    """How one method did on one recording, or on all of them, against one reference.

    `sample_count` pairs were scored; of `frame_count` frames, `rejected` were not measured, by reason,
    and `unpaired_count` were measured where the reference has no value. Lengths in m. `lag` was taken off
    the image stamps before pairing; `uncorrected` are the statistics without that.
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

    @property
    def sample_count(self) -> int:
        """Number of scored pairs."""
        return len(self.pairs.stamps_ns)

    @property
    def rejected_count(self) -> int:
        """Number of frames that could not be measured."""
        return sum(self.rejected.values())

    @property
    def coverage(self) -> float:
        """Measured frames per frame."""
        return coverage(self.frame_count - self.rejected_count, self.frame_count)


@dataclass(frozen=True)
class Validation:
    """Scores per recording and reference, overall scores per reference, and notes for a person."""

    scores: tuple[Score, ...]
    overall: tuple[Score, ...]
    notes: tuple[str, ...]

    @property
    def primary(self) -> Score | None:
        """The overall score against the strongest reference there is, in the order of `Reference`."""
        by_reference = {score.reference: score for score in self.overall}
        return next((by_reference[reference] for reference in Reference if reference in by_reference), None)


def validate(
    recordings: Sequence[Recording], setup: Setup, rules: TruthRules | None = None, lag: Lag = 0.0
) -> Validation:
    """Score a setup on recordings against each reference that they have.

    `lag` in s is taken off the image stamps, or estimated first. Recordings the calibration was fitted on
    are scored, marked, and left out of the overall score. Raises RecordingError where a recording has no
    reference at all.
    """
    rules = rules or TruthRules()
    scores: list[Score] = []
    notes: list[str] = []
    for recording in recordings:
        scores += _score_recording(recording, setup, rules, lag, notes)
    overall = []
    for reference in rules.wanted:
        counted = [score for score in scores if score.reference is reference and not score.fitted_on]
        if counted:
            overall.append(_pool(counted))
    return Validation(tuple(scores), tuple(overall), tuple(dict.fromkeys(notes)))


def _score_recording(
    recording: Recording, setup: Setup, rules: TruthRules, lag: Lag, notes: list[str]
) -> list[Score]:
    notes += setup.degeneracies(recording.camera)
    rows = list(estimate(recording, setup.estimator_for(recording)))
    if not rows:
        raise RecordingError(f"{recording.name}: there is no image to measure")
    offset = _resolve_lag(rows, recording, setup, rules, lag)
    if not offset.told:
        notes.append(f"{recording.name}: the lag cannot be told and 0 is used: {offset.reason}")
    scores, missing = [], []
    for reference in rules.wanted:
        try:
            scores.append(score_rows(rows, recording, setup, reference, rules, offset))
        except (RecordingError, KinematicsError) as problem:
            missing.append(f"{recording.name}: no {reference} to compare with: {problem}")
    if not scores:
        raise RecordingError("; ".join(missing))
    notes += missing
    if setup.equations == "printed" and Reference.KINEMATICS in {score.reference for score in scores}:
        notes.append(KINEMATICS_PRINTED_NOTE)
    return scores


def _resolve_lag(
    rows: Sequence[Estimate], recording: Recording, setup: Setup, rules: TruthRules, lag: Lag
) -> LagEstimate:
    """The lag that was asked for, known for sure; or an estimate of it."""
    if lag == "auto":
        return recording_lag(rows, recording, setup.profile, rules)
    return LagEstimate(float(lag), None, 1.0)


def score_rows(
    rows: Sequence[Estimate],
    recording: Recording,
    setup: Setup,
    reference: Reference,
    rules: TruthRules | None = None,
    lag: LagEstimate | None = None,
) -> Score:
    """Score the estimates of one recording, shape (n_frames,), against one reference."""
    measured = [row for row in rows if row.measured]
    stamps_ns = np.array([row.stamp_ns for row in measured], np.int64)
    distance_m = np.array([row.distance_m for row in measured], np.float64)

    def pair(lag_s: float) -> tuple[Pairs, int]:
        shifted_ns = stamps_ns - round(lag_s * 1e9)
        truth = planar_truth(recording, setup.profile, reference, shifted_ns, setup.equations, rules)
        valid = truth.valid
        return Pairs(shifted_ns[valid], distance_m[valid], truth.planar_m[valid]), int(
            np.count_nonzero(~valid)
        )

    lag_s = lag.lag_s if lag else 0.0
    pairs, unpaired_count = pair(lag_s)
    uncorrected = pairs if lag_s == 0.0 else pair(0.0)[0]
    return _score(
        pairs,
        uncorrected=uncorrected,
        lag=lag,
        recording=recording.name,
        setup_method=setup.method,
        equations=setup.equations,
        reference=reference,
        frame_count=len(rows),
        rejected=Counter(str(row.status) for row in rows if not row.measured),
        unpaired_count=unpaired_count,
        fitted_on=setup.was_fitted_on(recording),
    )


def _pool(scores: Sequence[Score]) -> Score:
    """One score over the pairs of several: every frame counts the same."""
    pairs = Pairs(
        np.concatenate([score.pairs.stamps_ns for score in scores]),
        np.concatenate([score.pairs.estimate_m for score in scores]),
        np.concatenate([score.pairs.truth_m for score in scores]),
    )
    rejected: Counter[str] = Counter()
    for score in scores:
        rejected.update(score.rejected)
    return _score(
        pairs,
        uncorrected=None,
        lag=None,
        recording="overall",
        setup_method=scores[0].method,
        equations=scores[0].equations,
        reference=scores[0].reference,
        frame_count=sum(score.frame_count for score in scores),
        rejected=rejected,
        unpaired_count=sum(score.unpaired_count for score in scores),
        fitted_on=False,
    )


def _score(
    pairs: Pairs,
    *,
    uncorrected: Pairs | None,
    lag: LagEstimate | None,
    recording: str,
    setup_method: str,
    equations: Equations,
    reference: Reference,
    frame_count: int,
    rejected: Mapping[str, int],
    unpaired_count: int,
    fitted_on: bool,
) -> Score:
    rmse_interval_m, r_squared_interval = bootstrap_intervals(pairs.estimate_m, pairs.truth_m, BOOTSTRAP_SEED)
    return Score(
        recording,
        setup_method,
        equations,
        reference,
        frame_count,
        dict(sorted(rejected.items())),
        unpaired_count,
        fitted_on,
        error_statistics(pairs.estimate_m, pairs.truth_m),
        rmse_interval_m,
        r_squared_interval,
        pairs,
        lag,
        error_statistics(uncorrected.estimate_m, uncorrected.truth_m) if uncorrected else None,
    )

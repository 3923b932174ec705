"""Validate: estimates paired by time with a reference, and scored."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import KinematicsError, RecordingError
from svmdist.estimation.equations import Equations
from svmdist.metrics import ErrorStatistics, Interval, bootstrap_intervals, coverage, error_statistics
from svmdist.recording.reader import Recording
from svmdist.samples import Estimate
from svmdist.transforms import Array
from svmdist.workflows.estimate import estimate
from svmdist.workflows.setup import Setup
from svmdist.workflows.truth import KINEMATICS_PRINTED_NOTE, Reference, planar_truth

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
    and `unpaired_count` were measured where the reference has no value. Lengths in m.
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
        """The overall score against the strongest reference there is: the simulator's truth, else kinematics."""
        by_reference = {score.reference: score for score in self.overall}
        return by_reference.get(Reference.GROUND_TRUTH) or by_reference.get(Reference.KINEMATICS)


def validate(
    recordings: Sequence[Recording], setup: Setup, references: Sequence[Reference] = tuple(Reference)
) -> Validation:
    """Score a setup on recordings against each reference that they have.

    Recordings the calibration was fitted on are scored, marked, and left out of the overall score.
    Raises RecordingError where a recording has no reference at all.
    """
    scores: list[Score] = []
    notes: list[str] = []
    for recording in recordings:
        scores += _score_recording(recording, setup, references, notes)
    overall = []
    for reference in references:
        counted = [score for score in scores if score.reference is reference and not score.fitted_on]
        if counted:
            overall.append(_pool(counted))
    return Validation(tuple(scores), tuple(overall), tuple(dict.fromkeys(notes)))


def _score_recording(
    recording: Recording, setup: Setup, references: Sequence[Reference], notes: list[str]
) -> list[Score]:
    notes += [f"{note}" for note in setup.degeneracies(recording.camera)]
    rows = list(estimate(recording, setup.estimator_for(recording)))
    if not rows:
        raise RecordingError(f"{recording.name}: there is no image to measure")
    scores, missing = [], []
    for reference in references:
        try:
            scores.append(score_rows(rows, recording, setup, reference))
        except (RecordingError, KinematicsError) as problem:
            missing.append(f"{recording.name}: no {reference} to compare with: {problem}")
    if not scores:
        raise RecordingError("; ".join(missing))
    notes += missing
    if setup.equations == "printed" and Reference.KINEMATICS in {score.reference for score in scores}:
        notes.append(KINEMATICS_PRINTED_NOTE)
    return scores


def score_rows(rows: Sequence[Estimate], recording: Recording, setup: Setup, reference: Reference) -> Score:
    """Score the estimates of one recording, shape (n_frames,), against one reference."""
    measured = [row for row in rows if row.measured]
    stamps_ns = np.array([row.stamp_ns for row in measured], np.int64)
    distance_m = np.array([row.distance_m for row in measured], np.float64)
    truth = planar_truth(recording, setup.profile, reference, stamps_ns, setup.equations)
    pairs = Pairs(stamps_ns[truth.valid], distance_m[truth.valid], truth.planar_m[truth.valid])
    return _score(
        pairs,
        recording=recording.name,
        setup_method=setup.method,
        equations=setup.equations,
        reference=reference,
        frame_count=len(rows),
        rejected=Counter(str(row.status) for row in rows if not row.measured),
        unpaired_count=int(np.count_nonzero(~truth.valid)),
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
    )

"""Validate: all recordings scored against each reference that they have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from svmdist.errors import KinematicsError, RecordingError, UsageError
from svmdist.estimation.alarms import AlarmRules
from svmdist.estimation.lag import LagEstimate
from svmdist.recording.reader import Recording
from svmdist.samples import Estimate
from svmdist.workflows.alarms import require_clearance
from svmdist.workflows.estimate import estimate
from svmdist.workflows.lag import Lag, recording_lag
from svmdist.workflows.score import Score, pool_scores, score_rows
from svmdist.workflows.setup import Setup
from svmdist.workflows.truth import KINEMATICS_PRINTED_NOTE, Reference, TruthRules

PAPER_R_SQUARED = 0.78
"""The paper's own figure (sec. IV); its scene differs from every scene here."""


@dataclass(frozen=True)
class Validation:
    """Scores per recording and reference, overall scores per reference, and notes for a person.

    `alarm_rules` are what alarms were scored by, None where they were not asked for.
    """

    scores: tuple[Score, ...]
    overall: tuple[Score, ...]
    notes: tuple[str, ...]
    alarm_rules: AlarmRules | None = None

    @property
    def primary(self) -> Score | None:
        """The overall score against the strongest reference there is, in the order of `Reference`."""
        by_reference = {score.reference: score for score in self.overall}
        return next((by_reference[reference] for reference in Reference if reference in by_reference), None)


def validate(
    recordings: Sequence[Recording],
    setup: Setup,
    rules: TruthRules | None = None,
    lag: Lag = 0.0,
    alarms: AlarmRules | None = None,
) -> Validation:
    """Score a setup on recordings against each reference that they have, and its alarms where asked for.

    `lag` in s is taken off the image stamps, or estimated first. Recordings the calibration was fitted on
    are scored, marked, and left out of the overall score. Raises RecordingError where a recording has no
    reference at all, or no true clearance to score alarms against, and UsageError for alarms of a method that
    tells no clearance or without ground truth among the references.
    """
    rules = rules or TruthRules()
    if alarms is not None:
        require_clearance(setup.method)
        if Reference.GROUND_TRUTH not in rules.wanted:
            raise UsageError(
                f"alarms are scored against {Reference.GROUND_TRUTH}, the only reference with a clearance; asked"
                f" for were {', '.join(rules.wanted)}"
            )
    scores: list[Score] = []
    notes: list[str] = []
    for recording in recordings:
        scores += _score_recording(recording, setup, rules, lag, alarms, notes)
    overall = []
    for reference in rules.wanted:
        counted = [score for score in scores if score.reference is reference and not score.fitted_on]
        if counted:
            overall.append(pool_scores(counted))
    return Validation(tuple(scores), tuple(overall), tuple(dict.fromkeys(notes)), alarms)


def _score_recording(
    recording: Recording,
    setup: Setup,
    rules: TruthRules,
    lag: Lag,
    alarms: AlarmRules | None,
    notes: list[str],
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
            scores.append(score_rows(rows, recording, setup, reference, rules, offset, alarms))
        except (RecordingError, KinematicsError) as problem:
            missing.append(f"{recording.name}: no {reference} to compare with: {problem}")
    if not scores or (alarms and scores[0].alarms is None):
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

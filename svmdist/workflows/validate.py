"""Validate: all recordings scored against each reference that they have."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

from svmdist.errors import KinematicsError, RecordingError, UsageError
from svmdist.estimation.alarms import AlarmRules
from svmdist.estimation.lag import LagEstimate
from svmdist.estimation.methods import PLANAR_METHODS
from svmdist.recording.log import Recording
from svmdist.results import FrameResult
from svmdist.workflows.estimate import estimate
from svmdist.workflows.lag import Lag, recording_lag, with_lag
from svmdist.workflows.parallel import Progress, Steps, image_total
from svmdist.workflows.request import Setup
from svmdist.workflows.scoring.score import Score, pool_scores, require_clearance, score_rows
from svmdist.workflows.scoring.truth import KINEMATICS_PRINTED_NOTE, Reference, TruthRules

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
    groups: tuple[Score, ...] = ()
    """Scores of logs that were grouped by their metadata, per group and reference."""

    @property
    def primary(self) -> Score | None:
        """The overall score against the strongest reference there is, in the order of `Reference`.

        Of several instruments it is that of the first one.
        """
        by_reference = {score.reference: score for score in reversed(self.overall)}
        return next((by_reference[reference] for reference in Reference if reference in by_reference), None)


@dataclass(frozen=True)
class Measured:
    """The rows of one recording, the recording as it is and as methods read it, and the lag that was taken off."""

    recording: Recording
    read: Recording
    rows: tuple[FrameResult, ...]
    lag: LagEstimate | None


def validate(
    recordings: Sequence[Recording],
    setup: Setup,
    rules: TruthRules | None = None,
    lag: Lag | None = None,
    alarms: AlarmRules | None = None,
    wanted: Sequence[str] | None = None,
    jobs: int | None = None,
    on_measured: Callable[[Measured], None] | None = None,
    on_unusable: Callable[[RecordingError], None] | None = None,
    on_progress: Progress | None = None,
) -> Validation:
    """Score a setup on recordings against each reference that they have, and its alarms where asked for.

    `lag` in s is taken off the image stamps, or estimated first; methods in 3D look up joints there. Every instrument
    of a recording has its own scores;
    `wanted` names the instruments to score. Recordings that the calibration was fitted on are scored and marked, and
    the overall score leaves them out. Raises RecordingError where a recording has no reference at all, or no true
    clearance to score alarms against. Raises UsageError where alarms are asked for and the method estimates no
    clearance, or the references are without ground truth. `on_measured` is given the rows of each recording. With
    `on_unusable`, a recording that cannot be scored is told to it, and the others are scored all the same.
    `on_progress` is told of every row, and of every image where the lag is estimated first.
    """
    rules = rules or TruthRules()
    require_truth_for_alarms(alarms, setup, rules)
    finds_lag = lag == "auto" and setup.method not in PLANAR_METHODS
    steps = Steps(
        on_progress, image_total(recordings, lambda one: len(wanted or one.instruments) + finds_lag)
    )
    parts: list[Scored] = []
    for recording in recordings:
        try:
            parts.append(
                score_recording(recording, setup, rules, lag, alarms, wanted, jobs, steps, on_measured)
            )
        except RecordingError as problem:
            if on_unusable is None:
                raise
            on_unusable(problem)
    return combine(parts, setup, rules, alarms)


@dataclass(frozen=True)
class Scored:
    """The scores of one recording, and remarks on it."""

    scores: tuple[Score, ...]
    notes: tuple[str, ...]


def require_truth_for_alarms(alarms: AlarmRules | None, setup: Setup, rules: TruthRules) -> None:
    """Raise UsageError where alarms are asked for that cannot be judged."""
    if alarms is not None:
        require_clearance(setup.method, setup.profile)
        if Reference.GROUND_TRUTH not in rules.wanted:
            raise UsageError(
                f"alarms are scored against {Reference.GROUND_TRUTH}, the only reference with a clearance; the"
                f" references asked for are {', '.join(rules.wanted)}"
            )


def combine(
    parts: Sequence[Scored],
    setup: Setup,
    rules: TruthRules,
    alarms: AlarmRules | None,
    groups: Sequence[str] = (),
) -> Validation:
    """The scores of recordings, and those of all together; where `groups` names a group of each, of these too."""
    scores = [score for part in parts for score in part.scores]
    if not scores:
        raise RecordingError("no recording could be scored")
    overall, of_groups = [], []
    for of in product(setup.profile.instrument_names, rules.wanted):
        counted = _counted(scores, of)
        if counted:
            overall.append(pool_scores(counted, setup.profile.instrument_name))
    for group in sorted(set(groups)):
        members = [s for part, name in zip(parts, groups, strict=True) if name == group for s in part.scores]
        for of in product(setup.profile.instrument_names, rules.wanted):
            counted = _counted(members, of)
            if counted:
                pooled = pool_scores(counted, setup.profile.instrument_name)
                of_groups.append(replace(pooled, recording=pooled.recording.replace("overall", group, 1)))
    notes = [note for part in parts for note in part.notes]
    return Validation(tuple(scores), tuple(overall), tuple(dict.fromkeys(notes)), alarms, tuple(of_groups))


def _counted(scores: Sequence[Score], of: tuple[str, Reference]) -> list[Score]:
    """The scores of one instrument against one reference, without those of what the calibration was fitted on."""
    return [score for score in scores if (score.instrument, score.reference) == of and not score.fitted_on]


def score_recording(
    recording: Recording,
    setup: Setup,
    rules: TruthRules,
    lag: Lag | None,
    alarms: AlarmRules | None,
    wanted: Sequence[str] | None,
    jobs: int | None,
    steps: Steps | None = None,
    on_measured: Callable[[Measured], None] | None = None,
) -> Scored:
    """Score every wanted instrument. Scores are named after the recording, and after any instrument but the first."""
    steps = steps or Steps(None, None)
    notes = setup.degeneracies(recording.camera)
    planar = setup.method in PLANAR_METHODS  # it needs no joints, and its own rows tell the lag
    read, found = with_lag(
        recording, setup.profile, None if planar else lag, wanted, jobs, rules, steps.advance
    )
    every = list(steps.of(estimate(read, setup, wanted, jobs)))
    if not every:
        raise RecordingError(f"{recording.name}: there is no image to measure")
    scores, missing = [], []
    for name in dict.fromkeys(row.instrument for row in every):
        view, seen = recording.for_instrument(name), setup.for_instrument(name)
        rows = [row for row in every if row.instrument == name]
        label = recording.name if name == setup.profile.instrument_name else f"{recording.name} {name}"
        offset = found
        if planar and lag is not None:
            offset = (
                recording_lag(rows, view, seen.profile, rules)
                if lag == "auto"
                else LagEstimate(float(lag), None, 1.0)
            )
        if not offset.told:
            notes.append(f"{label}: the lag cannot be told and 0 is used: {offset.reason}")
        for reference in rules.wanted:
            try:
                score = score_rows(rows, view, seen, reference, rules, offset, alarms)
            except (RecordingError, KinematicsError) as problem:
                missing.append(f"{label}: no {reference} to compare with: {problem}")
            else:
                scores.append(replace(score, recording=label, instrument=name))
    if not scores or (alarms and scores[0].alarms is None):
        raise RecordingError("; ".join(missing))
    if on_measured is not None:
        on_measured(Measured(recording, read, tuple(every), scores[0].lag))
    notes += missing
    if setup.equations == "printed" and Reference.KINEMATICS in {score.reference for score in scores}:
        notes.append(KINEMATICS_PRINTED_NOTE)
    return Scored(tuple(scores), tuple(notes))

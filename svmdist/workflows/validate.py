"""Validate: recordings scored against each reference that they have."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

from svmdist.errors import KinematicsError, RecordingError, UsageError
from svmdist.estimation.alarms import AlarmRules
from svmdist.estimation.lag import LagEstimate
from svmdist.estimation.methods import PLANAR_METHODS
from svmdist.recording.log import Recording
from svmdist.workflows.estimate import Keep, Measured, estimate, recording_lag, with_lag
from svmdist.workflows.parallel import Progress, Steps, image_total
from svmdist.workflows.request import Request
from svmdist.workflows.scoring.score import Score, pool_scores, require_clearance, score_rows
from svmdist.workflows.scoring.truth import KINEMATICS_PRINTED_NOTE, Reference

PAPER_R_SQUARED = 0.78
"""The paper's own figure (sec. IV); its scene differs from every scene here."""


@dataclass(frozen=True)
class Scored:
    """The scores of one recording, and remarks on it."""

    scores: tuple[Score, ...]
    notes: tuple[str, ...]

    @property
    def statuses(self) -> Counter[str]:
        """How many frames ended in which way; every reference scores the same frames."""
        statuses: Counter[str] = Counter()
        for score in self.scores:
            if score.reference is self.scores[0].reference:
                statuses.update({"ok": score.frame_count - score.rejected_count, **score.rejected})
        return statuses


@dataclass(frozen=True)
class Validation:
    """Scores per recording and reference, overall and by groups of recordings, and remarks.

    `alarm_rules` are what alarms were scored by, None where they were not asked for. `groups` are the scores of
    recordings that were grouped by their metadata.
    """

    scores: tuple[Score, ...]
    overall: tuple[Score, ...]
    notes: tuple[str, ...]
    alarm_rules: AlarmRules | None = None
    groups: tuple[Score, ...] = ()

    @property
    def primary(self) -> Score | None:
        """The overall score against the strongest reference there is, in the order of `Reference`.

        Of several instruments it is that of the first one.
        """
        by_reference = {score.reference: score for score in reversed(self.overall)}
        return next((by_reference[reference] for reference in Reference if reference in by_reference), None)

    @property
    def reference(self) -> Reference:
        """The reference that plots and reports show: the strongest one."""
        return (self.primary or self.scores[0]).reference


def validate(
    recordings: Sequence[Recording],
    request: Request,
    jobs: int | None = None,
    on_progress: Progress | None = None,
    keep: Keep | None = None,
) -> Validation:
    """Score recordings against each reference that they have, and alarms where the request has rules for them.

    Every instrument of a recording has its own scores. Recordings that the calibration was fitted on are scored and
    marked, and the overall score leaves them out. Raises RecordingError where a recording has no reference at all, or
    no true clearance to score alarms against, and what `require_truth_for_alarms` raises.
    """
    require_truth_for_alarms(request)
    steps = Steps(on_progress, image_total(recordings, lambda one: step_count(one, request)))
    return combine([score_recording(one, request, jobs, steps, keep) for one in recordings], request)


def require_truth_for_alarms(request: Request) -> None:
    """Raise UsageError where alarms are asked for that cannot be scored."""
    if request.alarms is not None:
        require_clearance(request.setup.method, request.setup.profile)
        if Reference.GROUND_TRUTH not in request.rules.wanted:
            raise UsageError(
                f"alarms are scored against {Reference.GROUND_TRUTH}, the only reference with a clearance; the"
                f" references asked for are {', '.join(request.rules.wanted)}"
            )


def step_count(recording: Recording, request: Request) -> int:
    """Steps per image: a row of each instrument, and one more where the lag is estimated first."""
    finds_lag = request.lag == "auto" and request.setup.method not in PLANAR_METHODS
    return len(request.instruments or recording.instruments) + finds_lag


def combine(parts: Sequence[Scored], request: Request, groups: Sequence[str] = ()) -> Validation:
    """The scores of recordings, and those of all together; where `groups` names a group of each, of these too."""
    scores = [score for part in parts for score in part.scores]
    if not scores:
        raise RecordingError("no recording could be scored")
    of_groups = []
    for group in sorted(set(groups)):
        members = [s for part, name in zip(parts, groups, strict=True) if name == group for s in part.scores]
        of_groups += [
            replace(pooled, recording=pooled.recording.replace("overall", group, 1))
            for pooled in _pooled(members, request)
        ]
    notes = tuple(dict.fromkeys(note for part in parts for note in part.notes))
    return Validation(tuple(scores), tuple(_pooled(scores, request)), notes, request.alarms, tuple(of_groups))


def _pooled(scores: Sequence[Score], request: Request) -> list[Score]:
    """By instrument and reference, without the scores of what the calibration was fitted on."""
    profile, found = request.setup.profile, []
    for of in product(profile.instrument_names, request.rules.wanted):
        counted = [one for one in scores if (one.instrument, one.reference) == of and not one.fitted_on]
        if counted:
            found.append(pool_scores(counted, profile.instrument_name))
    return found


def score_recording(
    recording: Recording,
    request: Request,
    jobs: int | None = None,
    steps: Steps | None = None,
    keep: Keep | None = None,
) -> Scored:
    """Score every wanted instrument. Scores are named after the recording, and after any instrument but the first."""
    steps = steps or Steps(None, None)
    setup, rules, lag, wanted = request.setup, request.rules, request.lag, request.instruments
    notes = setup.degeneracies(recording.camera)
    planar = setup.method in PLANAR_METHODS  # it needs no joints, and its own rows show the lag
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
                score = score_rows(rows, view, seen, reference, rules, offset, request.alarms)
            except (RecordingError, KinematicsError) as problem:
                missing.append(f"{label}: no {reference} to compare with: {problem}")
            else:
                scores.append(replace(score, recording=label, instrument=name))
    if not scores or (request.alarms and scores[0].alarms is None):
        raise RecordingError("; ".join(missing))
    if keep is not None:
        keep(Measured(recording, read, tuple(every), scores[0].lag))
    notes += missing
    if setup.equations == "printed" and Reference.KINEMATICS in {score.reference for score in scores}:
        notes.append(KINEMATICS_PRINTED_NOTE)
    return Scored(tuple(scores), tuple(notes))

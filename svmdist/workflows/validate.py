"""Validate: recordings scored against each reference that they have, and held against a stored baseline."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, Field, ValidationError, model_validator

from svmdist.errors import KinematicsError, RecordingError, UsageError
from svmdist.estimation.alarms import AlarmRules
from svmdist.files import read_regular, why, write_atomically
from svmdist.metrics import row_of
from svmdist.profile.toml import in_words
from svmdist.recording.log import Recording
from svmdist.results import FrameResult
from svmdist.workflows.capabilities import require_clearance
from svmdist.workflows.estimate import Ending, Keep, Measured, given_lag, recording_lag, with_lag
from svmdist.workflows.replay import replay
from svmdist.workflows.request import Request
from svmdist.workflows.scoring.given import Given
from svmdist.workflows.scoring.metric_table import FIRST_KEYS, Tolerance, stored_metrics
from svmdist.workflows.scoring.references import BY_POSES, KINEMATICS_PRINTED_NOTE, Reference, no_truth
from svmdist.workflows.scoring.scores import Readings, Score, pool_scores, score_rows

PAPER_R_SQUARED = 0.78  # the paper's own figure (sec. IV); its scene differs from every scene here


@dataclass(frozen=True)
class Scored:
    """The scores of one recording, remarks on it, how its rows ended; of the remarks, the lack of a truth asked for."""

    scores: tuple[Score, ...]
    notes: tuple[str, ...]
    ending: Ending
    lacking: tuple[str, ...] = ()

    @property
    def statuses(self) -> dict[str, int]:
        """How many frames ended in which way."""
        return self.ending.statuses


@dataclass(frozen=True)
class Validation:
    """Scores per recording and reference, overall and by `groups` of metadata; rules of alarms if asked for."""

    scores: tuple[Score, ...]
    overall: tuple[Score, ...]
    notes: tuple[str, ...]
    alarm_rules: AlarmRules | None = None
    groups: tuple[Score, ...] = ()

    @property
    def primary(self) -> Score | None:
        """The overall score of the first instrument against the strongest reference there is."""
        return min(self.overall, key=lambda score: [*Reference].index(score.reference), default=None)

    @property
    def reference(self) -> Reference:
        """The reference that plots and reports show: the strongest one."""
        return (self.primary or self.scores[0]).reference


def validate(recordings: Sequence[Recording], request: Request, jobs: int | None = None) -> Validation:
    """Score recordings against each reference that they have, and alarms where the request has rules for them.

    Every instrument has its own scores. Raises RecordingError where a recording has no reference, or no true clearance
    to score alarms against, and what `require_truth_for_alarms` raises.
    """
    require_truth_for_alarms(request)
    return combine([score_recording(one, request, jobs) for one in recordings], request)


def require_truth_for_alarms(request: Request) -> None:
    """Raise UsageError where alarms are asked for that cannot be scored."""
    if request.alarms is not None:
        require_clearance(request.setup)
        if Reference.GROUND_TRUTH not in (asked := request.rules.wanted):
            only = f"{Reference.GROUND_TRUTH}, the only reference with a clearance"
            raise UsageError(f"alarms are scored against {only}; the references asked for are {', '.join(asked)}")


def combine(parts: Sequence[Scored], request: Request, groups: Sequence[str] = ()) -> Validation:
    """The scores of recordings, and those of all together; where `groups` names a group of each, of these too."""
    scores = [score for part in parts for score in part.scores]
    if not scores:
        raise RecordingError("no recording could be scored")
    of_groups = []
    for group in sorted(set(groups)):
        members = [s for part, name in zip(parts, groups, strict=True) if name == group for s in part.scores]
        of_groups += _pooled(members, request, group)
    notes = tuple(dict.fromkeys(note for part in parts for note in part.notes))
    return Validation(tuple(scores), tuple(_pooled(scores, request)), notes, request.alarms, tuple(of_groups))


def _pooled(scores: Sequence[Score], request: Request, named: str = "overall") -> list[Score]:
    """By instrument and reference, without the scores of what the calibration was fitted on."""
    found = []
    for key in product(request.setup.profile.instrument_names, Reference):
        label = named if key[0] == request.setup.profile.instrument_name else f"{named} {key[0]}"
        if of := [one for one in scores if (one.instrument, one.reference) == key and not one.fitted_on]:
            found.append(pool_scores(of, label))
    return found


def score_recording(
    recording: Recording, request: Request, jobs: int | None = None, keep: Keep | None = None
) -> Scored:
    """Score every wanted instrument. Scores are named after the recording, and after any instrument but the first."""
    setup, rules, lag = request.setup, request.rules, request.lag
    wanted = rules.of(recording)
    without_truth = "`svmdist compare` sets methods against each other, without a truth"
    if said := no_truth(recording, (Reference.GROUND_TRUTH,) if request.alarms else wanted, rules):
        raise RecordingError(f"{said}; {without_truth}")  # before all images are measured
    notes = setup.degeneracies(recording.camera)
    planar = setup.is_planar  # it needs no joints, and its own rows show the lag
    read, found = (recording, given_lag(lag)) if planar else with_lag(recording, request, jobs)
    every, by = _measured(read, request, [one for one in wanted if one in BY_POSES], jobs)
    asked_for = rules.references or (Reference.TF,) * bool(rules.tool_frames)
    scores, missing, lacking = [], [], []
    for name in dict.fromkeys(row.instrument for row in every):
        view = recording.for_instrument(name)
        rows = [row for row in every if row.instrument == name]
        label = recording.name if name == setup.profile.instrument_name else f"{recording.name} {name}"
        offset = recording_lag(Readings(rows), view, rules) if planar and lag == "auto" else found
        if not offset.is_observable:
            notes.append(f"{label}: the lag cannot be estimated and 0 is used: {offset.reason}")
        for reference in wanted:
            try:
                score = score_rows(rows, view, request, reference, offset, by.get((reference, name)))
            except (RecordingError, KinematicsError) as problem:
                missing.append(f"{label}: no {reference} to compare with: {problem}")
                if reference in asked_for:
                    lacking.append(missing[-1])
            else:
                events = tuple(Ending.of(rows).alarms)
                scores.append(replace(score, recording=label, instrument=name, alarm_events=events))
    if not scores or (request.alarms and scores[0].alarms is None):
        raise RecordingError("; ".join([*missing, without_truth]))
    if keep is not None:
        keep(Measured(recording, read, tuple(every), scores[0].lag, by))
    notes += missing
    if setup.equations == "printed" and Reference.KINEMATICS in {score.reference for score in scores}:
        notes.append(KINEMATICS_PRINTED_NOTE)
    return Scored(tuple(scores), tuple(notes), Ending.of(every, read.remarks), tuple(lacking))


def _measured(
    read: Recording, request: Request, references: Sequence[Reference], jobs: int | None
) -> tuple[list[FrameResult], dict[tuple[Reference, str], Readings]]:
    """The rows of a recording, and in the same pass what references give, by instrument, whose tissue images show."""
    given = [Given(str(one), rules=request.rules, on_surface=one is Reference.SURFACE) for one in references]
    setups = [request.setup, *(replace(request.setup, method=one.name, own=one) for one in given)]
    every: list[FrameResult] = []
    by = defaultdict[tuple[Reference, str], Readings](Readings)
    for first, *rest in replay(read, setups, jobs=jobs, alarms=request.alarms):
        every += first.results
        for reference, replayed in zip(references, rest, strict=True):
            for row in replayed.results:
                by[reference, row.instrument].add(row)
    return every, by


SCHEMA: Literal["svmdist.baseline/1"] = "svmdist.baseline/1"
MAX_FILE_BYTES = 64 << 20


class StoredScore(BaseModel, extra="allow", frozen=True):
    """The figures of one recording, method and reference, as extra fields: `stored_metrics()`, None where undefined."""

    __pydantic_extra__: dict[str, float | None] = Field(init=False)
    recording: str
    method: str
    equations: str
    reference: str

    @model_validator(mode="after")
    def _check_metrics(self) -> Self:
        if missing := set(FIRST_KEYS) - set(self.figures):
            raise ValueError(f"{self.recording}: there is no {', '.join(sorted(missing))}")
        if unknown := set(self.figures) - set(stored_metrics()):
            raise ValueError(f"{self.recording}: there is no metric {', '.join(sorted(unknown))}")
        return self

    @property
    def figures(self) -> Mapping[str, float | None]:
        """The figures by the keys of their metrics."""
        return self.__pydantic_extra__

    @property
    def key(self) -> tuple[str, str, str, str]:
        """Recording, method, equations and reference of the figures."""
        return self.recording, self.method, self.equations, self.reference


class StoredAlarmRules(BaseModel, extra="forbid", frozen=True):
    """The rules of the stored alarms."""

    below_m: float
    confidence: float


class Baseline(BaseModel, extra="forbid", frozen=True):
    """A whole baseline file; `alarms` is None where none were asked for."""

    schema_: Literal["svmdist.baseline/1"] = Field(alias="schema")
    tolerances: dict[str, Tolerance]
    scores: tuple[StoredScore, ...]
    alarms: StoredAlarmRules | None = None


def make_baseline(validation: Validation) -> Baseline:
    """Take the figures of a validation, per recording and overall."""
    metrics, rules, scores = stored_metrics(), validation.alarm_rules, []
    for score in (*validation.scores, *validation.overall):
        labels = {key: str(getattr(score, key)) for key in ("recording", "method", "equations", "reference")}
        scores.append(StoredScore.model_validate(labels | row_of(metrics.values(), score)))
    return Baseline(
        schema=SCHEMA,
        tolerances={key: metric.tolerance for key, metric in metrics.items() if metric.tolerance},
        scores=tuple(scores),
        alarms=StoredAlarmRules(below_m=rules.below_m, confidence=rules.probability) if rules else None,
    )


def require_same_alarms(baseline: Baseline, asked: AlarmRules | None) -> None:
    """Raise UsageError for stored alarms that were raised by other rules."""
    stored = baseline.alarms
    if stored and not (asked and (asked.below_m, asked.probability) == (stored.below_m, stored.confidence)):
        rules = f"--alarm-below {stored.below_m * 1e3:g}mm --alarm-when {stored.confidence:g}"
        raise UsageError(f"the baseline's alarms are those of {rules}: ask for the same")


def find_regressions(validation: Validation, baseline: Baseline, *, complete: bool) -> list[str]:
    """What got worse than its tolerance, a line for each figure, of the same method and equations.

    With `complete`, all of them must be there; without, those of other recordings (and the overall ones) are skipped.
    Raises RecordingError where nothing can be compared.
    """
    found = {score.key: score for score in make_baseline(validation).scores}
    setups = {(score.method, score.equations) for score in found.values()}
    asked = {score.recording for score in validation.scores}
    known = [stored for stored in baseline.scores if (stored.method, stored.equations) in setups]
    compared = [stored for stored in known if complete or stored.recording in asked]
    if not compared:
        raise RecordingError("the baseline holds no figure of these recordings, method and equations")
    regressions = []
    for stored in compared:
        now = found[stored.key].figures if stored.key in found else {}
        for key, metric in stored_metrics().items():
            if (before := stored.figures.get(key)) is None:
                continue
            loss, after = math.inf, now.get(key)
            if after is not None:
                loss = before - after if metric.higher_is_better else after - before
            if not baseline.tolerances.get(key, Tolerance()).allows(loss, before):
                where = f"{stored.recording} against {stored.reference}"
                found_now = "nothing" if after is None else f"{after:.6g}"
                regressions.append(f"{where}: {key} was {before:.6g}, is {found_now}")
    return regressions


def load_baseline(path: Path) -> Baseline:
    """Read a baseline file; raises RecordingError that says what is wrong with it."""
    try:
        return Baseline.model_validate_json(read_regular(path, MAX_FILE_BYTES).decode("utf-8"))
    except OSError as problem:
        made = "; `validate --write-baseline` makes one" if isinstance(problem, FileNotFoundError) else ""
        raise RecordingError(f"{path}: cannot read the baseline: {why(problem)}{made}") from None
    except (ValidationError, UnicodeDecodeError, RecursionError) as problem:
        said = in_words(problem) if isinstance(problem, ValidationError) else str(problem)
        raise RecordingError(f"{path}: not a baseline of schema {SCHEMA}: {said}") from None


def save_baseline(baseline: Baseline, path: Path) -> None:
    """Write a baseline file; raises OutputError where that fails."""
    write_atomically(path, [json.dumps(baseline.model_dump(mode="json", by_alias=True), indent=1), "\n"])

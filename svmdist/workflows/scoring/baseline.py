"""Baseline: figures stored today, so that a later run can tell which of them got worse."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from svmdist.errors import RecordingError, UsageError
from svmdist.estimation.alarms import AlarmRules
from svmdist.files import read_regular, why, write_atomically
from svmdist.workflows.scoring.metric_table import FIRST_KEYS, Better, Tolerance, cells, stored_metrics
from svmdist.workflows.scoring.score import Score
from svmdist.workflows.validate import Validation

SCHEMA: Literal["svmdist.baseline/1"] = "svmdist.baseline/1"

MAX_FILE_BYTES = 64 << 20


class _Stored(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class StoredScore(_Stored, extra="allow"):
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


class StoredAlarmRules(_Stored):
    """The rules of the stored alarms."""

    below_m: float
    confidence: float


class Baseline(_Stored):
    """A whole baseline file; `alarms` is None where none were asked for."""

    schema_: Literal["svmdist.baseline/1"] = Field(alias="schema")
    tolerances: dict[str, Tolerance]
    scores: tuple[StoredScore, ...]
    alarms: StoredAlarmRules | None = None


@dataclass(frozen=True, slots=True)
class Regression:
    """One figure that got worse than its tolerance; `found` is None where the figure is gone."""

    recording: str
    reference: str
    metric: str
    stored: float
    found: float | None

    def __str__(self) -> str:
        found = "nothing" if self.found is None else f"{self.found:.6g}"
        return f"{self.recording} against {self.reference}: {self.metric} was {self.stored:.6g}, is {found}"


def make_baseline(validation: Validation) -> Baseline:
    """Take the figures of a validation, per recording and overall."""
    return Baseline(
        schema=SCHEMA,
        tolerances={key: metric.tolerance for key, metric in stored_metrics().items() if metric.tolerance},
        scores=tuple(_stored(score) for score in (*validation.scores, *validation.overall)),
        alarms=_stored_rules(validation.alarm_rules),
    )


def require_same_alarms(baseline: Baseline, asked: AlarmRules | None) -> None:
    """Raise UsageError for stored alarms that were raised by other rules."""
    stored = baseline.alarms
    if stored is not None and stored != _stored_rules(asked):
        raise UsageError(
            f"the baseline's alarms are those of --alarm-below {stored.below_m * 1e3:g}mm --alarm-confidence"
            f" {stored.confidence:g}: ask for the same"
        )


def find_regressions(validation: Validation, baseline: Baseline, *, complete: bool) -> list[Regression]:
    """Compare a validation with the stored figures of the same method and equations.

    With `complete`, all of them must be there; without, those of other recordings (and the overall ones) are skipped.
    Raises RecordingError where nothing can be compared.
    """
    found = {score.key: score for score in map(_stored, (*validation.scores, *validation.overall))}
    setups = {(score.method, score.equations) for score in found.values()}
    asked = {score.recording for score in validation.scores}
    compared = [
        stored
        for stored in baseline.scores
        if (stored.method, stored.equations) in setups and (complete or stored.recording in asked)
    ]
    if not compared:
        raise RecordingError(
            "the baseline holds no figure of these recordings, this method and these equations"
        )
    return [
        worse for stored in compared for worse in _worse(stored, found.get(stored.key), baseline.tolerances)
    ]


def load_baseline(path: Path) -> Baseline:
    """Read a baseline file; raises RecordingError that says what is wrong with it."""
    try:
        return Baseline.model_validate_json(read_regular(path, MAX_FILE_BYTES).decode("utf-8"))
    except OSError as problem:
        raise RecordingError(f"{path}: cannot read the baseline: {why(problem)}") from None
    except (ValidationError, UnicodeDecodeError, RecursionError) as problem:
        first = str(problem).splitlines()[0]
        raise RecordingError(f"{path}: not a baseline of schema {SCHEMA}: {first}") from None


def save_baseline(baseline: Baseline, path: Path) -> None:
    """Write a baseline file; raises OutputError where that fails."""
    write_atomically(path, [json.dumps(baseline.model_dump(mode="json", by_alias=True), indent=1), "\n"])


def _stored_rules(rules: AlarmRules | None) -> StoredAlarmRules | None:
    return StoredAlarmRules(below_m=rules.below_m, confidence=rules.confidence) if rules else None


def _stored(score: Score) -> StoredScore:
    labels = {"recording": score.recording, "method": score.method, "equations": score.equations}
    return StoredScore.model_validate(
        labels | {"reference": str(score.reference)} | cells(stored_metrics().values(), score)
    )


def _worse(
    stored: StoredScore, found: StoredScore | None, tolerances: Mapping[str, Tolerance]
) -> Iterator[Regression]:
    for key, metric in stored_metrics().items():
        before, now = stored.figures.get(key), found.figures.get(key) if found else None
        if before is None:
            continue
        loss = math.inf if now is None else before - now if metric.better is Better.HIGHER else now - before
        if not tolerances.get(key, Tolerance()).allows(loss, before):
            yield Regression(stored.recording, stored.reference, key, before, now)

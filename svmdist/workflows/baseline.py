"""Baseline: figures stored today, so that a later run can tell which of them got worse."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from svmdist.errors import RecordingError, UsageError
from svmdist.estimation.alarms import AlarmRules
from svmdist.output_file import write_whole
from svmdist.workflows.scoring.score import Score
from svmdist.workflows.validate import Validation

SCHEMA: Literal["svmdist.baseline/1"] = "svmdist.baseline/1"


class Tolerance(BaseModel):
    """How much worse a figure may get: the larger of an absolute and a relative allowance."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    absolute: float = Field(default=0.0, ge=0.0)
    relative: float = Field(default=0.0, ge=0.0)

    def allows(self, loss: float, stored: float) -> bool:
        """Whether a loss, positive when worse, is within the tolerance of the stored figure."""
        return loss <= max(self.absolute, self.relative * abs(stored))


DEFAULT_TOLERANCES = {
    "r_squared": Tolerance(absolute=0.002),
    "rmse_m": Tolerance(absolute=2e-5, relative=0.02),
    "p95_abs_error_m": Tolerance(absolute=5e-5, relative=0.05),
    "coverage": Tolerance(absolute=0.0),
    "spatial_rmse_m": Tolerance(absolute=2e-5, relative=0.02),
    "clearance_rmse_m": Tolerance(absolute=2e-5, relative=0.02),
    "alarm_recall": Tolerance(absolute=0.005),
    "false_alarm_fraction": Tolerance(absolute=0.005),
}
"""Room for another build of OpenCV, which moves a homography's corners by up to 1e-3 px and may flip a
match; not for another result. A frame that is no longer measured has no such excuse."""

HIGHER_IS_BETTER = {
    "r_squared": True,
    "coverage": True,
    "rmse_m": False,
    "p95_abs_error_m": False,
    "spatial_rmse_m": False,
    "clearance_rmse_m": False,
    "alarm_recall": True,
    "false_alarm_fraction": False,
}
"""Of alarms both stand here: alarming always has a recall of 1."""


class StoredScore(BaseModel):
    """The figures of one recording, method and reference; None where a figure was undefined.

    Those with a default are in no baseline that was written before there were such figures.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    recording: str
    method: str
    equations: str
    reference: str
    r_squared: float | None
    rmse_m: float | None
    p95_abs_error_m: float | None
    coverage: float
    spatial_rmse_m: float | None = None
    clearance_rmse_m: float | None = None
    alarm_recall: float | None = None
    false_alarm_fraction: float | None = None

    @property
    def key(self) -> tuple[str, str, str, str]:
        """What the figures are of."""
        return self.recording, self.method, self.equations, self.reference


class StoredAlarmRules(BaseModel):
    """What the stored alarms were raised by."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    below_m: float
    confidence: float


class Baseline(BaseModel):
    """A whole baseline file; `alarms` is None where none were asked for."""

    model_config = ConfigDict(extra="forbid", frozen=True)
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
    scores = tuple(_stored(score) for score in (*validation.scores, *validation.overall))
    return Baseline(
        schema=SCHEMA,
        tolerances=DEFAULT_TOLERANCES,
        scores=scores,
        alarms=_stored_rules(validation.alarm_rules),
    )


def require_same_alarms(baseline: Baseline, asked: AlarmRules | None) -> None:
    """Refuse to compare alarms that were raised by other rules; raises UsageError that names the stored ones.

    Alarms that are asked for and not stored are scored and compared with nothing.
    """
    stored = baseline.alarms
    if stored is not None and stored != _stored_rules(asked):
        raise UsageError(
            f"the baseline's alarms are those of --alarm-below {stored.below_m * 1e3:g}mm --alarm-confidence"
            f" {stored.confidence:g}: ask for the same"
        )


def find_regressions(validation: Validation, baseline: Baseline, *, complete: bool) -> list[Regression]:
    """Compare a validation with stored figures.

    With `complete`, every stored score of the same method and equations must be there; without, scores of
    recordings that were not asked for (and the overall ones) are passed over. Raises RecordingError where
    nothing can be compared, since a check that checks nothing must not pass.
    """
    found = {_stored(score).key: _stored(score) for score in (*validation.scores, *validation.overall)}
    setups = {(score.method, score.equations) for score in found.values()}
    asked = {score.recording for score in validation.scores}
    regressions: list[Regression] = []
    compared = 0
    for stored in baseline.scores:
        if (stored.method, stored.equations) not in setups or not (complete or stored.recording in asked):
            continue
        compared += 1
        regressions += _worse(stored, found.get(stored.key), baseline.tolerances)
    if compared == 0:
        raise RecordingError(
            "the baseline holds no figure of these recordings, this method and these equations"
        )
    return regressions


def load_baseline(path: Path) -> Baseline:
    """Read a baseline file; raises RecordingError that says what is wrong with it."""
    try:
        return Baseline.model_validate_json(path.read_text("utf-8"))
    except OSError as problem:
        raise RecordingError(f"{path}: cannot read the baseline: {problem.strerror or problem}") from None
    except (ValidationError, UnicodeDecodeError, json.JSONDecodeError) as problem:
        first = str(problem).splitlines()[0]
        raise RecordingError(f"{path}: not a baseline of schema {SCHEMA}: {first}") from None


def save_baseline(baseline: Baseline, path: Path) -> None:
    """Write a baseline file; raises OutputError where that fails."""
    write_whole(path, [json.dumps(baseline.model_dump(mode="json", by_alias=True), indent=1), "\n"])


def _stored_rules(rules: AlarmRules | None) -> StoredAlarmRules | None:
    return StoredAlarmRules(below_m=rules.below_m, confidence=rules.confidence) if rules else None


def _stored(score: Score) -> StoredScore:
    statistics, alarms = score.statistics, score.alarms
    return StoredScore(
        recording=score.recording,
        method=score.method,
        equations=score.equations,
        reference=str(score.reference),
        r_squared=statistics.r_squared if statistics else None,
        rmse_m=statistics.rmse if statistics else None,
        p95_abs_error_m=statistics.p95_abs_error if statistics else None,
        coverage=score.coverage,
        spatial_rmse_m=score.spatial.statistics.rmse if score.spatial else None,
        clearance_rmse_m=score.clearance.statistics.rmse if score.clearance else None,
        alarm_recall=alarms.recall if alarms else None,
        false_alarm_fraction=alarms.false_alarm_fraction if alarms else None,
    )


def _worse(
    stored: StoredScore, found: StoredScore | None, tolerances: dict[str, Tolerance]
) -> Iterable[Regression]:
    for metric, higher_is_better in HIGHER_IS_BETTER.items():
        before: float | None = getattr(stored, metric)
        if before is None:
            continue
        now: float | None = getattr(found, metric) if found else None
        if now is None:
            yield Regression(stored.recording, stored.reference, metric, before, None)
            continue
        loss = before - now if higher_is_better else now - before
        if not tolerances.get(metric, Tolerance()).allows(loss, before):
            yield Regression(stored.recording, stored.reference, metric, before, now)

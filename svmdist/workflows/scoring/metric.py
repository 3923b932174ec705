"""What a metric is: its key, unit, direction, tolerance and meaning, how it is computed, and where it stands."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Flag, StrEnum, auto
from functools import partial
from operator import attrgetter
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from svmdist.workflows.scoring.distances import DistanceScore

Value = str | int | float | None
Scored_contra = TypeVar("Scored_contra", contravariant=True)
Whole = TypeVar("Whole")
Part = TypeVar("Part")


class Better(StrEnum):
    """Which way a metric gets better."""

    HIGHER = "higher"
    LOWER = "lower"


class Output(Flag):
    """Where a metric stands."""

    SCORES = auto()
    """A column of CSV and JSON of `validate`."""
    SCORE_TABLE = auto()
    """A column of the first table of `validate`."""
    DISTANCE_TABLE = auto()
    """A column of its table of the three distances."""
    ALARM_TABLE = auto()
    """A column of its table of alarms."""
    FIGURES = auto()
    """A column of CSV and JSON of `compare` and `blur-bench --grid`."""
    FIGURE_TABLE = auto()
    """A column of their tables."""


NOWHERE = Output(0)


@dataclass(frozen=True, slots=True)
class Unit:
    """The unit of a value, the one a person is shown, and how: the value times `factor` with so many digits.

    Without digits the value is shown as it is: a count or a text.
    """

    name: str = ""
    shown: str = ""
    factor: float = 1.0
    digits: int | None = None


class Tolerance(BaseModel):
    """How much worse a figure may get: the larger of an absolute and a relative allowance."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    absolute: float = Field(default=0.0, ge=0.0)
    relative: float = Field(default=0.0, ge=0.0)

    def allows(self, loss: float, stored: float) -> bool:
        """Whether a loss, positive when worse, is within the tolerance of the stored figure."""
        return loss <= max(self.absolute, self.relative * abs(stored))


@dataclass(frozen=True, slots=True)
class Metric(Generic[Scored_contra]):
    """One metric of a score, or of a part of it; `key` is its name in CSV, JSON and baselines.

    A baseline stores it where it has a `tolerance`, which needs `better`. Of a metric of the three distances,
    `outputs` and `tolerance` are those of the planar distance, and those `in_3d` are of the other two, whose keys
    begin with `spatial_` and `clearance_`. `title` and `narrow_title` head its columns. `group` is the distance that
    it is of; `is_late` moves its columns behind all others, where new columns belong.
    """

    key: str
    unit: Unit
    of: Callable[[Scored_contra], Value]
    meaning: str
    better: Better | None = None
    title: str = ""
    outputs: Output = Output.SCORES
    tolerance: Tolerance | None = None
    outputs_in_3d: Output = NOWHERE
    tolerance_in_3d: Tolerance | None = None
    narrow_title: str = ""
    source: str = ""
    group: str = ""
    is_late: bool = False


def of_part(metrics: Iterable[Metric[Part]], part_of: Callable[[Whole], Part | None]) -> list[Metric[Whole]]:
    """Metrics of a part as metrics of the whole: None where it does not have the part."""

    def of(metric: Metric[Part], whole: Whole) -> Value:
        part = part_of(whole)
        return None if part is None else metric.of(part)

    lifted: list[Metric[Any]] = [replace(metric, of=partial(of, metric)) for metric in metrics]
    return lifted


def of_distance(metrics: Iterable[Metric[DistanceScore]], distance: str) -> list[Metric[Any]]:
    """Metrics of a distance as metrics of scores and figures, whose field of that name holds the distance's score."""
    if distance == "planar":
        named = [replace(metric, group=distance) for metric in metrics]
    else:
        named = [
            replace(
                metric,
                key=f"{distance}_{metric.key}",
                outputs=metric.outputs_in_3d,
                tolerance=metric.tolerance_in_3d,
                group=distance,
            )
            for metric in metrics
        ]
    return of_part(named, attrgetter(distance))


def within(metrics: Iterable[Metric[Whole]], output: Output) -> list[Metric[Whole]]:
    """The metrics that stand in an output."""
    return [metric for metric in metrics if output & metric.outputs]


def row_keys(
    before: Sequence[str], metrics: Sequence[Metric[Whole]], after: Sequence[str] = ()
) -> tuple[str, ...]:
    """The columns of a row: labels, metrics, labels, and metrics that came later."""
    early = [metric.key for metric in metrics if not metric.is_late]
    late = [metric.key for metric in metrics if metric.is_late]
    return (*before, *early, *after, *late)


def cells(metrics: Iterable[Metric[Whole]], of: Whole) -> dict[str, Value]:
    """The values of metrics by their keys."""
    return {metric.key: metric.of(of) for metric in metrics}

"""Degradation grid: one method on the same frames under every degradation and severity, and as recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from svmdist.errors import RecordingError
from svmdist.estimation.scene import Clock
from svmdist.recording.log import Recording
from svmdist.vision.degradations import SEVERITIES, Degradation, require_degradation
from svmdist.workflows.compare import Figures, RunNumbers, measure_runs, pooled_figures
from svmdist.workflows.conditions import CLEAN, Condition
from svmdist.workflows.parallel import Progress
from svmdist.workflows.request import Setup


@dataclass(frozen=True)
class GridCell:
    """One method under one condition, over all recordings."""

    method: str
    condition: Condition
    figures: Figures


def grid_conditions(
    names: Sequence[Degradation | str] = tuple(Degradation), severities: Sequence[int] = SEVERITIES
) -> list[Condition]:
    """The images as recorded, then every degradation at every severity.

    Raises UsageError for a wrong name or severity.
    """
    chosen = [
        Condition(require_degradation(name, severity), severity) for name in names for severity in severities
    ]
    return [CLEAN, *dict.fromkeys(chosen)]


def degradation_grid(
    recordings: Sequence[Recording],
    setup: Setup,
    conditions: Sequence[Condition],
    *,
    jobs: int | None = None,
    clock: Clock | None = None,
    on_progress: Progress | None = None,
) -> list[GridCell]:
    """Measure every frame of the recordings under every condition; each image is decoded once.

    Raises RecordingError where a recording has no ground-truth distances, and where there is no image.
    """
    return grid_cells(
        grid_runs(recordings, setup, conditions, jobs=jobs, clock=clock, on_progress=on_progress),
        setup,
        conditions,
    )


@dataclass(frozen=True)
class GridRun:
    """The numbers of one recording under one condition, by its place among all conditions."""

    condition: int
    numbers: RunNumbers


def grid_runs(
    recordings: Sequence[Recording],
    setup: Setup,
    conditions: Sequence[Condition],
    *,
    jobs: int | None = None,
    clock: Clock | None = None,
    on_progress: Progress | None = None,
) -> list[GridRun]:
    """Measure every frame under every condition. Raises RecordingError as `degradation_grid` does."""
    places = {condition: place for place, condition in enumerate(conditions)}
    runs = measure_runs(recordings, [setup], conditions, jobs=jobs, clock=clock, on_progress=on_progress)
    return [
        GridRun(places[run.condition], RunNumbers.of(run))
        for run in runs
        if isinstance(run.condition, Condition)
    ]


def grid_cells(runs: Sequence[GridRun], setup: Setup, conditions: Sequence[Condition]) -> list[GridCell]:
    """The figures of each condition over all recordings; RecordingError where there is no image."""
    if not any(run.numbers.frame_count for run in runs):
        raise RecordingError("there is no image to measure in these recordings")
    return [
        GridCell(
            setup.method, condition, pooled_figures([run.numbers for run in runs if run.condition == place])
        )
        for place, condition in enumerate(conditions)
    ]

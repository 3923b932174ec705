"""Compare: all methods on the same recordings; those that one process measures share a pass over the images."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from svmdist.errors import RecordingError
from svmdist.estimation.scene import Clock
from svmdist.recording.log import Recording
from svmdist.workflows.conditions import CLEAN, LogCondition
from svmdist.workflows.parallel import Progress
from svmdist.workflows.runs import Figures, RunNumbers, measure_runs, pooled_figures
from svmdist.workflows.setup import Setup

GroupBy = Callable[[Mapping[str, str]], str]
"""Names the group of a recording by its metadata."""

ALL = "all"
UNDEGRADED = "clean"


@dataclass(frozen=True, slots=True)
class Group:
    """Frames that are compared together: those of a scenario, and how they were degraded (`smoke=3`, or empty).

    A perturbed world (`focal=1`, or `world=real`) counts as a degradation.

    A scenario of `all` is all of them; so is a degradation of `all`. Instruments are never compared together:
    `other_instrument` names one that is not the first of its recording.
    """

    scenario: str
    degradation: str = ""
    other_instrument: str = ""

    def __str__(self) -> str:
        degradation = "" if self.degradation == ALL else self.degradation
        return " ".join(filter(None, (self.scenario, degradation, self.other_instrument)))


@dataclass(frozen=True)
class MethodScore:
    """One method on one group of frames, and the instrument that it measured."""

    group: Group
    method: str
    figures: Figures
    instrument: str = ""


@dataclass(frozen=True)
class GroupedRun:
    """The numbers of one method on one instrument of one recording, and what they are compared as."""

    group: Group
    method: str
    instrument: str
    numbers: RunNumbers


def group_of(
    recording: Recording,
    condition: LogCondition = CLEAN,
    instrument: str = "",
    by: GroupBy | None = None,
) -> Group:
    """What a recording is compared as: its scenario, or its name where it names none, and its degradations.

    Those are what it was recorded with, `degrade` and `perturb` of its metadata, and then what is done to it now. Of a
    real world, in which everything is perturbed, only that is told. `by` groups by other metadata instead.
    """
    metadata = recording.metadata
    other = instrument if instrument in recording.instruments[1:] else ""
    if by is not None:
        return Group(by(metadata), str(condition), other)
    world = f"world={metadata['world']}" if "world" in metadata else metadata.get("perturb", "")
    degradations = (metadata.get("degrade", ""), world, str(condition))
    return Group(
        recording.metadata.get("scenario", recording.name), ",".join(filter(None, degradations)), other
    )


def compare(
    recordings: Sequence[Recording],
    setups: Sequence[Setup],
    conditions: Sequence[LogCondition] = (CLEAN,),
    *,
    jobs: int | None = None,
    clock: Clock | None = None,
    on_progress: Progress | None = None,
    by: GroupBy | None = None,
) -> list[MethodScore]:
    """Run every setup on every recording under every condition; each process decodes an image once.

    Scores stand per scenario and degradation; then, where there are several of both, per degradation over all
    scenarios; then over all. Raises RecordingError where a recording has no ground-truth distances, and
    where there is no image.
    """
    return compared(
        grouped_runs(recordings, setups, conditions, jobs=jobs, clock=clock, on_progress=on_progress, by=by),
        setups,
    )


def grouped_runs(
    recordings: Sequence[Recording],
    setups: Sequence[Setup],
    conditions: Sequence[LogCondition] = (CLEAN,),
    *,
    jobs: int | None = None,
    clock: Clock | None = None,
    on_progress: Progress | None = None,
    by: GroupBy | None = None,
) -> list[GroupedRun]:
    """Run every setup on every recording under every condition. Raises RecordingError as `compare` does."""
    runs = measure_runs(recordings, setups, conditions, jobs=jobs, clock=clock, on_progress=on_progress)
    return [
        GroupedRun(
            group_of(run.recording, run.condition, run.instrument, by),
            run.method,
            run.instrument,
            RunNumbers.of(run),
        )
        for run in runs
    ]


def compared(runs: Sequence[GroupedRun], setups: Sequence[Setup]) -> list[MethodScore]:
    """The scores of runs, by group and over groups; RecordingError where there is no image."""
    if not any(run.numbers.frame_count for run in runs):
        raise RecordingError("there is no image to measure in these recordings")
    groups = [(run.group, run) for run in runs]
    scores = [score for group in _unique(groups) for score in _scores(group, groups, setups)]
    degradations = list(dict.fromkeys(group.degradation for group, _ in groups))
    if len(degradations) > 1 and len({group.scenario for group, _ in groups}) > 1:
        over_scenarios = [
            (Group(ALL, group.degradation or UNDEGRADED, group.other_instrument), run)
            for group, run in groups
        ]
        scores += [s for group in _unique(over_scenarios) for s in _scores(group, over_scenarios, setups)]
    if len({(group.scenario, group.degradation) for group, _ in groups}) > 1:
        together = [(Group(ALL, ALL, group.other_instrument), run) for group, run in groups]
        scores += [score for group in _unique(together) for score in _scores(group, together, setups)]
    return scores


def _unique(groups: Iterable[tuple[Group, GroupedRun]]) -> list[Group]:
    return list(dict.fromkeys(group for group, _ in groups))


def _scores(
    group: Group, runs: Sequence[tuple[Group, GroupedRun]], setups: Sequence[Setup]
) -> list[MethodScore]:
    """The scores of one group, in the order of the setups."""
    methods = dict.fromkeys(setup.method for setup in setups)
    members = [run for of, run in runs if of == group]
    return [
        MethodScore(
            group,
            method,
            pooled_figures([run.numbers for run in members if run.method == method]),
            members[0].instrument,
        )
        for method in methods
    ]

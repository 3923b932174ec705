"""Compare: the figures of every method on every log under every condition, against the truth and each other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from svmdist.recording.log import Recording
from svmdist.recording.source import Health
from svmdist.recording.topics import Role
from svmdist.workflows import parallel
from svmdist.workflows.capabilities import served_setups
from svmdist.workflows.replay import replay
from svmdist.workflows.request import CLEAN, Condition, Setup
from svmdist.workflows.scoring.given import require_distinct
from svmdist.workflows.scoring.references import ANY_TRUTH, Reference, Truth, reference_lag_ns, truth_at
from svmdist.workflows.scoring.scores import Figures, Readings, figures_of, pooled_figures

GroupBy = Callable[[Mapping[str, str]], str]  # names the group of a recording by its metadata

ALL = "all"
CHUNKS_PER_PROCESS = 2
"""Conditions are dealt out in so many parts a process: each part decodes the images once more, few parts wait."""

WITH_FUSED = ("fused", "fiducial")
"""Where methods are shared by two processes: `fused` takes as long as most others together, and finds tags already.
`shaft` and `stereo` share the pose by the shaft's edges, which is what they spend most on."""


@dataclass(frozen=True, slots=True)
class Group:
    """Frames that are compared together: those of a scenario and degradation (`smoke=3`, `focal=1`, `world=real`).

    A scenario or degradation of `all` is all of them. `other_instrument` names one that is not its recording's first.
    """

    scenario: str
    degradation: str = ""
    other_instrument: str = ""

    def __str__(self) -> str:
        degradation = "" if self.degradation == ALL else self.degradation
        return " ".join(filter(None, (self.scenario, degradation, self.other_instrument)))


@dataclass(frozen=True)
class MethodScore:
    """One method on one group of frames, and the instrument that it measured; `against` is another one, or the truth.

    Two methods differ by their joint standard deviation, and their frames are those that both measured.
    """

    group: Group
    method: str
    figures: Figures
    instrument: str = ""
    against: str = ""


def compare(
    recordings: Sequence[Recording],
    setups: Sequence[Setup],
    conditions: Sequence[Condition] = (CLEAN,),
    *,
    jobs: int | None = None,
) -> list[MethodScore]:
    """Run every setup on every recording under every condition; raises what `measure_runs` does."""
    require_distinct([setup.method for setup in setups])
    return compared([run for one in recordings for run in measure_runs(one, setups, conditions, jobs=jobs)])


def measure_runs(
    recording: Recording,
    setups: Sequence[Setup],
    conditions: Sequence[Condition] = (CLEAN,),
    *,
    jobs: int | None = None,
    by: GroupBy | None = None,
) -> list[MethodScore]:
    """A score for every condition, setup and instrument of a recording, in that order.

    Then the differences of two methods: of all where the log has no ground truth, else of those of others from ours.
    Processes share conditions or methods; `jobs` threads work ahead where nothing can be shared. `by` groups by other
    metadata than the scenario. A method that the log cannot serve is left out, with a remark; another instrument than
    the first where it has no truth that the first has. Raises RecordingError where the recording has no ground-truth
    distances, and nothing to compare.
    """
    jobs = parallel.usable_cores() if jobs is None else jobs
    first = recording.instruments[0]
    views = {name: recording.for_instrument(name) for name in recording.instruments}
    known = [name for name, view in views.items() if view.topic_of(Role.GROUND_TRUTH_DISTANCE) is not None]
    if first not in known and len(setups) == 1:
        views[first].distance_track()  # raises
    names = tuple(name for name in views if name in known or first not in known)
    setups = [setup.for_log(recording) for setup in served_setups(recording, setups)]
    parts = _parts(setups, len(conditions), jobs)
    if jobs == 1 or parallel.is_worker():
        parts = [(range(len(conditions)), range(len(setups)))]
    work = _Work(replace(recording, wanted=names), conditions, setups, max(1, jobs // len(parts)))
    steps, images = count(1), recording.image_count()
    total = images and images * sum(len(work.passes(part)) for part in parts)
    workers, on_step = min(jobs, len(parts)), lambda: recording.on_progress(next(steps), total)
    ended = [made for _, made in parallel.each_in_processes(work.measure, parts, workers, on_step=on_step)]
    # Methods that need both views lose what others lose, and right images: their list has all in file order.
    for _, health in sorted(ended, key=lambda one: -len(one[1].losses)):
        recording.health.join(health)
    found = {place: rows for of_part, _ in ended for place, rows in of_part.items()}
    methods, scores = [setup.method for setup in setups], []
    for (at, of, name), (rows, truth, seconds) in sorted(found.items(), key=lambda one: one[0][:2]):
        group = group_of(recording, conditions[at], name, by)
        scores.append(MethodScore(group, methods[of], replace(figures_of(rows, truth), seconds=seconds), name))
        for place in range(of + 1, len(setups)):
            if truth is None or setups[of].is_given != setups[place].is_given:
                differences = figures_of(found[at, place, name][0], rows.truth, rows)
                scores.append(MethodScore(group, methods[place], differences, name, methods[of]))
    return sorted(scores, key=lambda score: bool(score.against))


Part = tuple[Sequence[int], Sequence[int]]  # what one process measures: the places of its conditions and of its setups
Found = dict[tuple[int, int, str], tuple[Readings, Truth | None, float]]
"""Rows, what is true of them where that is known, and seconds, by the places of condition and setup, and instrument."""


def _parts(setups: Sequence[Setup], condition_count: int, jobs: int) -> list[Part]:
    """Deal work out by conditions, and by methods where they are few: each part reads the log once more."""
    size = -(-condition_count // min(condition_count, CHUNKS_PER_PROCESS * jobs))
    chunks = [range(start, min(start + size, condition_count)) for start in range(0, condition_count, size)]
    groups: list[Sequence[int]] = [range(len(setups))]
    if len(chunks) < jobs:
        with_fused = [at for at, setup in enumerate(setups) if setup.method in WITH_FUSED]
        rest = [at for at in range(len(setups)) if at not in with_fused]
        groups = [group for group in (with_fused, rest) if group]
    return [(chunk, group) for chunk in chunks for group in groups]


@dataclass(frozen=True)
class _Work:
    """A recording, and all that it is measured by, with so many threads."""

    recording: Recording
    conditions: Sequence[Condition]
    setups: Sequence[Setup]
    threads: int

    def passes(self, part: Part) -> list[list[int]]:
        """The conditions of each pass over the log: those of its images together, and every perturbed world."""
        images = [at for at in part[0] if not self.conditions[at].world]
        return [at for at in (images, *([at] for at in part[0] if at not in images)) if at]

    def measure(self, part: Part) -> tuple[Found, Health]:
        found = (self._one_pass(at, part[1]) for at in self.passes(part))
        return {key: rows for of_pass in found for key, rows in of_pass.items()}, self.recording.health

    def _one_pass(self, at: Sequence[int], setups_at: Sequence[int]) -> Found:
        conditions = [self.conditions[place] for place in at]
        read, setups = self.recording, [self.setups[of] for of in setups_at]
        if parallel.is_worker():
            read = replace(read, on_progress=parallel.step)
        if world := conditions[0].world:  # it has a pass of its own
            read = read.perturbed(world)
            setups = [setup.perturbed(world, read.world.seed) for setup in setups]
        keys = [(place, of, name) for place in at for of in setups_at for name in read.measured]
        readings, seconds = {key: Readings() for key in keys}, dict.fromkeys(keys, 0.0)
        for replayed in replay(read, setups, conditions, jobs=self.threads):
            results = [pair for one in replayed for pair in zip(one.results, one.seconds, strict=True)]
            for key, (result, spent_s) in zip(keys, results, strict=True):
                readings[key].add(result)
                seconds[key] += spent_s
        found: Found = {}
        for key, rows in readings.items():
            own, truth = read.for_instrument(key[2]), None
            if own.topic_of(Role.GROUND_TRUTH_DISTANCE) is not None:
                at_ns = rows.stamps_ns - reference_lag_ns(own, Reference.GROUND_TRUTH, read.lag)
                truth = truth_at(own, Reference.GROUND_TRUTH, at_ns, "corrected", ANY_TRUTH)
            found[key] = rows, truth, np.nan if self.setups[key[1]].is_given else seconds[key]
        return found


def group_of(
    recording: Recording, condition: Condition = CLEAN, instrument: str = "", by: GroupBy | None = None
) -> Group:
    """What a recording is compared as: its scenario, or its name, and its degradations; or by other metadata.

    Those are what it was recorded with (of a real world only that is said), and then what is done to it now.
    """
    metadata = recording.metadata
    other = instrument if instrument in recording.instruments[1:] else ""
    if by is not None:
        return Group(by(metadata), str(condition), other)
    world = f"world={metadata['world']}" if "world" in metadata else metadata.get("perturb", "")
    degradations = (metadata.get("degrade", ""), world, str(condition))
    return Group(metadata.get("scenario", recording.name), ",".join(filter(None, degradations)), other)


def compared(runs: Sequence[MethodScore]) -> list[MethodScore]:
    """Scores by group, by degradation over all scenarios where both differ, and over all."""
    kinds = {(run.group.scenario, run.group.degradation) for run in runs}
    scores = _pooled(runs, [run.group for run in runs])
    if all(len(set(several)) > 1 for several in zip(*kinds, strict=True)):
        groups = [replace(run.group, scenario=ALL, degradation=run.group.degradation or "clean") for run in runs]
        scores += _pooled(runs, groups)
    if len(kinds) > 1:
        groups = [replace(run.group, scenario=ALL, degradation=ALL) for run in runs]
        scores += _pooled(runs, groups)
    return scores


def _pooled(runs: Sequence[MethodScore], groups: Sequence[Group]) -> list[MethodScore]:
    """The scores of each group of runs, in the order of the methods: that of the first runs."""
    members: dict[Group, dict[tuple[str, str], list[MethodScore]]] = {}
    for run, group in zip(runs, groups, strict=True):
        of_group = members.setdefault(group, {})
        of_group.setdefault((run.against, run.method), []).append(replace(run, group=group))
    return [
        replace(of[0], figures=pooled_figures([run.figures for run in of]))
        for of_group in members.values()
        for _, of in sorted(of_group.items(), key=lambda one: bool(one[0][0]))
    ]

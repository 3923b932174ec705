"""Compare: the figures of every method on every log under every condition, against the true distances."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

from svmdist.errors import RecordingError
from svmdist.estimation.frame import Clock
from svmdist.metrics import coverage
from svmdist.profile import Profile
from svmdist.recording.log import Recording
from svmdist.recording.source import Health
from svmdist.recording.topics import Role
from svmdist.workflows.conditions import CLEAN, LogCondition, PerturbedCondition
from svmdist.workflows.parallel import (
    Progress,
    Steps,
    each_in_processes,
    image_total,
    is_worker,
    step,
    usable_cores,
)
from svmdist.workflows.replay import replay
from svmdist.workflows.request import Setup
from svmdist.workflows.scoring.score import DISTANCES, DistanceScore, Readings, pooled_score, score_pairs
from svmdist.workflows.scoring.truth import truth_follows_images

CHUNKS_PER_PROCESS = 2
"""Conditions are dealt out in so many parts a process: each part decodes the images once more, few parts wait."""

WITH_FUSED = ("fused", "fiducial")
"""Where methods are shared by two processes: `fused` takes as long as most others together, and finds tags already.
`shaft` and `stereo` share the pose by the shaft's edges, which is what they spend most on."""


@dataclass(frozen=True)
class Run:
    """One method on one instrument of one recording under one condition.

    A distance that method or truth cannot tell is None. `seconds` is the method's processor time alone, with every
    detection that it asked for, without reading, decoding and degrading the image. `statuses` counts the frames by how
    they ended.
    """

    recording: Recording
    condition: LogCondition
    method: str
    frame_count: int
    measured_count: int
    planar: DistanceScore | None
    spatial: DistanceScore | None
    clearance: DistanceScore | None
    seconds: float
    instrument: str = ""
    statuses: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class RunNumbers:
    """What figures are made of: the numbers of a run, without its recording and its condition."""

    frame_count: int
    measured_count: int
    planar: DistanceScore | None
    spatial: DistanceScore | None
    clearance: DistanceScore | None
    seconds: float

    @staticmethod
    def of(run: Run) -> RunNumbers:
        """Those of a run."""
        return RunNumbers(
            run.frame_count, run.measured_count, run.planar, run.spatial, run.clearance, run.seconds
        )


@dataclass(frozen=True)
class Figures:
    """The figures of one run, or of several together: every frame counts the same."""

    frame_count: int
    measured_count: int
    planar: DistanceScore | None
    spatial: DistanceScore | None
    clearance: DistanceScore | None
    ms_per_frame: float

    @property
    def coverage(self) -> float:
        """Measured frames per frame."""
        return coverage(self.measured_count, self.frame_count)


def pooled_figures(runs: Sequence[Run] | Sequence[RunNumbers]) -> Figures:
    """The figures of runs together."""
    frame_count = sum(run.frame_count for run in runs)
    return Figures(
        frame_count,
        sum(run.measured_count for run in runs),
        pooled_score([run.planar for run in runs]),
        pooled_score([run.spatial for run in runs]),
        pooled_score([run.clearance for run in runs]),
        1e3 * sum(run.seconds for run in runs) / max(frame_count, 1),
    )


def measure_runs(
    recordings: Sequence[Recording],
    setups: Sequence[Setup],
    conditions: Sequence[LogCondition] = (CLEAN,),
    *,
    jobs: int | None = None,
    clock: Clock | None = None,
    on_progress: Progress | None = None,
) -> Iterator[Run]:
    """Yield a run for every recording, condition, setup and instrument, in that order.

    With several jobs, processes share recordings, conditions, or methods; what cannot be shared `jobs` threads work
    ahead of. The figures are the same. Raises RecordingError where a recording has no ground-truth
    distances; another instrument than the first is left out where it has none.
    """
    jobs = usable_cores() if jobs is None else jobs
    advance = Steps(on_progress, image_total(recordings, lambda _: len(conditions) * len(setups))).advance
    for recording in recordings:  # what has no truth is told before the work
        for name in _with_truth(recording):
            recording.for_instrument(name).distance_track()
    may_fork = jobs > 1 and not is_worker()
    if may_fork and clock is None:
        parts = _parts(recordings, setups, conditions, jobs)
        if len(parts) > 1:
            yield from _in_processes(parts, recordings, jobs, advance)
            return
    for recording in recordings:
        yield from _runs(recording, setups, conditions, jobs, clock, advance)


def _runs(
    recording: Recording,
    setups: Sequence[Setup],
    conditions: Sequence[LogCondition],
    jobs: int,
    clock: Clock | None,
    advance: Callable[[], None],
) -> list[Run]:
    """One pass over the log for all conditions of its images, and one for every other world."""
    passes: list[Sequence[LogCondition]] = [
        [condition for condition in conditions if not isinstance(condition, PerturbedCondition)],
        *([condition] for condition in conditions if isinstance(condition, PerturbedCondition)),
    ]
    runs = [run for of in passes if of for run in _pass(recording, setups, of, jobs, clock, advance)]
    return sorted(runs, key=lambda run: conditions.index(run.condition))


def _pass(
    recording: Recording,
    setups: Sequence[Setup],
    conditions: Sequence[LogCondition],
    jobs: int,
    clock: Clock | None,
    advance: Callable[[], None],
) -> list[Run]:
    names = _with_truth(recording)
    lanes = [(condition, setup) for condition in conditions for setup in setups]
    tallies = [{name: _Tally() for name in names} for _ in lanes]
    seen, told = recording, setups
    for condition in conditions:
        if isinstance(condition, PerturbedCondition):  # alone
            seen = recording.perturbed(condition.perturbations, setups[0].profile)
            told = [setup.perturbed(condition.perturbations, seen.world_seed) for setup in setups]
    for replayed in replay(seen, told, conditions, wanted=names, jobs=jobs, clock=clock):
        for lane, of_lane in zip(replayed, tallies, strict=True):
            for result, seconds, tally in zip(lane.results, lane.seconds, of_lane.values(), strict=True):
                tally.frame_count += 1
                tally.seconds += seconds
                tally.statuses[str(result.status)] += 1
                if result.measured:
                    tally.readings.add(result)
            advance()
    profile = setups[0].profile
    truths = {name: recording.for_instrument(name).distance_track() for name in names}
    late_ns = {
        name: _truth_late_ns(seen.for_instrument(name), profile.for_instrument(name)) for name in names
    }
    runs = []
    for (condition, setup), of_lane in zip(lanes, tallies, strict=True):
        for name, tally in of_lane.items():
            sampled = truths[name].at(tally.readings.stamps_ns - late_ns[name])
            planar, spatial, clearance = (
                score_pairs(tally.readings.pairs(distance, sampled)) for distance in DISTANCES
            )
            runs.append(
                Run(
                    recording,
                    condition,
                    setup.method,
                    tally.frame_count,
                    len(tally.readings),
                    planar,
                    spatial,
                    clearance,
                    tally.seconds,
                    name,
                    dict(tally.statuses),
                )
            )
    return runs


def _truth_late_ns(seen: Recording, profile: Profile) -> int:
    """By how much the stamps of images are late against those of the truth."""
    return 0 if seen.lag is None or truth_follows_images(seen, profile) else seen.lag.lag_ns


class _Tally:
    """One method on one instrument under one condition while the frames pass by: numbers, no image."""

    def __init__(self) -> None:
        self.frame_count = 0
        self.seconds = 0.0
        self.statuses: Counter[str] = Counter()
        self.readings = Readings()


@dataclass(frozen=True)
class _Part:
    """What one process measures: some methods on one recording under some of the conditions, by `jobs` threads.

    `places` are those of the methods among all setups, `first_condition` that of the conditions among all.
    """

    recording: Recording
    number: int
    conditions: tuple[LogCondition, ...]
    first_condition: int
    setups: tuple[Setup, ...]
    places: tuple[int, ...]
    jobs: int

    def measure(self) -> tuple[list[Run], Health]:
        """The runs, and what was lost in reading."""
        runs = _runs(self.recording, self.setups, self.conditions, self.jobs, None, step)
        return runs, self.recording.health

    def order(self, run_count: int) -> list[tuple[int, ...]]:
        """Where each run belongs: the numbers of recording, condition, setup and instrument."""
        conditions = range(self.first_condition, self.first_condition + len(self.conditions))
        instruments = range(run_count // (len(self.conditions) * len(self.places)))
        return list(product([self.number], conditions, self.places, instruments))


def _parts(
    recordings: Sequence[Recording], setups: Sequence[Setup], conditions: Sequence[LogCondition], jobs: int
) -> list[_Part]:
    """Deal the work out to processes: by recordings and conditions, and by methods where those are too few.

    A part reads and decodes its recording once more, so that there are no more of them than even the load.
    """
    chunk_count = min(len(conditions), -(-CHUNKS_PER_PROCESS * jobs // len(recordings)))
    size = -(-len(conditions) // chunk_count)
    starts = range(0, len(conditions), size)
    groups = [tuple(range(len(setups)))]
    if len(recordings) * len(starts) < jobs:
        with_fused = tuple(at for at, setup in enumerate(setups) if setup.method in WITH_FUSED)
        groups = [group for group in (with_fused, tuple(sorted({*groups[0]} - {*with_fused}))) if group]
    threads = max(1, jobs // (len(recordings) * len(starts) * len(groups)))
    return [
        _Part(
            recording,
            number,
            tuple(conditions[start : start + size]),
            start,
            tuple(setups[at] for at in places),
            places,
            threads,
        )
        for number, recording in enumerate(recordings)
        for start in starts
        for places in groups
    ]


def _in_processes(
    parts: Sequence[_Part], recordings: Sequence[Recording], jobs: int, advance: Callable[[], None]
) -> Iterator[Run]:
    found = dict(each_in_processes(_Part.measure, parts, jobs, on_step=advance))
    measured = [found[place] for place in range(len(parts))]
    # Methods that need both views lose what others lose, and right images: their list has all in the file's order.
    for part, (_, health) in sorted(zip(parts, measured, strict=True), key=lambda of: -len(of[1][1].losses)):
        recordings[part.number].health.join(health)
    placed = {
        place: replace(run, recording=recordings[part.number])
        for part, (runs, _) in zip(parts, measured, strict=True)
        for place, run in zip(part.order(len(runs)), runs, strict=True)
    }
    yield from (placed[place] for place in sorted(placed))


def _with_truth(recording: Recording) -> list[str]:
    """The first instrument, and those of the others whose true distances the recording has."""
    first, *others = recording.instruments
    role = Role.GROUND_TRUTH_DISTANCE
    return [first, *(name for name in others if recording.for_instrument(name).topic_of(role) is not None)]


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

"""Compare: the figures of every method on every log under every condition, against the true distances."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from svmdist.errors import RecordingError
from svmdist.metrics import coverage
from svmdist.profile import Profile
from svmdist.recording.log import Recording
from svmdist.recording.source import Health
from svmdist.recording.topics import Role
from svmdist.tracks import DistanceTrack
from svmdist.workflows.parallel import (
    Progress,
    Steps,
    each_in_processes,
    image_total,
    is_worker,
    step,
    usable_cores,
)
from svmdist.workflows.references import truth_follows_images
from svmdist.workflows.replay import replay
from svmdist.workflows.request import CLEAN, LogCondition, PerturbedCondition, Setup
from svmdist.workflows.scores import DISTANCES, DistanceScore, Readings, pooled_score, score_pairs

GroupBy = Callable[[Mapping[str, str]], str]
"""Names the group of a recording by its metadata."""

ALL = "all"
UNDEGRADED = "clean"
CHUNKS_PER_PROCESS = 2
"""Conditions are dealt out in so many parts a process: each part decodes the images once more, few parts wait."""

WITH_FUSED = ("fused", "fiducial")
"""Where methods are shared by two processes: `fused` takes as long as most others together, and finds tags already.
`shaft` and `stereo` share the pose by the shaft's edges, which is what they spend most on."""


@dataclass(frozen=True, slots=True)
class Group:
    """Frames that are compared together: those of a scenario, and how they were degraded (`smoke=3`, or empty).

    A perturbed world (`focal=1`, or `world=real`) counts as a degradation. A scenario of `all` is all of them; so is a
    degradation of `all`. Instruments are never compared together: `other_instrument` names one that is not the first
    of its recording.
    """

    scenario: str
    degradation: str = ""
    other_instrument: str = ""

    def __str__(self) -> str:
        degradation = "" if self.degradation == ALL else self.degradation
        return " ".join(filter(None, (self.scenario, degradation, self.other_instrument)))


@dataclass(frozen=True)
class Figures:
    """The figures of runs together: every frame counts the same; a distance without estimate or truth is None.

    `seconds` is the processor time spent on estimates and their detections, without reading, decoding and degrading
    images; methods that are measured together share the cost of what several of them use.
    """

    frame_count: int
    measured_count: int
    planar: DistanceScore | None
    spatial: DistanceScore | None
    clearance: DistanceScore | None
    seconds: float

    @property
    def coverage(self) -> float:
        """Measured frames per frame."""
        return coverage(self.measured_count, self.frame_count)

    @property
    def ms_per_frame(self) -> float:
        """Processor time per frame."""
        return 1e3 * self.seconds / max(self.frame_count, 1)


@dataclass(frozen=True)
class Run:
    """One method on one instrument of one recording under one condition, and the group that it belongs to.

    `statuses` counts the frames by how they ended.
    """

    group: Group
    method: str
    instrument: str
    figures: Figures
    statuses: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class MethodScore:
    """One method on one group of frames, and the instrument that it measured."""

    group: Group
    method: str
    figures: Figures
    instrument: str = ""


def compare(
    recordings: Sequence[Recording],
    setups: Sequence[Setup],
    conditions: Sequence[LogCondition] = (CLEAN,),
    *,
    jobs: int | None = None,
    on_progress: Progress | None = None,
) -> list[MethodScore]:
    """Run every setup on every recording under every condition; each process decodes an image once.

    Raises RecordingError where a recording has no ground-truth distances, and where there is no image.
    """
    steps = Steps(on_progress, image_total(recordings, lambda _: len(conditions) * len(setups)))
    runs = [
        run
        for recording in recordings
        for run in measure_runs(recording, setups, conditions, jobs=jobs, advance=steps.advance)
    ]
    return compared(runs, [setup.method for setup in setups])


def measure_runs(
    recording: Recording,
    setups: Sequence[Setup],
    conditions: Sequence[LogCondition] = (CLEAN,),
    *,
    jobs: int | None = None,
    by: GroupBy | None = None,
    advance: Callable[[], None] = lambda: None,
) -> list[Run]:
    """A run for every condition, setup and instrument, in that order.

    With several jobs, processes share conditions or methods; `jobs` threads work ahead where nothing can be shared.
    The figures are the same. Raises RecordingError where the recording has no ground-truth distances; another
    instrument than the first is left out where it has none. `advance` is called for every image, condition and setup;
    `by` groups by other metadata than the scenario.
    """
    jobs = usable_cores() if jobs is None else jobs
    first, *others = recording.instruments
    role = Role.GROUND_TRUTH_DISTANCE
    names = [first, *(name for name in others if recording.for_instrument(name).topic_of(role) is not None)]
    truths = {name: recording.for_instrument(name).distance_track() for name in names}
    parts = _parts(recording, truths, dict(enumerate(conditions)), dict(enumerate(setups)), jobs)
    if jobs > 1 and len(parts) > 1 and recording.origin is not None and not is_worker():
        measured = [found for _, found in each_in_processes(_measured_part, parts, jobs, on_step=advance)]
        # Methods that need both views lose what others lose, and right images: their list has all in file order.
        for _, health in sorted(measured, key=lambda one: -len(one[1].losses)):
            recording.health.join(health)
        found = {place: runs for runs_at, _ in measured for place, runs in runs_at.items()}
    else:
        whole = _Part(recording, truths, dict(enumerate(conditions)), dict(enumerate(setups)), jobs)
        found = whole.measure(advance)
    return [
        Run(group_of(recording, conditions[at], name, by), setups[of].method, name, figures, dict(statuses))
        for at, of in sorted(found)
        for name, (figures, statuses) in found[at, of].items()
    ]


Found = dict[tuple[int, int], dict[str, tuple[Figures, Counter[str]]]]
"""By the places of condition and setup, and by instrument."""


@dataclass(frozen=True)
class _Part:
    """What one process measures: some methods under some conditions, by their places among all, with some threads."""

    recording: Recording
    truths: Mapping[str, DistanceTrack]
    conditions: Mapping[int, LogCondition]
    setups: Mapping[int, Setup]
    threads: int

    def measure(self, advance: Callable[[], None]) -> Found:
        """One pass over the log for all conditions of its images, and one for every perturbed world."""
        images = [at for at, one in self.conditions.items() if not isinstance(one, PerturbedCondition)]
        worlds = [[at] for at in self.conditions if at not in images]
        return {
            key: found for at in [images, *worlds] if at for key, found in self._one_pass(at, advance).items()
        }

    def _one_pass(self, at: Sequence[int], advance: Callable[[], None]) -> Found:
        conditions = [self.conditions[place] for place in at]
        setups, profile = list(self.setups.values()), next(iter(self.setups.values())).profile
        read, told = self.recording, setups
        for condition in conditions:
            if isinstance(condition, PerturbedCondition):  # alone
                read = self.recording.perturbed(condition.perturbations, profile)
                told = [setup.perturbed(condition.perturbations, read.world_seed) for setup in setups]
        lanes = [(place, of) for place in at for of in self.setups]
        tallies = {lane: {name: _Tally() for name in self.truths} for lane in lanes}
        for replayed in replay(read, told, conditions, wanted=list(self.truths), jobs=self.threads):
            for lane, of_lane in zip(replayed, tallies.values(), strict=True):
                for result, seconds, tally in zip(lane.results, lane.seconds, of_lane.values(), strict=True):
                    tally.seconds += seconds
                    tally.statuses[str(result.status)] += 1
                    if result.measured:
                        tally.readings.add(result)
                advance()
        late_ns = {
            name: _truth_late_ns(read.for_instrument(name), profile.for_instrument(name))
            for name in self.truths
        }
        return {
            lane: {name: tally.figures(self.truths[name], late_ns[name]) for name, tally in of_lane.items()}
            for lane, of_lane in tallies.items()
        }


def _measured_part(part: _Part) -> tuple[Found, Health]:
    return part.measure(step), part.recording.health


def _truth_late_ns(read: Recording, profile: Profile) -> int:
    """By how much the stamps of images are late against those of the truth."""
    return 0 if read.lag is None or truth_follows_images(read, profile) else read.lag.lag_ns


class _Tally:
    """One method on one instrument under one condition while the frames pass by: numbers, no image."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self.statuses: Counter[str] = Counter()
        self.readings = Readings()

    def figures(self, truth: DistanceTrack, late_ns: int) -> tuple[Figures, Counter[str]]:
        sampled = truth.at(self.readings.stamps_ns - late_ns)
        planar, spatial, clearance = (score_pairs(self.readings.pairs(one, sampled)) for one in DISTANCES)
        count, measured_count = self.statuses.total(), len(self.readings)
        return Figures(count, measured_count, planar, spatial, clearance, self.seconds), self.statuses


def _parts(
    recording: Recording,
    truths: Mapping[str, DistanceTrack],
    conditions: Mapping[int, LogCondition],
    setups: Mapping[int, Setup],
    jobs: int,
) -> list[_Part]:
    """Deal the work out to processes: by conditions, and by methods where those are too few.

    A part reads and decodes the recording once more, so that there are no more of them than even the load.
    """
    size = -(-len(conditions) // min(len(conditions), CHUNKS_PER_PROCESS * jobs))
    starts = range(0, len(conditions), size)
    groups = [list(setups)]
    if len(starts) < jobs:
        with_fused = [at for at, setup in setups.items() if setup.method in WITH_FUSED]
        groups = [group for group in (with_fused, [at for at in setups if at not in with_fused]) if group]
    threads = max(1, jobs // (len(starts) * len(groups)))
    return [
        _Part(
            recording,
            truths,
            {at: conditions[at] for at in range(start, min(start + size, len(conditions)))},
            {at: setups[at] for at in group},
            threads,
        )
        for start in starts
        for group in groups
    ]


def group_of(
    recording: Recording, condition: LogCondition = CLEAN, instrument: str = "", by: GroupBy | None = None
) -> Group:
    """What a recording is compared as: its scenario, or its name where it names none, and its degradations.

    Those are what it was recorded with, `degrade` and `perturb` of its metadata, and then what is done to it now. Of a
    real world, in which everything is perturbed, only that is said. `by` groups by other metadata instead.
    """
    metadata = recording.metadata
    other = instrument if instrument in recording.instruments[1:] else ""
    if by is not None:
        return Group(by(metadata), str(condition), other)
    world = f"world={metadata['world']}" if "world" in metadata else metadata.get("perturb", "")
    degradations = (metadata.get("degrade", ""), world, str(condition))
    return Group(metadata.get("scenario", recording.name), ",".join(filter(None, degradations)), other)


def pooled_figures(figures: Sequence[Figures]) -> Figures:
    """Several figures as one."""
    planar, spatial, clearance = (
        pooled_score([getattr(one, of.name) for one in figures]) for of in DISTANCES
    )
    return Figures(
        sum(one.frame_count for one in figures),
        sum(one.measured_count for one in figures),
        planar,
        spatial,
        clearance,
        sum(one.seconds for one in figures),
    )


def compared(runs: Sequence[Run], methods: Sequence[str]) -> list[MethodScore]:
    """The scores of runs, by group and over groups; RecordingError where there is no image.

    Scores stand per scenario and degradation; then, where there are several of both, per degradation over all
    scenarios; then over all.
    """
    if not any(run.figures.frame_count for run in runs):
        raise RecordingError("there is no image to measure in these recordings")
    groups = list(dict.fromkeys(run.group for run in runs))
    scores = _scores([(run.group, run) for run in runs], methods)
    if len({group.degradation for group in groups}) > 1 and len({group.scenario for group in groups}) > 1:
        of_all = [
            (Group(ALL, run.group.degradation or UNDEGRADED, run.group.other_instrument), run) for run in runs
        ]
        scores += _scores(of_all, methods)
    if len({(group.scenario, group.degradation) for group in groups}) > 1:
        scores += _scores([(Group(ALL, ALL, run.group.other_instrument), run) for run in runs], methods)
    return scores


def _scores(runs: Iterable[tuple[Group, Run]], methods: Sequence[str]) -> list[MethodScore]:
    """The scores of each group, in the order of the methods."""
    members: dict[Group, list[Run]] = {}
    for group, run in runs:
        members.setdefault(group, []).append(run)
    return [
        MethodScore(
            group,
            method,
            pooled_figures([run.figures for run in of if run.method == method]),
            of[0].instrument,
        )
        for group, of in members.items()
        for method in dict.fromkeys(methods)
    ]

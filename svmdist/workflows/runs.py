"""Runs: the figures of every method on every recording under every condition, against the true distances."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from itertools import count
from multiprocessing import get_context

from svmdist.estimation.detection.lazy import Clock
from svmdist.metrics import coverage
from svmdist.recording.health import Health
from svmdist.recording.reader import Recording
from svmdist.recording.topics import Role
from svmdist.workflows.ahead import usable_cores
from svmdist.workflows.conditions import CLEAN, LogCondition, PerturbedCondition
from svmdist.workflows.replay import replay
from svmdist.workflows.scoring.distances import DISTANCES, DistanceScore, Readings, pooled_score, score_pairs
from svmdist.workflows.setup import Setup

Progress = Callable[[int, int | None], None]
"""Is told how many measurements are done, and how many there are where the logs say."""

CHUNKS_PER_PROCESS = 2
"""Conditions are dealt out in so many parts a process: each part decodes the images once more, few parts wait."""


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


def pooled_figures(runs: Sequence[Run]) -> Figures:
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

    Conditions are independent of each other: with several of them, and several jobs, processes share them. Otherwise
    `jobs` threads work ahead. The figures are the same. Raises RecordingError where a recording has no ground-truth
    distances; another instrument than the first is left out where it has none.
    """
    jobs = usable_cores() if jobs is None else jobs
    counts = [_image_count(recording) for recording in recordings]
    known = [number for number in counts if number is not None]
    total = sum(known) * len(conditions) * len(setups) if len(known) == len(counts) else None
    for recording in recordings:  # what has no truth is told before the work
        for name in _with_truth(recording):
            recording.for_instrument(name).distance_track()
    done = count(1)

    def advance() -> None:
        number = next(done)
        if on_progress is not None:
            on_progress(number, total)

    if jobs > 1 and len(conditions) > 1 and clock is None:
        yield from _in_processes(recordings, setups, conditions, jobs, advance)
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
    truths = {name: recording.for_instrument(name).distance_track() for name in names}
    runs = []
    for (condition, setup), of_lane in zip(lanes, tallies, strict=True):
        for name, tally in of_lane.items():
            sampled = truths[name].at(tally.readings.stamps_ns)
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


class _Tally:
    """One method on one instrument under one condition while the frames pass by: numbers, no image."""

    def __init__(self) -> None:
        self.frame_count = 0
        self.seconds = 0.0
        self.statuses: Counter[str] = Counter()
        self.readings = Readings()


def _measure_part(
    recording: Recording, setups: Sequence[Setup], conditions: Sequence[LogCondition]
) -> tuple[list[Run], Health]:
    """What one process does: one recording under some of the conditions. Gives what was lost in reading, too."""
    return _runs(recording, setups, conditions, 1, None, lambda: None), recording.health


def _in_processes(
    recordings: Sequence[Recording],
    setups: Sequence[Setup],
    conditions: Sequence[LogCondition],
    jobs: int,
    advance: Callable[[], None],
) -> Iterator[Run]:
    size = -(-len(conditions) // (CHUNKS_PER_PROCESS * jobs))
    chunks = [tuple(conditions[at : at + size]) for at in range(0, len(conditions), size)]
    parts = [(recording, chunk) for recording in recordings for chunk in chunks]
    # A fresh interpreter: threads and OpenCV's state do not survive a fork.
    with ProcessPoolExecutor(min(jobs, len(parts)), get_context("spawn")) as pool:
        futures = [pool.submit(_measure_part, recording, tuple(setups), chunk) for recording, chunk in parts]
        try:
            for future in as_completed(futures):
                runs, _ = future.result()
                for _ in range(sum(run.frame_count for run in runs if run.instrument == runs[0].instrument)):
                    advance()
        except BaseException:
            for future in futures:
                future.cancel()
            raise
    for (recording, _), future in zip(parts, futures, strict=True):
        runs, health = future.result()
        for loss in health.losses:
            recording.health.add(loss)
        yield from (replace(run, recording=recording) for run in runs)


def _with_truth(recording: Recording) -> list[str]:
    """The first instrument, and those of the others whose true distances the recording has."""
    first, *others = recording.instruments
    role = Role.GROUND_TRUTH_DISTANCE
    return [first, *(name for name in others if recording.for_instrument(name).topic_of(role) is not None)]


def _image_count(recording: Recording) -> int | None:
    """The number of (left) images, where the file says."""
    topic = recording.topic_of(Role.IMAGE)
    return next((info.message_count for info in recording.topics() if info.topic == topic), None)

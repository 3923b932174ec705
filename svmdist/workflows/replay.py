"""Replay: every method on every image of the recordings, as recorded and degraded, in one pass over the images."""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from svmdist.estimation.methods import Estimator
from svmdist.metrics import coverage
from svmdist.recording.reader import Recording
from svmdist.recording.topics import Role
from svmdist.samples import Observation, Rejection
from svmdist.vision.degradations import Degradation, degrade, image_seed, require_degradation
from svmdist.workflows.estimate import instruments_of
from svmdist.workflows.scoring.distances import DISTANCES, DistanceScore, Readings, pooled_score, score_pairs
from svmdist.workflows.setup import Setup

Clock = Callable[[], float]
Progress = Callable[[int, int | None], None]
"""Is told how many measurements are done, and how many there are where the logs say."""

REPLAY_SEED = 36
LEFT, RIGHT = 0, 1


@dataclass(frozen=True, slots=True)
class Condition:
    """What is done to the images of a log: a degradation of a severity of 1 to 5, or nothing.

    It comes on top of what the log's images already have. Raises UsageError for a wrong name or severity.
    """

    name: Degradation | None = None
    severity: int = 0

    def __post_init__(self) -> None:
        if self.name is not None:
            require_degradation(self.name, self.severity)

    def __str__(self) -> str:
        return "" if self.name is None else f"{self.name}={self.severity}"

    def apply(self, observation: Observation, frame: int) -> Observation:
        """Degrade the images of the n-th frame, the right one too: the same frame of the same log always alike."""
        if self.name is None:
            return observation
        # The image itself tells logs apart, whatever their names and order. The severity plays no part: glints
        # and plumes of one are those of the next, only more of them.
        content = zlib.crc32(np.ascontiguousarray(observation.image_bgr).data)
        path = (REPLAY_SEED, list(Degradation).index(self.name), frame, content)
        image_bgr = degrade(
            observation.image_bgr, self.name, self.severity, image_seed(self.name, LEFT, *path)
        )
        right = observation.right
        if right is not None:
            seed = image_seed(self.name, RIGHT, *path)
            right = replace(right, image_bgr=degrade(right.image_bgr, self.name, self.severity, seed))
        return replace(observation, image_bgr=image_bgr, right=right)


CLEAN = Condition()


@dataclass(frozen=True)
class Run:
    """One method on one instrument of one recording under one condition.

    A distance that method or truth cannot tell is None. `seconds` is the method alone, without reading,
    decoding and degrading the image.
    """

    recording: Recording
    condition: Condition
    method: str
    frame_count: int
    measured_count: int
    planar: DistanceScore | None
    spatial: DistanceScore | None
    clearance: DistanceScore | None
    seconds: float
    instrument: str = ""


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


def replay(
    recordings: Sequence[Recording],
    setups: Sequence[Setup],
    conditions: Sequence[Condition] = (CLEAN,),
    *,
    clock: Clock = time.perf_counter,
    on_progress: Progress | None = None,
) -> Iterator[Run]:
    """Yield a run for every recording, condition, setup and instrument; each image is decoded and degraded once.

    Every run has an estimator of its own, so that what one remembers never reaches another. Of an image nothing
    is kept. Raises RecordingError where a recording has no ground-truth distances; another instrument than the
    first is left out where it has none.
    """
    counts = [_image_count(recording) for recording in recordings]
    known = [count for count in counts if count is not None]
    total = sum(known) * len(conditions) * len(setups) if len(known) == len(counts) else None
    done = 0
    for recording in recordings:
        names = _with_truth(recording)
        # Before the work: a log without it is told at once.
        truths = {name: recording.for_instrument(name).distance_track() for name in names}
        cells = [[_Cell(setup, recording, name) for setup in setups for name in names] for _ in conditions]
        teams = [instruments_of(recording, setups[0]) for _ in conditions]
        for frame, found in enumerate(recording.observations_of(recording.instruments)):
            for condition, team, row in zip(conditions, teams, cells, strict=True):
                seen = (
                    found
                    if isinstance(found, Rejection)
                    else team.tell_apart(_degraded(condition, found, frame))
                )
                for cell in row:
                    place = recording.instruments.index(cell.instrument)
                    cell.measure(seen if isinstance(seen, Rejection) else seen[place], clock)
                    done += cell.instrument == names[0]  # a frame of a method, whatever its instruments
                    if on_progress is not None:
                        on_progress(done, total)
        for condition, row in zip(conditions, cells, strict=True):
            for cell in row:
                sampled = truths[cell.instrument].at(cell.readings.stamps_ns)
                planar, spatial, clearance = (
                    score_pairs(cell.readings.pairs(distance, sampled)) for distance in DISTANCES
                )
                yield Run(
                    recording,
                    condition,
                    cell.method,
                    cell.frame_count,
                    len(cell.readings),
                    planar,
                    spatial,
                    clearance,
                    cell.seconds,
                    cell.instrument,
                )


def _degraded(condition: Condition, found: Sequence[Observation], frame: int) -> list[Observation]:
    """What every instrument's estimator sees of the same degraded image."""
    first = condition.apply(found[0], frame)
    return [replace(each, image_bgr=first.image_bgr, right=first.right) for each in found]


def _with_truth(recording: Recording) -> list[str]:
    """The first instrument, and those of the others whose true distances the recording has."""
    first, *others = recording.instruments
    role = Role.GROUND_TRUTH_DISTANCE
    return [first, *(name for name in others if recording.for_instrument(name).topic_of(role) is not None)]


class _Cell:
    """One method on one instrument under one condition while the frames pass by: an estimator, and numbers."""

    def __init__(self, setup: Setup, recording: Recording, instrument: str) -> None:
        self.method = setup.method
        self.instrument = instrument
        self.estimator: Estimator = setup.estimator_for(recording, instrument)
        self.frame_count = 0
        self.seconds = 0.0
        self.readings = Readings()

    def measure(self, observation: Observation | Rejection, clock: Clock) -> None:
        self.frame_count += 1
        if isinstance(observation, Rejection):
            return
        start_s = clock()
        row = self.estimator.estimate(observation)
        self.seconds += clock() - start_s
        if row.measured:
            self.readings.add(row)


def _image_count(recording: Recording) -> int | None:
    """The number of (left) images, where the file says."""
    topic = recording.topic_of(Role.IMAGE)
    return next((info.message_count for info in recording.topics() if info.topic == topic), None)

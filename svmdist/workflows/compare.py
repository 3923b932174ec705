"""Compare: all methods on the same recordings, in one pass over the images."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from svmdist.errors import RecordingError
from svmdist.estimation.methods import Estimator
from svmdist.metrics import ErrorStatistics, coverage, error_statistics, interval_coverage
from svmdist.recording.reader import Recording
from svmdist.samples import Estimate, Observation, Rejection
from svmdist.tracks import SampledDistances
from svmdist.transforms import Array
from svmdist.workflows.setup import Setup

ALL = "all"


@dataclass(frozen=True, slots=True)
class DistanceScore:
    """How one of the three distances did: error figures in m, and the share of truths inside the 95 % interval.

    `interval_coverage` is None for a method that states no deviation.
    """

    statistics: ErrorStatistics
    interval_coverage: float | None


@dataclass(frozen=True)
class MethodScore:
    """One method on one group of frames: a recording, or all of them.

    A distance the method cannot tell is None. `ms_per_frame` is the method alone, without reading and
    decoding the image.
    """

    group: str
    method: str
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


@dataclass
class _Tally:
    """What one method collects on one group: numbers only."""

    frame_count: int = 0
    measured_count: int = 0
    seconds: float = 0.0
    errors: dict[str, list[tuple[float, float, float]]] = field(default_factory=lambda: defaultdict(list))
    """By distance: estimate, truth and standard deviation (NaN where none is stated)."""


DISTANCES: dict[str, tuple[Callable[[Estimate], float | None], Callable[[Estimate], float | None], str]] = {
    "planar": (lambda row: row.distance_m, lambda row: row.distance_std_m, "planar_m"),
    "spatial": (lambda row: row.spatial_m, lambda row: row.spatial_std_m, "spatial_m"),
    "clearance": (lambda row: row.clearance_m, lambda row: row.clearance_std_m, "clearance_m"),
}


def group_of(recording: Recording) -> str:
    """What a recording is compared as: its scenario and degradation where it names them, else its name."""
    metadata = recording.metadata
    parts = [metadata.get("scenario", recording.name)]
    if metadata.get("degradation"):
        parts.append(metadata["degradation"])
    return " ".join(parts)


def compare(
    recordings: Sequence[Recording],
    setups: Sequence[Setup],
    clock: Callable[[], float] = time.perf_counter,
) -> list[MethodScore]:
    """Run every setup on every recording; each image is decoded once. Groups first, then all together.

    Raises RecordingError where a recording has no ground-truth distances.
    """
    tallies: dict[tuple[str, str], _Tally] = defaultdict(_Tally)
    groups: dict[str, None] = {}
    for recording in recordings:
        group = group_of(recording)
        groups[group] = None
        rows = _measure(recording, setups, tallies, group, clock)
        for setup, measured in zip(setups, rows, strict=True):
            _collect(recording, measured, tallies[group, setup.method])
    if not any(tally.frame_count for tally in tallies.values()):
        raise RecordingError("there is no image to measure in these recordings")
    methods = [setup.method for setup in setups]
    scores = [_score(group, method, [tallies[group, method]]) for group in groups for method in methods]
    if len(groups) > 1:
        scores += [_score(ALL, method, [tallies[group, method] for group in groups]) for method in methods]
    return scores


def _measure(
    recording: Recording,
    setups: Sequence[Setup],
    tallies: dict[tuple[str, str], _Tally],
    group: str,
    clock: Callable[[], float],
) -> list[list[Estimate]]:
    """The measured rows of each setup, and the time it took."""
    estimators: list[Estimator] = [setup.estimator_for(recording) for setup in setups]
    measured: list[list[Estimate]] = [[] for _ in setups]
    for observation in recording.observations():
        for setup, estimator, rows in zip(setups, estimators, measured, strict=True):
            tally = tallies[group, setup.method]
            tally.frame_count += 1
            if isinstance(observation, Rejection):
                continue
            row = _timed(estimator, observation, tally, clock)
            if row.measured:
                tally.measured_count += 1
                rows.append(row)
    return measured


def _timed(
    estimator: Estimator, observation: Observation, tally: _Tally, clock: Callable[[], float]
) -> Estimate:
    start_s = clock()
    row = estimator.estimate(observation)
    tally.seconds += clock() - start_s
    return row


def _collect(recording: Recording, rows: Sequence[Estimate], tally: _Tally) -> None:
    truth = recording.distance_track().at(np.array([row.stamp_ns for row in rows], np.int64))
    for name, (value_of, std_of, attribute) in DISTANCES.items():
        true_m = _column(truth, attribute)
        for row, true, valid in zip(rows, true_m, truth.valid, strict=True):
            value, std = value_of(row), std_of(row)
            if valid and value is not None:
                tally.errors[name].append((value, float(true), np.nan if std is None else std))


def _column(truth: SampledDistances, attribute: str) -> Array:
    return np.asarray(getattr(truth, attribute))


def _score(group: str, method: str, tallies: Sequence[_Tally]) -> MethodScore:
    frame_count = sum(tally.frame_count for tally in tallies)
    planar, spatial, clearance = (
        _distance_score([pair for tally in tallies for pair in tally.errors[name]]) for name in DISTANCES
    )
    return MethodScore(
        group,
        method,
        frame_count,
        sum(tally.measured_count for tally in tallies),
        planar,
        spatial,
        clearance,
        ms_per_frame=1e3 * sum(tally.seconds for tally in tallies) / max(frame_count, 1),
    )


def _distance_score(pairs: Sequence[tuple[float, float, float]]) -> DistanceScore | None:
    if not pairs:
        return None
    estimate_m, truth_m, std_m = np.array(pairs).T
    statistics = error_statistics(estimate_m, truth_m)
    assert statistics is not None  # there are pairs
    stated = np.isfinite(std_m)
    inside = interval_coverage(estimate_m[stated], truth_m[stated], std_m[stated]) if stated.any() else None
    return DistanceScore(statistics, inside)

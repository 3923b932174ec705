"""Scoring: the three distances of rows paired with their truth, and the figures of such pairs."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from svmdist.metrics import ErrorStatistics, error_statistics, interval_coverage
from svmdist.samples import Estimate
from svmdist.tracks import SampledDistances
from svmdist.transforms import Array


@dataclass(frozen=True, slots=True)
class Distance:
    """One of the three distances: its value and its standard deviation in a row, and its truth, all in m."""

    name: str
    value_of: Callable[[Estimate], float | None]
    std_of: Callable[[Estimate], float | None]
    truth_of: Callable[[SampledDistances], Array]


PLANAR = Distance("planar", lambda r: r.distance_m, lambda r: r.distance_std_m, lambda t: t.planar_m)
SPATIAL = Distance("spatial", lambda r: r.spatial_m, lambda r: r.spatial_std_m, lambda t: t.spatial_m)
CLEARANCE = Distance(
    "clearance", lambda r: r.clearance_m, lambda r: r.clearance_std_m, lambda t: t.clearance_m
)
DISTANCES = (PLANAR, SPATIAL, CLEARANCE)


@dataclass(frozen=True)
class Pairs:
    """Measured frames with a reference, shape (n,) each: stamps, and estimate, truth and deviation in m.

    The deviation is NaN where the method states none.
    """

    stamps_ns: NDArray[np.int64]
    estimate_m: Array
    truth_m: Array
    std_m: Array

    def __len__(self) -> int:
        """Count the pairs."""
        return len(self.stamps_ns)

    @property
    def interval_coverage(self) -> float | None:
        """Share of truths inside the stated 95 % interval; None where no deviation is stated."""
        stated = np.isfinite(self.std_m)
        return interval_coverage(self.estimate_m[stated], self.truth_m[stated], self.std_m[stated])


@dataclass(frozen=True, slots=True)
class DistanceScore:
    """How one of the three distances did: error figures in m, and the share of truths inside the 95 % interval.

    `interval_coverage` is None for a method that states no deviation.
    """

    statistics: ErrorStatistics
    interval_coverage: float | None
    pairs: Pairs = field(repr=False)


def pair(
    distance: Distance, rows: Sequence[Estimate], truth: SampledDistances, stamps_ns: NDArray[np.int64]
) -> Pairs:
    """Pair measured rows with the truth at their stamps, shape (n,) all; what has no value is left out."""
    estimate_m = _column(distance.value_of(row) if row.measured else None for row in rows)
    std_m = _column(distance.std_of(row) for row in rows)
    return _paired(stamps_ns, estimate_m, distance.truth_of(truth), std_m, truth.valid)


class Readings:
    """The distances of measured rows while they come: numbers only, 56 bytes a row."""

    def __init__(self) -> None:
        self._stamps_ns = array("q")
        self._values_m = array("d")

    def __len__(self) -> int:
        """Count the rows."""
        return len(self._stamps_ns)

    def add(self, row: Estimate) -> None:
        """Take the value and the deviation of each distance out of a row."""
        self._stamps_ns.append(row.stamp_ns)
        for distance in DISTANCES:
            value_m, std_m = distance.value_of(row), distance.std_of(row)
            self._values_m.append(np.nan if value_m is None else value_m)
            self._values_m.append(np.nan if std_m is None else std_m)

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """The stamps, shape (n,)."""
        return np.array(self._stamps_ns, np.int64)

    def pairs(self, distance: Distance, truth: SampledDistances) -> Pairs:
        """Pair one distance with the truth at the stamps; what has no value is left out."""
        place = DISTANCES.index(distance)
        columns = np.array(self._values_m, np.float64).reshape(-1, len(DISTANCES), 2)[:, place]
        return _paired(self.stamps_ns, columns[:, 0], distance.truth_of(truth), columns[:, 1], truth.valid)


def _paired(
    stamps_ns: NDArray[np.int64], estimate_m: Array, true_m: Array, std_m: Array, valid: NDArray[np.bool_]
) -> Pairs:
    kept = valid & np.isfinite(true_m) & np.isfinite(estimate_m)
    return Pairs(stamps_ns[kept], estimate_m[kept], true_m[kept], std_m[kept])


def _column(values: Iterable[float | None]) -> Array:
    return np.array([np.nan if value is None else value for value in values], np.float64)


def pooled(parts: Sequence[Pairs]) -> Pairs:
    """The pairs of several recordings: every frame counts the same."""
    return Pairs(
        np.concatenate([part.stamps_ns for part in parts]),
        np.concatenate([part.estimate_m for part in parts]),
        np.concatenate([part.truth_m for part in parts]),
        np.concatenate([part.std_m for part in parts]),
    )


def score_pairs(pairs: Pairs) -> DistanceScore | None:
    """The figures of pairs; None for no pairs."""
    statistics = error_statistics(pairs.estimate_m, pairs.truth_m)
    return DistanceScore(statistics, pairs.interval_coverage, pairs) if statistics else None


def pooled_score(parts: Sequence[DistanceScore | None]) -> DistanceScore | None:
    """The figures of several recordings together; None where none has any."""
    known = [part.pairs for part in parts if part]
    return score_pairs(pooled(known)) if known else None

"""Rows to arrays, and the three distances of rows paired with their truth: the figures of such pairs."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from svmdist.metrics import ErrorStatistics, error_statistics, interval_coverage
from svmdist.results import Distance as ResultDistance
from svmdist.results import Distances, FrameResult
from svmdist.tracks import SampledDistances
from svmdist.transforms import Array


@dataclass(frozen=True, slots=True)
class Distance:
    """One of the three distances: its value and standard deviation in a row, and its truth, all in m."""

    name: str
    of: Callable[[Distances], ResultDistance | None]
    truth_of: Callable[[SampledDistances], Array]

    def read(self, result: FrameResult) -> tuple[float, float]:
        """Value and standard deviation in m of a result; NaN where it has none."""
        found = self.of(result.distances)
        if found is None:
            return np.nan, np.nan
        return found.value_m, np.nan if found.std_m is None else found.std_m


PLANAR = Distance("planar", lambda found: found.planar, lambda truth: truth.planar_m)
SPATIAL = Distance("spatial", lambda found: found.spatial, lambda truth: truth.spatial_m)
CLEARANCE = Distance("clearance", lambda found: found.clearance, lambda truth: truth.clearance_m)
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


class Readings:
    """The numbers that scoring takes from rows, collected while they come: 72 bytes a row.

    This class and `DISTANCES` are all of the scoring that knows the fields of a row.
    """

    def __init__(self, rows: Iterable[FrameResult] = (), distances: tuple[Distance, ...] = DISTANCES) -> None:
        self._distances = distances
        self._stamps_ns = array("q")
        self._numbers = array("d")
        self.rejected: Counter[str] = Counter()
        for row in rows:
            self.add(row)

    def __len__(self) -> int:
        """Count the rows."""
        return len(self._stamps_ns)

    def add(self, row: FrameResult) -> None:
        """Take the tool's pixel and each distance out of a row; what it does not have is NaN."""
        self._stamps_ns.append(row.stamp_ns)
        numbers = [*(row.image.tool_px or (np.nan, np.nan))]
        for distance in self._distances:
            numbers += distance.read(row)
        if not row.measured:
            self.rejected[str(row.status)] += 1
            numbers = [np.nan] * len(numbers)
        self._numbers.extend(numbers)

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """The stamps of the rows, shape (n,)."""
        return np.array(self._stamps_ns, np.int64)

    @property
    def tool_px(self) -> Array:
        """Where the tool was seen, shape (n, 2); NaN where it was not."""
        return self._table[:, 0]

    def pairs(
        self, distance: Distance, truth: SampledDistances, stamps_ns: NDArray[np.int64] | None = None
    ) -> Pairs:
        """Pair one distance with its truth at the rows' stamps, or at others, shape (n,); pairs without a value go."""
        estimate_m, std_m = self._table[:, 1 + self._distances.index(distance)].T
        truth_m = distance.truth_of(truth)
        kept = truth.valid & np.isfinite(truth_m) & np.isfinite(estimate_m)
        at_ns = self.stamps_ns if stamps_ns is None else stamps_ns
        return Pairs(at_ns[kept], estimate_m[kept], truth_m[kept], std_m[kept])

    @property
    def _table(self) -> Array:
        """Pairs of numbers, shape (n, 1 + distances, 2): the tool's pixel, then value and deviation."""
        return np.array(self._numbers, np.float64).reshape(-1, 1 + len(self._distances), 2)


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

"""How good estimates and alarms are against a reference: arrays in, figures out; and the columns that show them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import astuple, dataclass
from functools import reduce
from operator import add
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from svmdist.errors import printable
from svmdist.tracks import Mask
from svmdist.transforms import Array


@dataclass(frozen=True, slots=True)
class Unit:
    """Unit of a value, and how a person is shown it: times `factor` with so many digits; as it is without digits."""

    name: str = ""
    factor: float = 1.0
    digits: int | None = None


TEXT, COUNT = Unit("text"), Unit()
RATIO, SHARE = Unit("1", digits=4), Unit("1", 100.0, 1)
LENGTH, SPEED = Unit("m", 1e3, 2), Unit("m/s", 1e3, 1)
DEGREES = Unit("rad", 180.0 / np.pi, 2)
PIXELS, SECONDS, RADIANS = Unit("px", digits=1), Unit("s", digits=2), Unit("rad", digits=4)


Cell = str | int | float | None


@dataclass(frozen=True, slots=True)
class Column:
    """One column: `key` in machine output, in SI; `heading` in a readable table, in the unit shown there.

    `of` reads the value from a row's source: a function, or a path of attributes and indices; by default the key.
    Without a heading it is for machines only, not `stored` for readable tables only. `field` is its name in
    `svmdist.DistanceEstimate`, `width` the least in a plain table, in characters. docs/metrics.md says what it means.
    """

    key: str
    unit: Unit = COUNT
    heading: str = ""
    of: Callable[[Any], Cell] | str = ""
    field: str = ""
    width: int = 0
    stored: bool = True

    def value(self, source: Any) -> Cell:
        """The value of a row's source; None where its path leads nowhere."""
        if callable(self.of):
            return self.of(source)
        for step in (self.of or self.key).split("."):
            if source is None:
                return None
            source = source[int(step)] if step.isdecimal() else getattr(source, step)
        return float(source) if isinstance(source, float) else source

    def show(self, value: Cell) -> str:
        """The readable value; a number that does not exist is a dash."""
        value = finite(value)
        if self.is_text or isinstance(value, str):
            return printable("" if value is None else str(value))
        if value is None:
            return "–"
        return str(value) if self.unit.digits is None else f"{value * self.unit.factor:z.{self.unit.digits}f}"

    @property
    def is_text(self) -> bool:
        """Whether the column is text, flush left."""
        return self.unit is TEXT


def row_of(columns: Iterable[Column], source: Any) -> dict[str, Cell]:
    """The row of a source."""
    return {column.key: column.value(source) for column in columns}


def finite(value: Cell) -> Cell:
    """The value; None for a number that is not finite, which no format for machines can hold."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


@dataclass(frozen=True, slots=True)
class Interval:
    """The bounds of a 95 % bootstrap interval."""

    low: float
    high: float


class Intervals(NamedTuple):
    """The intervals of RMSE and of R²; None where there is none."""

    rmse: Interval | None
    r_squared: Interval | None


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """Error figures of n pairs in the unit of the input; R² and Pearson's r are None where a side does not vary.

    R² is that of eq. (36) as a fraction, 1 - SS_res / SS_tot against the identity line, and can be negative. It grows
    with the range of motion alone: it never stands without RMSE and the truth's standard deviation.
    """

    count: int
    r_squared: float | None
    rmse: float
    mae: float
    median_abs_error: float
    p95_abs_error: float
    max_abs_error: float
    bias: float
    truth_std: float
    pearson_r: float | None


def error_statistics(estimate: ArrayLike, truth: ArrayLike) -> ErrorStatistics | None:
    """All figures of pairs of estimate and truth, both of shape (n,); None for no pairs."""
    f, y = np.asarray(estimate, np.float64), np.asarray(truth, np.float64)
    if f.shape != y.shape or f.ndim != 1:
        raise ValueError(f"expected two arrays of the same shape (n,), found {f.shape} and {y.shape}")
    if len(f) == 0:
        return None
    error = f - y
    magnitude = np.abs(error)
    r_squared = pearson_r = None
    if _varies(y):
        r_squared = 1.0 - float(np.sum(error**2)) / float(np.sum((y - y.mean()) ** 2))
        pearson_r = float(np.corrcoef(f, y)[0, 1]) if _varies(f) else None
    return ErrorStatistics(
        count=len(f),
        r_squared=r_squared,
        rmse=float(np.sqrt(np.mean(error**2))),
        mae=float(magnitude.mean()),
        median_abs_error=float(np.median(magnitude)),
        p95_abs_error=float(np.percentile(magnitude, 95)),
        max_abs_error=float(magnitude.max()),
        bias=float(error.mean()),
        truth_std=float(y.std()),
        pearson_r=pearson_r,
    )


def bootstrap_intervals(
    estimate: ArrayLike, truth: ArrayLike, seed: int, resamples: int = 1000, block: int | None = None
) -> Intervals:
    """Percentile intervals of RMSE and of R² by a moving-block bootstrap (Künsch 1989).

    Errors of neighbouring frames are correlated, so that drawing single frames gives too narrow an interval: whole
    blocks are resampled, of length n^(1/3) rounded up unless given. None for fewer than eight pairs; the R² interval is
    None where R² is undefined, for the pairs or for every resample.
    """
    f, y = np.asarray(estimate, np.float64), np.asarray(truth, np.float64)
    if (n := len(f)) < 8:
        return Intervals(None, None)
    block = block or int(np.ceil(n ** (1.0 / 3.0)))
    starts = np.random.default_rng(seed).integers(0, n - block + 1, size=(resamples, -(-n // block)))
    index = (starts[:, :, None] + np.arange(block)).reshape(resamples, -1)[:, :n]
    errors, truths = (f - y)[index], y[index]
    squares = np.sum(errors**2, axis=1)
    rmse = _interval(np.sqrt(squares / n))
    if not _varies(y):
        return Intervals(rmse, None)
    totals = np.sum((truths - truths.mean(1, keepdims=True)) ** 2, axis=1)
    usable = totals > 1e-12 * float(np.sum((y - y.mean()) ** 2))
    r2 = 1.0 - squares[usable] / totals[usable]
    return Intervals(rmse, _interval(r2) if len(r2) else None)


def interval_coverage(estimate: Array, truth: Array, std: Array, level: float = 0.95) -> float | None:
    """Share of truths inside estimate ± z std, which should equal the level; None for no pairs."""
    z = NormalDist().inv_cdf(0.5 + level / 2.0)
    return float(np.mean(np.abs(estimate - truth) <= z * std)) if len(estimate) else None


def _interval(values: Array) -> Interval:
    low, high = np.percentile(values, [2.5, 97.5])
    return Interval(float(low), float(high))


def _varies(values: Array) -> bool:
    """Whether values, at least two, differ by more than rounding."""
    return len(values) > 1 and bool(np.ptp(values) > 1e-12 * max(1.0, float(np.abs(values).max())))


@dataclass(frozen=True, slots=True)
class AlarmStatistics:
    """Counts of alarms against truth, and figures of them, which are None where they are undefined.

    A frame is unsafe where its true clearance is below the threshold. `unjudged_count` of the frames had no clearance,
    and so no alarm; `unsafe_unjudged_count` of these are unsafe, and count as missed. `lead_times_s`: for each time the
    truth falls below the threshold, how long before it the alarm was raised without a break, over safe frames; negative
    where it came late, and nothing for one that was missed.
    """

    frame_count: int
    unsafe_count: int
    true_alarm_count: int
    false_alarm_count: int
    unjudged_count: int
    unsafe_unjudged_count: int
    false_alarm_episode_count: int
    duration_s: float
    event_count: int
    lead_times_s: tuple[float, ...]

    @property
    def precision(self) -> float | None:
        """Share of the alarmed frames that were unsafe."""
        return _share(self.true_alarm_count, self.true_alarm_count + self.false_alarm_count)

    @property
    def recall(self) -> float | None:
        """Share of the unsafe frames that were alarmed."""
        return _share(self.true_alarm_count, self.unsafe_count)

    @property
    def false_alarm_fraction(self) -> float | None:
        """Share of the safe frames that were alarmed."""
        return _share(self.false_alarm_count, self.frame_count - self.unsafe_count)

    @property
    def false_alarms_per_minute(self) -> float | None:
        """Stretches of alarmed frames without any unsafe frame, per minute of recording."""
        return _share(self.false_alarm_episode_count * 60.0, self.duration_s)

    @property
    def missed_event_count(self) -> int:
        """Events in which no alarm was raised at all."""
        return self.event_count - len(self.lead_times_s)

    @property
    def median_lead_s(self) -> float | None:
        """The lead time of the middle event."""
        return float(np.median(self.lead_times_s)) if self.lead_times_s else None

    @property
    def min_lead_s(self) -> float | None:
        """The shortest lead time; negative where an alarm came late."""
        return min(self.lead_times_s, default=None)


def alarm_statistics(
    stamps_s: ArrayLike, alarms: ArrayLike, clearance_m: ArrayLike, below_m: float, judged: ArrayLike | None = None
) -> AlarmStatistics:
    """Score alarms, bool of shape (n,) at sorted stamps in s, against the true clearance in m, shape (n,).

    `judged`, bool of shape (n,), says which frames had a clearance estimate; all where None. A false alarm is an
    unbroken stretch of alarmed frames none of which is unsafe: one that leads into an unsafe stretch is timely, though
    its safe frames count as alarmed. An event is an unbroken stretch of unsafe frames that begins inside the recording.
    """
    t, c = np.asarray(stamps_s, np.float64), np.asarray(clearance_m, np.float64)
    a = np.asarray(alarms, np.bool_)
    known = np.ones(a.shape, np.bool_) if judged is None else np.asarray(judged, np.bool_)
    shapes = t.shape, a.shape, c.shape, known.shape
    if len(set(shapes)) > 1 or t.ndim != 1:
        raise ValueError(f"expected arrays of the same shape (n,), found {', '.join(map(str, shapes))}")
    unsafe = c < below_m
    events = [(begin, end) for begin, end in runs(unsafe) if begin > 0]
    leads_s = []
    raised_before = {end: begin for begin, end in runs(a & ~unsafe)}  # over the safe frames that end there
    for begin, end in events:
        if a[begin:end].any():
            first = begin + int(np.argmax(a[begin:end]))
            leads_s.append(float(t[begin] - t[raised_before.get(first, first)]))
    return AlarmStatistics(
        frame_count=len(t),
        unsafe_count=int(np.count_nonzero(unsafe)),
        true_alarm_count=int(np.count_nonzero(a & unsafe)),
        false_alarm_count=int(np.count_nonzero(a & ~unsafe)),
        unjudged_count=int(np.count_nonzero(~known)),
        unsafe_unjudged_count=int(np.count_nonzero(unsafe & ~known)),
        false_alarm_episode_count=sum(not unsafe[begin:end].any() for begin, end in runs(a)),
        duration_s=float(t[-1] - t[0]) if len(t) else 0.0,
        event_count=len(events),
        lead_times_s=tuple(leads_s),
    )


def pooled_alarms(parts: Sequence[AlarmStatistics]) -> AlarmStatistics:
    """The statistics of several recordings together: counts and durations add up."""
    none = AlarmStatistics(0, 0, 0, 0, 0, 0, 0, 0.0, 0, ())
    return AlarmStatistics(*(reduce(add, column) for column in zip(*map(astuple, (none, *parts)), strict=True)))


def runs(chosen: Mask) -> list[tuple[int, int]]:
    """First index, and index after the last one, of each run of true values, shape (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _share(count: float, of: float) -> float | None:
    return count / of if of else None

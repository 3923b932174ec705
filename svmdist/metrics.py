"""Numbers in, numbers out: how good estimates are against a reference."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svmdist.transforms import Array

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Interval:
    """A bootstrap interval: its bounds and its level."""

    low: float
    high: float
    level: float = 0.95


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """Error figures of n pairs, in the unit of the input.

    R² and Pearson's r are None where they are undefined: with fewer than two pairs, or a reference (for
    r also an estimate) that does not vary.
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


def r_squared(estimate: ArrayLike, truth: ArrayLike) -> float | None:
    """R² of eq. (36) as a fraction: 1 - SS_res / SS_tot against the identity line.

    It can be negative, and it grows with the range of motion alone: it never stands without RMSE and
    the truth's standard deviation. None where the truth does not vary.
    """
    f, y = np.asarray(estimate, np.float64), np.asarray(truth, np.float64)
    total = float(np.sum((y - y.mean()) ** 2)) if len(y) else 0.0
    if len(y) < 2 or not _varies(y):
        return None
    return 1.0 - float(np.sum((f - y) ** 2)) / total


def pearson_r(estimate: ArrayLike, truth: ArrayLike) -> float | None:
    """Pearson's correlation; None where either side does not vary."""
    f, y = np.asarray(estimate, np.float64), np.asarray(truth, np.float64)
    if len(y) < 2 or not _varies(y) or not _varies(f):
        return None
    f, y = f - f.mean(), y - y.mean()
    return float(np.clip(np.sum(f * y) / np.sqrt(np.sum(f * f) * np.sum(y * y)), -1.0, 1.0))


def error_statistics(estimate: ArrayLike, truth: ArrayLike) -> ErrorStatistics | None:
    """All figures of pairs of estimate and truth, both of shape (n,); None for no pairs."""
    f, y = np.asarray(estimate, np.float64), np.asarray(truth, np.float64)
    if f.shape != y.shape or f.ndim != 1:
        raise ValueError(f"expected two arrays of the same shape (n,), found {f.shape} and {y.shape}")
    if len(f) == 0:
        return None
    error = f - y
    magnitude = np.abs(error)
    return ErrorStatistics(
        count=len(f),
        r_squared=r_squared(f, y),
        rmse=float(np.sqrt(np.mean(error**2))),
        mae=float(magnitude.mean()),
        median_abs_error=float(np.median(magnitude)),
        p95_abs_error=float(np.percentile(magnitude, 95)),
        max_abs_error=float(magnitude.max()),
        bias=float(error.mean()),
        truth_std=float(y.std()),
        pearson_r=pearson_r(f, y),
    )


def bootstrap_intervals(
    estimate: ArrayLike,
    truth: ArrayLike,
    seed: int,
    resamples: int = 1000,
    level: float = 0.95,
    block: int | None = None,
) -> tuple[Interval | None, Interval | None]:
    """Percentile intervals of RMSE and of R² by a moving-block bootstrap (Künsch 1989).

    Neighbouring frames of a video err alike; drawing them one by one would promise too narrow an
    interval, so whole blocks are drawn, of length n^(1/3) rounded up unless given. None where there are
    fewer than eight pairs; the R² interval is None where R² is undefined, for the pairs or for every
    resample.
    """
    f, y = np.asarray(estimate, np.float64), np.asarray(truth, np.float64)
    n = len(f)
    if n < 8:
        return None, None
    block = block or int(np.ceil(n ** (1.0 / 3.0)))
    rng = np.random.default_rng(seed)
    starts = rng.integers(0, n - block + 1, size=(resamples, -(-n // block)))
    index = (starts[:, :, None] + np.arange(block)).reshape(resamples, -1)[:, :n]
    errors, truths = (f - y)[index], y[index]
    squares = np.sum(errors**2, axis=1)
    rmse = _interval(np.sqrt(squares / n), level)
    if not _varies(y):
        return rmse, None
    totals = np.sum((truths - truths.mean(1, keepdims=True)) ** 2, axis=1)
    usable = totals > 1e-12 * float(np.sum((y - y.mean()) ** 2))
    r2 = 1.0 - squares[usable] / totals[usable]
    return rmse, _interval(r2, level) if len(r2) else None


def interval_coverage(
    estimate: ArrayLike, truth: ArrayLike, std: ArrayLike, level: float = 0.95
) -> float | None:
    """Share of truths inside the normal interval estimate ± z std of a level; None for no pairs.

    An honest 95 % interval holds 95 % of the truths: fewer, and the deviation is too small; all of them,
    and it says nothing.
    """
    f, y, s = (np.asarray(values, np.float64) for values in (estimate, truth, std))
    if len(f) == 0:
        return None
    z = NormalDist().inv_cdf(0.5 + level / 2.0)
    return float(np.mean(np.abs(f - y) <= z * s))


def coverage(measured: int, frames: int) -> float:
    """Measured frames per frame; 0 for no frames."""
    return measured / frames if frames else 0.0


def _interval(values: Array, level: float) -> Interval:
    low, high = np.percentile(values, [50.0 * (1.0 - level), 50.0 * (1.0 + level)])
    return Interval(float(low), float(high), level)


def _varies(values: Array) -> bool:
    """Whether values differ by more than rounding."""
    return bool(np.ptp(values) > 1e-12 * max(1.0, float(np.abs(values).max())))


@dataclass(frozen=True, slots=True)
class AlarmStatistics:
    """How alarms fare against truth; a figure is None where nothing could show it.

    `lead_times_s` holds, for each time the truth falls below the threshold, how long before it the alarm was
    raised without a break; negative where it came late, and nothing for one that was missed.
    """

    frame_count: int
    unsafe_count: int
    precision: float | None
    recall: float | None
    false_alarm_fraction: float | None
    false_alarms_per_minute: float | None
    event_count: int
    lead_times_s: tuple[float, ...]


def alarm_statistics(
    stamps_s: ArrayLike, alarms: ArrayLike, clearance_m: ArrayLike, below_m: float
) -> AlarmStatistics:
    """Score alarms, bool of shape (n,) at sorted stamps in s, against the true clearance in m, shape (n,).

    A false alarm that lasts is one: it is counted where it begins. An event is an unbroken stretch of
    unsafe frames that begins inside the recording.
    """
    t, a, c = (
        np.asarray(stamps_s, np.float64),
        np.asarray(alarms, np.bool_),
        np.asarray(clearance_m, np.float64),
    )
    if not t.shape == a.shape == c.shape or t.ndim != 1:
        raise ValueError(
            f"expected three arrays of the same shape (n,), found {t.shape}, {a.shape}, {c.shape}"
        )
    unsafe = c < below_m
    false = a & ~unsafe
    true_count, unsafe_count = int(np.count_nonzero(a & unsafe)), int(np.count_nonzero(unsafe))
    safe_count = len(a) - unsafe_count
    alarm_count = int(np.count_nonzero(a))
    minutes = (t[-1] - t[0]) / 60.0 if len(t) > 1 else 0.0
    began = false & ~np.concatenate([[False], a[:-1]]) if len(a) else false
    events = [index for index in range(1, len(t)) if unsafe[index] and not unsafe[index - 1]]
    leads = [_lead_time_s(t, a, unsafe, event) for event in events]
    return AlarmStatistics(
        frame_count=len(t),
        unsafe_count=unsafe_count,
        precision=true_count / alarm_count if alarm_count else None,
        recall=true_count / unsafe_count if unsafe_count else None,
        false_alarm_fraction=int(np.count_nonzero(false)) / safe_count if safe_count else None,
        false_alarms_per_minute=int(np.count_nonzero(began)) / minutes if minutes > 0 else None,
        event_count=len(events),
        lead_times_s=tuple(lead for lead in leads if lead is not None),
    )


def _lead_time_s(t: Array, alarms: Mask, unsafe: Mask, event: int) -> float | None:
    """How long before an event its alarm began; None where none came while it lasted."""
    if alarms[event]:
        first = event
        while first > 0 and alarms[first - 1]:
            first -= 1
        return float(t[event] - t[first])
    for index in range(event, len(t)):
        if not unsafe[index]:
            return None
        if alarms[index]:
            return float(t[event] - t[index])
    return None

"""Numbers in, numbers out: how good estimates are against a reference."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

from svmdist.transforms import Array


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
    return float(np.mean(np.abs(f - y) <= deviations_at(level) * s))


def deviations_at(level: float) -> float:
    """How many standard deviations a normal interval of a level reaches to either side: 1.96 at 0.95."""
    return NormalDist().inv_cdf(0.5 + level / 2.0)


def coverage(measured: int, frames: int) -> float:
    """Measured frames per frame; 0 for no frames."""
    return measured / frames if frames else 0.0


def _interval(values: Array, level: float) -> Interval:
    low, high = np.percentile(values, [50.0 * (1.0 - level), 50.0 * (1.0 + level)])
    return Interval(float(low), float(high), level)


def _varies(values: Array) -> bool:
    """Whether values differ by more than rounding."""
    return bool(np.ptp(values) > 1e-12 * max(1.0, float(np.abs(values).max())))

"""What plots and pages take from series alike: names, spans that were not measured, pooled errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from svmdist.metrics import interval_coverage
from svmdist.transforms import Array
from svmdist.workflows.series import Series

LEVELS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
"""Levels of intervals whose honesty is shown."""
MAX_GAP_IN_STEPS = 3.0
"""A curve is broken where frames are missing for longer than this many frame periods."""


def distance_name(series: Series) -> str:
    """The series' distance in words."""
    return series.distance if series.distance == "clearance" else f"{series.distance} distance"


def rejected_spans(series: Series) -> list[tuple[float, float]]:
    """Beginning and end in s of each run of frames without the distance, half a frame wider on both sides."""
    if len(series) == 0:
        return []
    lost = ~series.measured
    step_s = float(np.median(np.diff(series.seconds))) if len(series) > 1 else 0.1
    edges = np.flatnonzero(np.diff(np.concatenate([[False], lost, [False]]).astype(int)))
    return [
        (
            round(float(series.seconds[begin]) - 0.5 * step_s, 3),
            round(float(series.seconds[end - 1]) + 0.5 * step_s, 3),
        )
        for begin, end in zip(edges[::2], edges[1::2], strict=True)
    ]


def pooled(series: Sequence[Series]) -> tuple[Array, Array, Array]:
    """Truth, error and deviation in mm of all frames that have an error."""
    truth_m, error_m, std_m = (
        np.concatenate([getattr(one, key) for one in series]) for key in ("truth_m", "error_m", "std_m")
    )
    kept = np.isfinite(error_m)
    return truth_m[kept] * 1e3, error_m[kept] * 1e3, std_m[kept] * 1e3


def held_shares(series: Sequence[Series]) -> tuple[list[float], int]:
    """Shares in % of truths inside the intervals of `LEVELS`, and of how many frames that state a deviation."""
    truth_mm, error_mm, std_mm = pooled(series)
    stated = np.isfinite(std_mm)
    estimate_mm, truth_mm, std_mm = (truth_mm + error_mm)[stated], truth_mm[stated], std_mm[stated]
    held = [100.0 * (interval_coverage(estimate_mm, truth_mm, std_mm, level) or 0.0) for level in LEVELS]
    return held, int(stated.sum())


def with_breaks(seconds: Array, *curves: Array) -> tuple[Array, ...]:
    """Put a NaN between frames that are far apart, so that no line spans what was not measured."""
    if len(seconds) < 3:
        return seconds, *curves
    steps = np.diff(seconds)
    at = np.flatnonzero(steps > MAX_GAP_IN_STEPS * np.median(steps)) + 1
    return tuple(np.insert(values, at, np.nan) for values in (seconds, *curves))

"""Robust statistics that fits share: a median that is quick on few values, the spread it gives, Huber's weights."""

from __future__ import annotations

import numpy as np

from svmdist.transforms import Array


def median(values: Array) -> float:
    """The median of values, shape (n,), as NumPy's, which takes four times as long on a few hundred; NaN of none."""
    if not len(values):
        return float("nan")
    ordered = np.sort(values)
    if np.isnan(ordered[-1]):
        return float("nan")
    middle = len(ordered) // 2
    return float(ordered[middle] if len(ordered) % 2 else 0.5 * (ordered[middle - 1] + ordered[middle]))


def scale_of(values: Array) -> float:
    """Standard deviation of values about zero, shape (n,), that half of them may spoil: 1.4826 times the median."""
    return 1.4826 * median(np.abs(values))


def huber_weights(deviation: Array, bound: Array | float) -> Array:
    """Weights, shape (n,), of deviations: those beyond the bound, in the same unit, count singly (Huber 1964)."""
    return np.minimum(1.0, bound / np.maximum(np.abs(deviation), 1e-12))

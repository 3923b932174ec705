"""Robust losses of squared deviations over the gate's bound: the cost over the bound, and the weight."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from svmdist.transforms import Array

Loss = Callable[[Array], tuple[Array, Array]]


def huber(deviation: Array) -> tuple[Array, Array]:
    """Squares within the bound, straight on beyond it (Huber 1964)."""
    root = np.sqrt(np.maximum(deviation, 1.0))
    return np.where(deviation <= 1.0, deviation, 2.0 * root - 1.0), 1.0 / root


def geman_mcclure(deviation: Array) -> tuple[Array, Array]:
    """Squares near zero, bounded far out (Geman and McClure 1987); half the bound's full height at four bounds."""
    height = 1.0 + 0.25 * deviation
    return deviation / height, 1.0 / height**2

"""Robust statistics, and nonlinear least squares on any state: Gauss–Newton, damped after Levenberg and Marquardt.

Triggs et al. 2000, "Bundle Adjustment: A Modern Synthesis", secs. 2.2 and 4, has the method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from svmdist.transforms import Array


def median(values: Array) -> float:
    """The median of values, shape (n,); NaN of none."""
    if not (count := len(values)):
        return float("nan")
    low, high = (count - 1) // 2, count // 2
    in_order = np.partition(values, (low, high, count - 1))  # a tenth of the time of NumPy's own
    return float("nan") if np.isnan(in_order[-1]) else float(0.5 * (in_order[low] + in_order[high]))


def scale_of(values: Array) -> float:
    """Standard deviation of values about zero, shape (n,), that half of them may spoil: 1.4826 times the median."""
    return 1.4826 * median(np.abs(values))


def huber_weights(deviation: Array, bound: Array | float) -> Array:
    """Weights, shape (n,), of deviations: those beyond the bound, in the same unit, count singly (Huber 1964)."""
    return np.minimum(1.0, bound / np.maximum(np.abs(deviation), 1e-12))


@dataclass(frozen=True, slots=True)
class NormalEquations:
    """A problem's cost, gradient Jᵀ W r, shape (n,), and information Jᵀ W J, (n, n); r is measured minus predicted."""

    cost: float
    gradient: Array
    information: Array

    @property
    def is_finite(self) -> bool:
        """Whether a step can be computed from them."""
        return all(np.isfinite(part).all() for part in (self.cost, self.gradient, self.information))


State = TypeVar("State")
Equations = TypeVar("Equations", bound=NormalEquations)


def minimise(
    start: State,
    linearise: Callable[[State], Equations | None],
    retract: Callable[[State, Array], State],
    max_steps: int,
    tolerance: float,
    damping: float,
) -> tuple[State, Equations] | None:
    """The state that is reached from a start, and the equations there; None where they are undefined at the start.

    `linearise` gives None, or what is not finite, for a state where the problem is undefined; `retract` applies a step
    of the state's tangent space. Steps are damped in proportion to the information's diagonal, more where one would
    raise the cost or lead to such a state, which is not taken, and less after each that is. It ends with a step whose
    largest element is below `tolerance`.
    """
    state, equations = start, linearise(start)
    if equations is None or not equations.is_finite:
        return None
    for _ in range(max_steps):
        information = equations.information + damping * np.diag(np.diag(equations.information))
        try:
            step = np.asarray(np.linalg.solve(information, equations.gradient), np.float64)
        except np.linalg.LinAlgError:
            step = np.asarray(np.linalg.lstsq(information, equations.gradient, rcond=None)[0], np.float64)
        moved = retract(state, step)
        trial = linearise(moved)
        if trial is not None and trial.is_finite and trial.cost <= equations.cost:
            state, equations, damping = moved, trial, max(0.1 * damping, 1e-9)
        else:
            damping *= 10.0
        if float(np.abs(step).max()) < tolerance:
            break
    return state, equations

"""Robust statistics, and nonlinear least squares on any state: Gauss–Newton, damped after Levenberg and Marquardt.

The state may be a pose or a correction: the problem linearises it into normal equations, `retract` applies a step of
its tangent space. Triggs et al. 2000, "Bundle Adjustment: A Modern Synthesis", secs. 2.2 and 4, has the method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

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


State = TypeVar("State")


@dataclass(frozen=True, slots=True)
class NormalEquations:
    """A problem about a state: its cost, gradient Jᵀ W r, shape (n,), and information Jᵀ W J, shape (n, n).

    The residual r is measured minus predicted, so that information⁻¹ · gradient is the step towards the minimum.
    """

    cost: float
    gradient: Array
    information: Array

    @property
    def is_finite(self) -> bool:
        """Whether a step can be computed from them."""
        return all(np.isfinite(part).all() for part in (self.cost, self.gradient, self.information))


@dataclass(frozen=True, slots=True)
class Minimum(Generic[State]):
    """The state that was reached, and the normal equations there."""

    state: State
    equations: NormalEquations


@dataclass(frozen=True, slots=True)
class Steps:
    """When to stop, and how steps are damped: in proportion to the information's diagonal; none may raise the cost."""

    max_steps: int
    settled: float = 0.0  # the largest element of a last step is below
    damping: float = 0.0


def minimise(
    start: State,
    linearise: Callable[[State], NormalEquations | None],
    retract: Callable[[State, Array], State],
    steps: Steps,
) -> Minimum[State] | None:
    """Minimise from a start; None where the problem cannot be linearised at the start itself.

    `linearise` gives None, or what is not finite, for a state where the problem is undefined: a damped iteration
    turns back from there, an undamped one ends with None.
    """
    equations = linearise(start)
    if equations is None or not equations.is_finite:
        return None
    state, damping = start, steps.damping
    for _ in range(steps.max_steps):
        step = _step(equations, damping)
        trial_state = retract(state, step)
        trial = linearise(trial_state)
        converged = float(np.abs(step).max()) < steps.settled
        if trial is not None and trial.is_finite and (steps.damping == 0.0 or trial.cost <= equations.cost):
            state, equations, damping = trial_state, trial, max(0.1 * damping, 1e-9 * bool(steps.damping))
        elif steps.damping == 0.0:
            return None
        else:
            damping *= 10.0
        if converged:
            break
    return Minimum(state, equations)


def _step(equations: NormalEquations, damping: float) -> Array:
    information = equations.information
    if damping > 0.0:
        information = information + damping * np.diag(np.diag(information))
    try:
        return np.asarray(np.linalg.solve(information, equations.gradient), np.float64)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(information, equations.gradient, rcond=None)[0], np.float64)

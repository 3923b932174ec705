"""The most probable state, given a prior and heavy-tailed measurements, from a start.

Maximum a posteriori by iterated, reweighted Gauss–Newton (Bell and Cathey 1993; Lange, Little and Taylor 1989 for
Student's t), so that no gate set before the fit rejects anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.estimation.instrument.consistency import NU, student_weight
from svmdist.estimation.instrument.measurement import LinkMeasurement
from svmdist.estimation.instrument.state import ErrorState
from svmdist.transforms import Array, inverse_right_jacobian

TURN = slice(3, 6)  # of a state: a rotation vector
MAX_ITERATIONS = 12
TOLERANCE = 1e-2  # of a standard deviation: a step of less has converged


@dataclass(frozen=True, slots=True)
class Solution:
    """The most probable change x of the state, derivatives and noise there, and statistics per measurement.

    `innovations` are normalised squares against prior and noise, `residuals` those that are left against noise alone,
    `weights` those of Student's t; `nis` is the square of all of them together.
    """

    x: Array
    H: Array
    R: Array
    innovations: Array
    residuals: Array
    weights: Array
    nis: float
    has_converged: bool


def most_probable(
    state: ErrorState,
    measurements: Sequence[LinkMeasurement],
    x: Array,
    *,
    is_robust: bool = True,
    is_tracking: bool = False,
) -> Solution | None:
    """The state that prior and heavy-tailed measurements make the most probable, from x; None where one is unseen.

    A tracked measurement is weighed by the worse of its first innovation and its last residual: an outlier
    remains one where biases and calibration parameters would fit it.
    """
    P, size = state.P, state.model.size
    degrees = np.array([len(measurement.covariance) for measurement in measurements])
    at_row = np.repeat(np.arange(len(degrees)), degrees)  # which measurement
    begins, own = np.cumsum(degrees) - degrees, at_row[:, None] == at_row
    noise = np.zeros(own.shape)
    noise[own] = np.concatenate([np.ravel(measurement.covariance) for measurement in measurements])
    places = {measurement.name: at for at, measurement in enumerate(measurements)}
    rests = [[places[name] for name in measurement.rests_on if name in places] for measurement in measurements]
    certainty, deviations, moved = np.linalg.inv(noise), np.sqrt(np.diag(P) + 1e-18), np.inf
    weights, first = np.ones(len(degrees)), np.zeros(0)
    found: Solution | None = None
    for _ in range(MAX_ITERATIONS):
        there = state.retracted(x)
        parts = there.linearise(measurements)
        there_H = state.full_jacobian(parts)
        residual = np.concatenate([part.residual for part in parts]) - there_H[:, size:] @ there.bias_mean
        H = by_state(there_H, x)
        if not (np.isfinite(residual).all() and np.isfinite(H).all()):
            return None
        innovation = residual + H @ x
        # Solved with a unit-free H P: the units of the state differ by orders of magnitude.
        HP = H @ P
        S = HP @ H.T
        of_rows = innovation * np.linalg.solve(np.where(own, S, 0.0) + noise, innovation)
        innovations = np.add.reduceat(of_rows, begins)
        residuals = np.add.reduceat(residual * (certainty @ residual), begins)
        first = first if len(first) else innovations
        before = first if is_tracking else innovations
        if is_robust:
            weights = student_weight(np.maximum(before, residuals), degrees)
            for at, others in enumerate(rests):
                if others:
                    weights[at] = min(weights[at], weights[others].max())
        R = noise / weights[at_row]
        solved = np.linalg.solve(S + R, np.column_stack([HP, innovation]))
        K = np.asarray(solved[:, :-1].T, np.float64)
        step = K @ innovation - x
        # In deviations of the prior, and of what is measured: a prior that knows nothing has large ones.
        longer = float(max(np.max(np.abs(step) / deviations), np.max(np.abs(H @ step) / np.sqrt(np.diag(R)))))
        if longer > moved:  # it swings: half of the way
            step, longer = 0.5 * step, 0.5 * longer
        nis = float(innovation @ solved[:, -1])
        found = Solution(x + step, there_H, R, before, residuals, weights, nis, longer < TOLERANCE)
        if found.has_converged:
            break
        x, moved = x + step, longer
    return found


def by_state(H: Array, x: Array) -> Array:
    """Derivatives by a state x, (m, n), of those by what is added to it there."""
    if not x[TURN].any():
        return H
    by_x = H.copy()
    # A change of its rotation vector turns about another axis: by the left Jacobian, J_l(v) = J_r(-v).
    by_x[:, TURN] = H[:, TURN] @ np.linalg.inv(inverse_right_jacobian(-x[TURN]))
    return by_x


def robust_cost(found: Solution, measurements: Sequence[LinkMeasurement]) -> float:
    """Minus twice the logarithm of prior and heavy-tailed likelihood at a solution, but for constants."""
    fits = zip(found.residuals.tolist(), measurements, strict=True)
    of_prior = found.nis - float(found.weights @ found.residuals)
    return of_prior + sum(heavy_tailed(square, seen.covariance) for square, seen in fits)


def evidence(found: Solution, P: Array, measurements: Sequence[LinkMeasurement]) -> float:
    """Minus twice the logarithm of the measurements' probability under a prior (Laplace's approximation)."""
    logdet = np.linalg.slogdet(found.H @ P @ found.H.T + found.R)[1] - np.linalg.slogdet(found.R)[1]
    return robust_cost(found, measurements) + float(logdet)


def heavy_tailed(square: float, covariance: Array) -> float:
    """Minus twice the logarithm of Student's density, but for a constant."""
    size = len(covariance)
    return (NU + size) * float(np.log1p(square / NU)) + float(np.linalg.slogdet(covariance)[1])

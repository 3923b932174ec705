"""Least squares over residuals of a shaft's pose, some of which share the errors of constants."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from svmdist.estimation.shaft_pose.residuals import Residual, ShaftState
from svmdist.least_squares import NormalEquations
from svmdist.transforms import Array

MAX_TURN_RAD = 0.5
"""Of one step: beyond it the derivatives of the residuals say nothing."""


def normal_equations(found: Sequence[Residual]) -> NormalEquations:
    """Cost, gradient and information of all residuals about a state.

    Errors of constants are unknowns of variance one, solved for and left out: I + C Cᵀ in place of I.
    """
    r = np.concatenate([residual.whitened for residual in found])
    J = np.concatenate([residual.derivative for residual in found])
    C = by_constants(found)
    weighted = np.linalg.solve(np.eye(len(r)) + C @ C.T, np.column_stack([J, r]))
    return NormalEquations(float(r @ weighted[:, -1]), J.T @ weighted[:, -1], J.T @ weighted[:, :-1])


def normalised_square(residual: Residual) -> float:
    """The residual's normalised square, with what constants may do to it."""
    C = by_constants([residual])
    covariance = np.eye(len(residual.whitened)) + C @ C.T
    return float(residual.whitened @ np.linalg.solve(covariance, residual.whitened))


def retracted(state: ShaftState, step: Array) -> ShaftState:
    """The state after a step, shape (8,), shortened where it would turn the shaft too far."""
    turn_rad = float(np.linalg.norm(step[3:]))
    return state.retracted(step * min(1.0, MAX_TURN_RAD / max(turn_rad, 1e-12)))


def by_constants(found: Sequence[Residual]) -> Array:
    """Derivative of all residuals, one below the other, by every constant, shape (m, k): several may share one."""
    columns: dict[str, Array] = {}
    rows, at = sum(len(residual.whitened) for residual in found), 0
    for residual in found:
        after = at + len(residual.whitened)
        for bias in residual.constants:
            column = columns.setdefault(bias.name, np.zeros((rows, bias.jacobian.shape[-1])))
            column[at:after] += bias.jacobian
        at = after
    return np.concatenate([np.zeros((rows, 0)), *columns.values()], -1)

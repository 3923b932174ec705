"""The normal equations of a shaft's fit, against generalised least squares written out with SciPy's tools."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from svmdist.estimation.instrument.measurement import SharedBias
from svmdist.estimation.instrument.shaft_fit import (
    MAX_TURN_RAD,
    by_constants,
    normal_equations,
    normalised_square,
    retracted,
)
from svmdist.estimation.instrument.shaft_model import Residual, ShaftState
from svmdist.transforms import make_transform, rotation_vector

GENERATOR = np.random.default_rng(4)


def residual(name: str, size: int, *constants: str) -> Residual:
    """A residual of any numbers, on which the named constants act."""
    biases = tuple(SharedBias(constant, GENERATOR.normal(size=(size, 1))) for constant in constants)
    return Residual(name, GENERATOR.normal(size=size), GENERATOR.normal(size=(size, 8)), biases)


FOUND = [residual("edges", 4, "edge"), residual("rim", 3), residual("marker", 2, "edge", "focal")]


def test_a_constant_of_several_residuals_has_one_column() -> None:
    assert by_constants(FOUND).shape == (9, 2)
    assert np.all(by_constants(FOUND)[4:7] == 0.0)


def test_the_cost_is_that_of_correlated_residuals() -> None:
    C = by_constants(FOUND)
    density = multivariate_normal(np.zeros(9), np.eye(9) + C @ C.T)
    r = np.concatenate([one.whitened for one in FOUND])
    expected = -2 * (density.logpdf(r) - density.logpdf(np.zeros(9)))
    assert normal_equations(FOUND).cost == pytest.approx(expected)


def test_errors_of_constants_are_solved_for() -> None:
    """The information is that of a fit with the constants as unknowns of variance one, marginalised."""
    C = by_constants(FOUND)
    J = np.concatenate([one.derivative for one in FOUND])
    whole = np.column_stack([J, C])
    information = whole.T @ whole + np.diag([0.0] * 8 + [1.0] * 2)
    covariance = np.linalg.inv(information)[:8, :8]
    np.testing.assert_allclose(np.linalg.inv(normal_equations(FOUND).information), covariance, rtol=1e-6)


def test_the_normalised_square_is_mahalanobis() -> None:
    one = FOUND[2]
    C = by_constants([one])
    expected = one.whitened @ np.linalg.inv(np.eye(2) + C @ C.T) @ one.whitened
    assert normalised_square(one) == pytest.approx(expected)
    assert normalised_square(FOUND[1]) == pytest.approx(FOUND[1].whitened @ FOUND[1].whitened)


def test_a_step_turns_the_shaft_no_further_than_derivatives_say_anything() -> None:
    step = np.array([0.001, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0])
    state = retracted(ShaftState(make_transform(np.eye(3), np.zeros(3)), np.zeros(2)), step)
    assert np.linalg.norm(rotation_vector(state.T[:3, :3])) == pytest.approx(MAX_TURN_RAD)
    assert state.T[0, 3] == pytest.approx(0.001 * MAX_TURN_RAD / 2.0)

"""Robust statistics; and the minimiser finds known minima on vectors and rotations, and says where there is none."""

import math

import numpy as np
import pytest

from svmdist.least_squares import NormalEquations, huber_weights, median, minimise, scale_of
from svmdist.transforms import rotation_of, rotation_vector


def _rosenbrock(x):
    """The valley of Rosenbrock 1960 as residuals: 10 (y - x²) and 1 - x, with its minimum at (1, 1)."""
    residual = np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])
    J = -np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])
    return NormalEquations(float(residual @ residual), J.T @ residual, J.T @ J)


@pytest.mark.parametrize("damping", [1e-9, 1e-3], ids=["Gauss-Newton", "Levenberg-Marquardt"])
def test_rosenbrock(damping):
    start = np.array([-1.2, 1.0])
    x, there = minimise(start, _rosenbrock, np.add, max_steps=100, tolerance=1e-10, damping=damping)
    np.testing.assert_allclose(x, [1.0, 1.0], atol=1e-8)
    assert there.cost == _rosenbrock(x).cost


def test_a_step_to_where_a_problem_is_undefined_is_tried_again_shorter():
    def linearise(x):
        return _rosenbrock(x) if x[1] > -2.0 else None

    start = np.array([-1.2, 1.0])
    first = _rosenbrock(start)
    assert linearise(start + np.linalg.solve(first.information, first.gradient)) is None
    x, _ = minimise(start, linearise, np.add, max_steps=100, tolerance=1e-10, damping=1e-9)
    np.testing.assert_allclose(x, [1.0, 1.0], atol=1e-8)


def test_a_rotation_is_a_state():
    """Steps are taken in the tangent space: R ← exp([step]) R reaches the rotation that was measured."""
    R_true = rotation_of([0.9, -0.4, 1.3])

    def linearise(R):
        residual = rotation_vector(R_true @ R.T)
        return NormalEquations(float(residual @ residual), residual, np.eye(3))

    def turn(R, step):
        return rotation_of(step) @ R

    R, _ = minimise(np.eye(3), linearise, turn, max_steps=20, tolerance=1e-12, damping=1e-9)
    np.testing.assert_allclose(R, R_true, atol=1e-12)


def test_undefined_problems_have_no_minimum():
    for nowhere in (None, NormalEquations(np.inf, np.zeros(1), np.eye(1))):
        stop = {"max_steps": 5, "tolerance": 0.0, "damping": 1e-9}
        assert minimise(0.0, lambda _, found=nowhere: found, lambda x, s: x + s[0], **stop) is None


def test_weights_and_scale():
    np.testing.assert_allclose(huber_weights(np.array([0.0, 1.0, -6.0]), 3.0), [1.0, 1.0, 0.5])
    sample = np.random.default_rng(0).normal(0.0, 2.0, 20_000)
    sample[:4000] = 1e6
    assert scale_of(sample) == pytest.approx(2.0, rel=0.35)
    assert scale_of(sample[4000:]) == pytest.approx(2.0, rel=0.03)


@pytest.mark.parametrize("values", [[], [math.nan], [1.0, math.nan, 2.0]], ids=["none", "nan", "one nan"])
def test_what_has_no_median_gives_nan(values):
    assert math.isnan(median(np.array(values)))

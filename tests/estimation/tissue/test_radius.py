"""The normalised radius about an apex, and its derivative by the apex."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from svmdist.estimation.dome import DomeModel, PolarOutline

ANGLE = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
OUTLINE_M = np.stack([0.028 * np.cos(ANGLE) + 0.002 * np.cos(3.0 * ANGLE), 0.022 * np.sin(ANGLE)], -1)
APEX_M = np.array([0.003, -0.002])
STEP_M = 1e-6


def points(count: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.02, 0.02, (count, 2))


def test_the_outline_has_radius_one_and_the_apex_zero() -> None:
    polar = PolarOutline.about(APEX_M, OUTLINE_M)
    np.testing.assert_allclose(polar.normalised_radius(OUTLINE_M), 1.0, atol=1e-12)
    assert polar.normalised_radius(APEX_M[None])[0] == 0.0
    halfway = APEX_M + 0.5 * (OUTLINE_M - APEX_M)
    np.testing.assert_allclose(polar.normalised_radius(halfway), 0.5, atol=1e-12)


def test_reciprocal_lengths_run_linearly_with_the_angle() -> None:
    """As NumPy's periodic interpolation has it; angles and sums round at 1e-16 of numbers up to 2π and 50 / m."""
    polar, at = PolarOutline.about(APEX_M, OUTLINE_M), points(500)
    from_apex = at - APEX_M
    toward = np.arctan2(from_apex[:, 1], from_apex[:, 0])
    expected = np.interp(toward, polar.angle_rad, polar.reciprocal, period=2.0 * np.pi)
    found = polar.normalised_radius(at) / np.hypot(*from_apex.T)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_the_derivative_is_that_of_small_steps_of_the_apex() -> None:
    """Central differences of 1 µm are right within 1e-5 of it, except where a step takes a point past a corner."""
    at = points(300)
    radius, derivative = PolarOutline.about(APEX_M, OUTLINE_M).with_derivative(at)
    np.testing.assert_array_equal(radius, PolarOutline.about(APEX_M, OUTLINE_M).normalised_radius(at))
    for axis, step in enumerate(STEP_M * np.eye(2)):
        ahead, behind = (
            PolarOutline.about(APEX_M + s, OUTLINE_M).normalised_radius(at) for s in (step, -step)
        )
        close = np.isclose((ahead - behind) / (2.0 * STEP_M), derivative[:, axis], rtol=1e-5, atol=1e-3)
        assert close.mean() > 0.98


@pytest.mark.parametrize("exponents", [(2.0, 0.5), (2.3, 0.62), (1.0, 1.0)])
def test_a_dome_answers_to_its_shape_as_small_steps_tell(exponents: tuple[float, float]) -> None:
    dome = DomeModel(np.eye(4), OUTLINE_M, np.array([*APEX_M, 0.0083, *exponents]), np.eye(5))
    at = APEX_M + 0.9 * np.sqrt(np.random.default_rng(2).uniform(0.01, 1.0, (300, 1))) * (
        OUTLINE_M[np.random.default_rng(3).integers(0, 90, 300)] - APEX_M
    )
    at += 1e-5  # off the rays to the corners, where the derivative jumps
    derivative = dome.derivative(at)
    for column, step in enumerate(STEP_M * np.eye(5)):
        ahead, behind = (replace(dome, shape=dome.shape + s).height_m(at) for s in (step, -step))
        close = np.isclose((ahead - behind) / (2.0 * STEP_M), derivative[:, column], rtol=1e-4, atol=1e-5)
        assert close.mean() > 0.98
    np.testing.assert_array_equal(dome.derivative(np.array([[0.1, 0.0]]))[0], 0.0)
    assert np.isfinite(dome.derivative(APEX_M[None])).all()


def test_the_mesh_is_made_once() -> None:
    dome = DomeModel(np.eye(4), OUTLINE_M, np.array([0.0, 0.0, 0.008, 2.0, 0.5]), np.zeros((5, 5)))
    assert dome.mesh() is dome.mesh()
    lower = dome.shaped(np.array([0.0, 0.0, 0.007, 2.0, 0.5]), dome.covariance)
    assert lower.mesh().vertices_m[:, 2].max() == pytest.approx(0.007, abs=1e-15)
    assert lower.mesh().faces is dome.mesh().faces

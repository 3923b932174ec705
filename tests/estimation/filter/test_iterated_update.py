"""The iterated update: the minimum of prior and residuals, from the wrong depth too, and none behind the camera."""

from __future__ import annotations

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.instrument.error_model import ErrorModel
from svmdist.estimation.instrument.kinematic_error_filter import most_probable
from svmdist.estimation.instrument.measurement import LinkMeasurement
from svmdist.estimation.instrument.measurement_kinds import PointsMeasurement, SizeMeasurement
from svmdist.estimation.instrument.state import ErrorState
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.settings import FilterSettings
from svmdist.transforms import Array, inverse, make_transform, rotation_of
from tests.shipped import CHAIN, POSTURE, PROFILE

CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
SETTINGS = FilterSettings()
TOOL_M = np.array([0.01, -0.006, 0.1])


def started(tool_m: Array) -> ErrorState:
    """The state of a robot that believes its tool at a place in the camera frame."""
    at_origin = RobotState(CHAIN, 0, POSTURE, np.eye(4))
    T_camera_tool = make_transform(rotation_of([0.3, 2.8, 0.2]), tool_m)
    state = ErrorState(ErrorModel(CHAIN, PROFILE.kinematic_error))
    state.go_to(RobotState(CHAIN, 0, POSTURE, T_camera_tool @ inverse(at_origin.T_base_tool)))
    state.start()
    return state


def seen_at(tool_m: Array) -> list[LinkMeasurement]:
    """The marker's middle and its radius of a tool at a place."""
    pixel = CAMERA.project(tool_m)
    radius_px = float(CAMERA.K[0, 0] * 0.002 / tool_m[2])
    return [
        PointsMeasurement("p", None, CAMERA, np.zeros((1, 3)), pixel, 0.04 * np.eye(2)),
        SizeMeasurement("s", None, CAMERA, 0.002, radius_px, 0.01 * np.eye(1), 0.1),
    ]


def cost(state: ErrorState, measurements: list[LinkMeasurement], x: Array) -> float:
    """xᵀ P⁻¹ x + rᵀ R⁻¹ r at a change of the state."""
    there = state.retracted(x)
    parts = there.linearise(measurements)
    H = there.full_jacobian(parts)
    residual = np.concatenate([part.residual for part in parts]) - H[:, state.model.size :] @ there.bias_mean
    noise = np.concatenate([np.diag(part.noise) for part in parts])
    return float(x @ np.linalg.solve(state.P, x) + residual @ (residual / noise))


def test_it_ends_at_the_least_of_prior_and_residuals() -> None:
    """No small step from there has a lower cost, and the cost is what it states."""
    state, measurements = started(TOOL_M), seen_at(TOOL_M + np.array([0.002, 0.001, -0.003]))
    parts = state.linearise(measurements)
    state.augment_state(parts)
    found = most_probable(state, measurements, parts, SETTINGS)
    assert found is not None
    assert found.is_settled
    least = cost(state, measurements, found.x)
    np.testing.assert_allclose(found.nis, least, rtol=0.02)
    rng = np.random.default_rng(3)
    root = np.linalg.cholesky(state.P)
    for _ in range(50):
        step = 0.1 * root @ rng.normal(size=len(found.x))
        assert cost(state, measurements, found.x + step) >= least * (1.0 - 1e-3)


def test_a_robot_that_believes_its_tool_behind_the_camera_is_corrected() -> None:
    """The place nominal kinematics tell shows nothing; other depths are tried, and the tool is found."""
    state = started(np.array([0.01, -0.006, -0.02]))
    state.P[:3, :3] += 0.1**2 * np.eye(3)
    measurements = seen_at(TOOL_M)
    parts = state.linearise(measurements)
    assert not all(part.is_finite for part in parts)
    state.augment_state(started(TOOL_M).linearise(measurements))
    found = most_probable(state, measurements, parts, SETTINGS)
    assert found is not None
    place_m = state.retracted(found.x).link(None).T_camera_link[:3, 3]
    assert np.linalg.norm(place_m - TOOL_M) < 0.02

"""The filter's state: links once a correction, biases that are added once and fade."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.filter.correction import ErrorModel
from svmdist.estimation.filter.measurements import PointsMeasurement, SizeMeasurement
from svmdist.estimation.filter.state import ErrorState
from svmdist.kinematics.robot_state import RobotState
from svmdist.transforms import make_transform, rotation_of
from tests.shipped import CHAIN, POSTURE, PROFILE

CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
T_CAMERA_BASE = make_transform(rotation_of([2.0, 0.4, -0.3]), [0.1, -0.2, 0.9])
POINT = PointsMeasurement("p", None, CAMERA, np.zeros((1, 3)), np.zeros((1, 2)), np.eye(2), 1e-4, 0.3)
SIZE = SizeMeasurement("s", None, CAMERA, 0.002, 12.0, np.eye(1), 0.2, correlation_time_s=2.0)


def started() -> ErrorState:
    """The state at the shipped posture."""
    state = ErrorState(ErrorModel(CHAIN, PROFILE.kinematic_error))
    state.go_to(RobotState(CHAIN, 0, POSTURE, T_CAMERA_BASE))
    state.start()
    return state


def test_links_are_computed_once_for_a_correction() -> None:
    """Asked for again they are the same objects, after a step or at a new instant they are others."""
    state = started()
    tool = state.link(None)
    assert state.link(None) is tool
    there = state.retracted(np.full(state.model.size, 1e-3))
    assert there.link(None) is not tool
    assert state.link(None) is tool
    state.go_to(RobotState(CHAIN, 1, POSTURE, T_CAMERA_BASE))
    assert state.link(None) is not tool


def test_biases_are_added_once_and_fade_to_variance_one() -> None:
    """Of one name once, uncorrelated and of variance one; halved they return with twice the rate of the mean."""
    state, size = started(), 0
    size = state.model.size
    state.augment_state([POINT, SIZE, POINT])
    state.augment_state([SIZE])
    assert state.P.shape == (size + 5, size + 5)
    np.testing.assert_array_equal(state.P[size:, size:], np.eye(5))
    state.P[-1, -1], state.bias_mean[-1] = 0.25, 0.8
    state.propagate(1.0)
    assert state.bias_mean[-1] == pytest.approx(0.8 * np.exp(-0.5))
    assert state.P[-1, -1] == pytest.approx(1.0 - 0.75 * np.exp(-1.0))


def test_the_full_jacobian_has_each_derivative_in_its_place() -> None:
    """Rows in the order of the measurements; columns of the error state, then of the bias that each one has."""
    state = started()
    state.augment_state([POINT, SIZE])
    parts = state.linearise([SIZE, POINT])
    H, size = state.full_jacobian([SIZE, POINT], parts), state.model.size
    np.testing.assert_array_equal(H[:, :size], np.concatenate([parts[0].H, parts[1].H]))
    np.testing.assert_array_equal(H[0, size:], [0.0, 0.0, 0.0, 0.0, 0.2])
    np.testing.assert_array_equal(H[1:, size : size + 4], parts[1].bias_jacobian)
    assert not H[1:, -1].any()


def test_before_the_first_instant_there_is_no_robot() -> None:
    """Asked for links, the state says that predict comes first."""
    state = ErrorState(ErrorModel(CHAIN, PROFILE.kinematic_error))
    assert state.is_new
    with pytest.raises(ValueError, match="predict comes first"):
        state.link(None)

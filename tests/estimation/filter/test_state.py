"""The filter's state: links once a correction, biases that are added once and fade."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.instrument.error_model import ErrorModel
from svmdist.estimation.instrument.measurement_kinds import PointsMeasurement, SizeMeasurement
from svmdist.estimation.instrument.state import ErrorState
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile import stated_deviations
from svmdist.profile.hand_eye import SHAFT_RADIUS, HandEye, offset_of, with_hand_eye
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


def test_constants_that_a_transform_owes_to_are_known_with_it() -> None:
    """By hand-eye the correction is correlated with offsets and radius: seen together they cancel, or add up."""
    stated = stated_deviations(PROFILE)
    joint = CHAIN.joint_names[-1]
    by_radius = np.array([[0.0, 0.0, 4e-3, 0.0, 0.0, 0.0]])
    by_joint = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, -0.017]])
    C = 1e-8 * np.eye(6) + by_radius.T @ by_radius + by_joint.T @ by_joint
    effects = {SHAFT_RADIUS: by_radius, offset_of(joint): by_joint}
    hand_eye = HandEye.model_validate(
        {
            "instrument": PROFILE.instrument_name,
            "camera": PROFILE.frames.camera,
            "base": PROFILE.frames.base,
            "rotation": T_CAMERA_BASE[:3, :3].tolist(),
            "translation_m": T_CAMERA_BASE[:3, 3].tolist(),
            "covariance": C.tolist(),
            "constants": [
                {"constant": name, "deviation": stated[name], "effects": rows.tolist()}
                for name, rows in effects.items()
            ],
        }
    )
    error = with_hand_eye(PROFILE.kinematic_error, hand_eye, stated)
    state = ErrorState(ErrorModel(CHAIN, error))
    state.go_to(RobotState(CHAIN, 0, POSTURE, T_CAMERA_BASE))
    state.start()
    size = state.model.size
    assert np.linalg.eigvalsh(state.P)[0] > -1e-15
    # The radius is the one constant outside the error state; a deviation of it moves depth by 4 mm.
    assert state.P.shape == (size + 1, size + 1)
    assert state.P[2, size] == pytest.approx(4e-3)
    column = state.model.constant_columns[offset_of(joint)]
    assert state.P[5, column] == pytest.approx(-0.017 * stated[offset_of(joint)])
    # A measurement of the radius as it is stated takes its part out of the transform's depth.
    state.augment_state(state.linearise([SIZE]))
    H = np.zeros((1, len(state.P)))
    H[0, size] = 1.0
    S = H @ state.P @ H.T + 1e-6
    state.update_covariance(state.P @ H.T / S, H, np.array([[1e-6]]))
    before = C + np.zeros((6, 6))
    moved = np.linalg.norm(T_CAMERA_BASE[:3, 3] - state.anchor_m)
    assert before[2, 2] > 1.5e-5
    assert state.P[2, 2] < 1e-7 + (0.017 * moved) ** 2 + 1e-8 * (1.0 + moved**2)


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
    state.augment_state(state.linearise([POINT, SIZE, POINT]))
    state.augment_state(state.linearise([SIZE]))
    # The point's own four, focal length, principal point; the size's own one, and the sphere's radius.
    count = 4 + 1 + 2 + 1 + 1
    assert state.P.shape == (size + count, size + count)
    np.testing.assert_array_equal(state.P[size:, size:], np.eye(count))
    own = size + 7
    state.P[own, own], state.bias_mean[own - size] = 0.25, 0.8
    state.P[-1, -1], state.bias_mean[-1] = 0.25, 0.8
    state.propagate(1.0)
    assert state.bias_mean[own - size] == pytest.approx(0.8 * np.exp(-0.5))
    assert state.P[own, own] == pytest.approx(1.0 - 0.75 * np.exp(-1.0))
    # A constant stays as it was found.
    assert state.bias_mean[-1] == 0.8
    assert state.P[-1, -1] == 0.25


def test_play_fades_and_the_rest_drifts() -> None:
    """Play returns to its own deviation with its time constant; offsets become less certain; lengths stay."""
    state = started()
    at, error = state.model.columns, PROFILE.kinematic_error
    state.retract(1e-3 * np.ones(state.model.size))
    state.P = np.zeros_like(state.P)
    state.propagate(error.play_time_s)
    keep = np.exp(-1.0)
    np.testing.assert_allclose(state.correction.play, 1e-3 * keep)
    turning = CHAIN.is_revolute[-at.joint_count :]
    expected = np.where(turning, error.play_std_rad, error.play_std_m) ** 2 * (1.0 - keep**2)
    np.testing.assert_allclose(np.diag(state.P)[at.play], expected)
    assert (np.diag(state.P)[at.offsets] > 0.0).all()
    assert not np.diag(state.P)[at.lengths].any()


def test_the_full_jacobian_has_each_derivative_in_its_place() -> None:
    """Rows in the order of the measurements; columns of the error state, then of the bias that each one has."""
    state = started()
    state.augment_state(state.linearise([POINT, SIZE]))
    parts = state.linearise([SIZE, POINT])
    H, size = state.full_jacobian(parts), state.model.size
    np.testing.assert_array_equal(H[:, :size], np.concatenate([parts[0].H, parts[1].H]))
    np.testing.assert_array_equal(H[0, size:], [0.0] * 7 + [0.2, 0.0])  # of exact constants
    np.testing.assert_array_equal(H[1:, size : size + 4], parts[1].biases[0].jacobian)
    assert not H[1:, -2:].any()


def test_before_the_first_instant_there_is_no_robot() -> None:
    """Asked for links, the state says that predict comes first."""
    state = ErrorState(ErrorModel(CHAIN, PROFILE.kinematic_error))
    assert state.is_new
    with pytest.raises(ValueError, match="predict comes first"):
        state.link(None)

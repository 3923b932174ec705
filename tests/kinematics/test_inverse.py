"""Inverse kinematics undoes forward kinematics, and says what it cannot reach."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.errors import KinematicsError
from svmdist.kinematics.dh import DHChain, DHRow, forward_kinematics, pose_jacobian
from svmdist.kinematics.inverse import solve_position
from tests.shipped import CHAIN, POSTURE

FREE = ("yaw", "pitch", "insertion")


@pytest.fixture(scope="module")
def chain() -> DHChain:
    return CHAIN


@pytest.fixture(scope="module")
def posture() -> np.ndarray:
    return POSTURE


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_jacobian_is_the_derivative_of_the_position(convention: str) -> None:
    """Against central differences, to 1e-8 m per unit, in both DH conventions."""
    rng = np.random.default_rng(3)
    rows = tuple(
        DHRow(f"j{index}", kind, *rng.uniform(-1, 1, 4))
        for index, kind in enumerate(("revolute", "prismatic", "fixed", "revolute", "revolute"))
    )
    chain = DHChain(rows, convention)
    q = rng.uniform(-1, 1, (5, 4))
    J = pose_jacobian(chain, q)[:, :3]
    step = 1e-6
    for joint in range(4):
        dq = step * np.eye(4)[joint]
        difference = forward_kinematics(chain, q + dq)[:, :3, 3] - forward_kinematics(chain, q - dq)[:, :3, 3]
        np.testing.assert_allclose(J[:, :, joint], difference / (2 * step), atol=1e-8)


def test_solution_reaches_the_target_and_moves_only_free_joints(chain: DHChain, posture: np.ndarray) -> None:
    """FK of the solution is the target to 1e-9 m; yaw, pitch and insertion come back, the rest stays."""
    rng = np.random.default_rng(0)
    wanted = np.tile(posture, (200, 1))
    free = [chain.joint_names.index(name) for name in FREE]
    wanted[:, free] += rng.uniform(-1.0, 1.0, (200, 3)) * (0.3, 0.2, 0.04)
    wanted[:, -4:] += rng.uniform(-0.1, 0.1, (200, 4))
    targets_m = forward_kinematics(chain, wanted)[:, :3, 3]
    start = wanted.copy()
    start[:, free] = posture[free]
    q = solve_position(chain, start, targets_m, FREE)
    np.testing.assert_allclose(forward_kinematics(chain, q)[:, :3, 3], targets_m, atol=1e-9)
    np.testing.assert_allclose(q, wanted, atol=1e-6)
    fixed = [index for index in range(13) if index not in free]
    assert np.array_equal(q[:, fixed], start[:, fixed])


def test_a_target_beyond_the_limits_is_an_error_that_names_the_joint(
    chain: DHChain, posture: np.ndarray
) -> None:
    target_m = forward_kinematics(chain, posture)[:3, 3] + [0.0, 0.0, -0.4]
    with pytest.raises(KinematicsError, match="outside its limits"):
        solve_position(chain, posture[None], target_m[None], FREE)


def test_a_target_out_of_reach_says_how_far_it_is() -> None:
    arm = DHChain((DHRow("a", "revolute", a_m=0.5), DHRow("b", "revolute", a_m=0.5)))
    with pytest.raises(KinematicsError, match=r"out of reach: .* m are left"):
        solve_position(arm, np.array([[0.1, 0.2]]), np.array([[2.0, 0.0, 0.0]]), ("a", "b"))


def test_wrong_shapes_and_names_are_told(chain: DHChain, posture: np.ndarray) -> None:
    with pytest.raises(KinematicsError, match="expected joints"):
        solve_position(chain, posture, np.zeros(3), FREE)
    with pytest.raises(KinematicsError, match="no joint elbow"):
        solve_position(chain, posture[None], np.zeros((1, 3)), ("elbow",))

"""The geometric Jacobian is the derivative of the forward kinematics."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.kinematics.dh import (
    Convention,
    DHChain,
    DHRow,
    forward_kinematics,
    frame_transforms,
    pose_jacobian,
    row_index,
)
from svmdist.transforms import Array, rotation_x

STEP = 1e-6


def make_chain(convention: Convention) -> DHChain:
    rng = np.random.default_rng(3)
    kinds = ("prismatic", "revolute", "fixed", "revolute", "prismatic", "revolute")
    rows = tuple(
        DHRow(f"j{index}", kind, *rng.uniform(-1.0, 1.0, 4))  # type: ignore[arg-type]
        for index, kind in enumerate(kinds)
    )
    T_last_tool = np.eye(4)
    T_last_tool[:3, :3] = rotation_x(0.7)
    T_last_tool[:3, 3] = 0.1, -0.2, 0.05
    return DHChain(rows, convention, T_last_tool)


def frame(chain: DHChain, q: Array, row: str | None) -> Array:
    if row is None:
        return forward_kinematics(chain, q)
    return frame_transforms(chain, q)[row_index(chain, row)]


@pytest.mark.parametrize("convention", ["standard", "modified"])
@pytest.mark.parametrize("row", [None, "j3", "j4"])
def test_jacobian_is_the_derivative(convention: Convention, row: str | None) -> None:
    """Central differences of the pose agree with every column to 1e-8, for the tool and for frames before it."""
    chain = make_chain(convention)
    q = np.random.default_rng(4).uniform(-1.0, 1.0, 5)
    J = pose_jacobian(chain, q, row)
    R = frame(chain, q, row)[:3, :3]
    for column in range(5):
        change = STEP * np.eye(5)[column]
        dT = (frame(chain, q + change, row) - frame(chain, q - change, row)) / (2 * STEP)
        W = dT[:3, :3] @ R.T
        np.testing.assert_allclose(J[:3, column], dT[:3, 3], atol=1e-8)
        np.testing.assert_allclose(J[3:, column], [W[2, 1], W[0, 2], W[1, 0]], atol=1e-8)


def test_stacks_broadcast() -> None:
    """A stack of joint vectors gives the stack of their Jacobians."""
    chain = make_chain("standard")
    q = np.random.default_rng(5).uniform(-1.0, 1.0, (2, 3, 5))
    J = pose_jacobian(chain, q)
    assert J.shape == (2, 3, 6, 5)
    np.testing.assert_allclose(J[1, 2], pose_jacobian(chain, q[1, 2]), atol=1e-14)

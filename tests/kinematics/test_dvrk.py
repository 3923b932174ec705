"""The dVRK profile against an independent implementation of the published chain."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from svmdist.kinematics.dh import chain_of, forward_kinematics, select_joints
from svmdist.profile import load_profile


def _screw(axis: int, angle_rad: float, length_m: float) -> np.ndarray:
    """Turn about an axis of the current frame and shift along it, by SciPy's rotations."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(angle_rad * np.eye(3)[axis]).as_matrix()
    T[:3, 3] = length_m * np.eye(3)[axis]
    return T


def _published_psm(q: np.ndarray) -> np.ndarray:
    """The Classic PSM with a Large Needle Driver as a product of screws: along x by (α, a), then z by (θ, d).

    Written from the published table: Craig's convention is a screw about x followed by one about z.
    """
    half = np.pi / 2
    T = _screw(0, half, 0.0) @ _screw(2, half + q[0], 0.0)
    T = T @ _screw(0, -half, 0.0) @ _screw(2, -half + q[1], 0.0)
    T = T @ _screw(0, half, 0.0) @ _screw(2, 0.0, q[2] - 0.4318)
    T = T @ _screw(0, 0.0, 0.0) @ _screw(2, q[3], 0.4162)
    T = T @ _screw(0, -half, 0.0) @ _screw(2, -half + q[4], 0.0)
    T = T @ _screw(0, -half, 0.0091) @ _screw(2, -half + q[5], 0.0)
    tip = np.eye(4)
    tip[:3, :3] = [[0, -1, 0], [0, 0, 1], [-1, 0, 0]]
    return T @ tip


def test_dvrk_chain_equals_an_independent_one():
    """Position and rotation agree to 1e-12 over 1,000 random joint vectors inside the limits."""
    profile = load_profile("dvrk-psm")
    assert profile.robot is not None
    chain = chain_of(profile.robot)
    q = np.random.default_rng(5).uniform(chain.lower, chain.upper, (1000, 6))
    expected = np.stack([_published_psm(row) for row in q])
    np.testing.assert_allclose(forward_kinematics(chain, q), expected, atol=1e-12)


def test_dvrk_at_zero_points_down_from_the_remote_centre():
    """At q = 0 the wrist is 15.6 mm behind the remote centre along the shaft, and the tip 9.1 mm ahead of it."""
    profile = load_profile("dvrk-psm")
    assert profile.robot is not None
    T_base_tool = forward_kinematics(chain_of(profile.robot), np.zeros(6))
    # 0.4162 - 0.4318 + 0.0091 = -0.0065 along the insertion axis, which is -z of the base.
    np.testing.assert_allclose(T_base_tool[:3, 3], [0.0, 0.0, 0.0065], atol=1e-12)


def test_joints_are_found_by_alias():
    """Logs of the older component, with outer_yaw for yaw, are read by the same chain."""
    profile = load_profile("dvrk-psm")
    assert profile.robot is not None
    chain = chain_of(profile.robot)
    names = ("jaw", *(f"outer_{name}" for name in chain.joint_names))
    np.testing.assert_array_equal(select_joints(chain, names, np.arange(7.0)), np.arange(1.0, 7.0))

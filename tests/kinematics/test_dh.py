"""DH chains, held against an explicit product of elementary matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from svmdist.errors import KinematicsError
from svmdist.kinematics import (
    CHUNK,
    DHChain,
    chain_of,
    forward_kinematics,
    frame_transforms,
    jacobian_of_frames,
    link_transforms,
    row_index,
    select_joints,
)
from svmdist.profile import Joint, load_profile
from svmdist.transforms import make_transform, rotation_x, rotation_z

LENGTHS = ("a_m", "alpha_rad", "d_m", "theta_rad")
angles_rad = st.floats(-np.pi, np.pi)
row_angles_rad, row_lengths_m = (
    st.floats(-limit, limit).map(lambda value: round(value, 15)) for limit in (3.14, 1.0)
)
rows = st.builds(
    Joint,
    name=st.just("joint"),
    type=st.sampled_from(["revolute", "prismatic", "fixed"]),
    a_m=row_lengths_m,
    alpha_rad=row_angles_rad,
    d_m=row_lengths_m,
    theta_rad=row_angles_rad,
)
THREE = DHChain(
    (
        Joint(name="slide", type="prismatic", a_m=0.1, d_m=0.2, lower=0.0, upper=0.5),
        Joint(name="bracket", type="fixed", alpha_rad=np.pi / 2, theta_rad=0.3),
        Joint(name="turn", type="revolute", a_m=0.05, alpha_rad=-0.4, lower=-1.0, upper=2.0),
    ),
    T_last_tool=make_transform(rotation_x(0.7), [0.01, 0.02, 0.03]),
)


def turn(R: np.ndarray) -> np.ndarray:
    """A rotation as a transform, shape (4, 4)."""
    return make_transform(R, np.zeros(3))


def shift(x_m: float = 0.0, z_m: float = 0.0) -> np.ndarray:
    """A translation along x and z as a transform, shape (4, 4)."""
    return make_transform(np.eye(3), [x_m, 0.0, z_m])


def elementary_product(row: Joint, value: float, convention: str) -> np.ndarray:
    """The four elementary motions of one row, multiplied in the order that defines the convention."""
    theta = row.theta_rad + (value if row.type == "revolute" else 0.0)
    d = row.d_m + (value if row.type == "prismatic" else 0.0)
    about_z, along_z = turn(rotation_z(theta)), shift(z_m=d)
    about_x, along_x = turn(rotation_x(row.alpha_rad)), shift(x_m=row.a_m)
    if convention == "standard":
        return about_z @ along_z @ along_x @ about_x
    return about_x @ along_x @ about_z @ along_z


@settings(deadline=None, max_examples=100)
@given(rows, angles_rad, st.sampled_from(["standard", "modified"]))
def test_a_row_is_the_product_of_its_elementary_motions(row, value, convention):
    """Each row's matrix equals the product of two rotations and two shifts within 1e-15."""
    chain = DHChain((row,), convention)
    q = [] if row.type == "fixed" else [value]
    np.testing.assert_allclose(
        link_transforms(chain, q)[0], elementary_product(row, value, convention), atol=1e-15
    )


@settings(deadline=None, max_examples=30)
@given(st.lists(rows, min_size=1, max_size=8), st.sampled_from(["standard", "modified"]), st.integers(0, 999))
def test_a_chain_is_the_product_of_its_rows_and_the_tool(row_list, convention, seed):
    """Forward kinematics equals the running product of elementary motions and the tool within 1e-12."""
    T_last_tool = THREE.T_last_tool
    chain = DHChain(tuple(row_list), convention, T_last_tool)
    q = np.random.default_rng(seed).uniform(-1, 1, len(chain.joint_names))
    values = iter(q)
    T, frames = np.eye(4), []
    for row in row_list:
        T = T @ elementary_product(row, 0.0 if row.type == "fixed" else next(values), convention)
        frames.append(T)
    np.testing.assert_allclose(frame_transforms(chain, q), frames, atol=1e-12)
    np.testing.assert_allclose(forward_kinematics(chain, q), T @ T_last_tool, atol=1e-12)


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_many_joint_vectors_equal_one_at_a_time(convention):
    """A stack of joint vectors of any shape gives the transforms of its members within 1e-15."""
    chain = DHChain(THREE.rows, convention, THREE.T_last_tool)
    q = np.random.default_rng(1).uniform(-1, 1, (3, 4, 2))
    for function in (forward_kinematics, frame_transforms, link_transforms):
        many = function(chain, q)
        single = np.array([[function(chain, member) for member in row] for row in q])
        np.testing.assert_allclose(many, single, atol=1e-15)
    long = np.random.default_rng(2).uniform(-1, 1, (CHUNK + 5, 2))
    np.testing.assert_allclose(
        forward_kinematics(chain, long)[-1], forward_kinematics(chain, long[-1]), atol=1e-15
    )


def test_fixed_rows_take_no_joint_value():
    """Names and limits list the joints that move, base first, without the fixed rows."""
    assert THREE.joint_names == ("slide", "turn")
    np.testing.assert_array_equal(THREE.lower, [0.0, -1.0])
    np.testing.assert_array_equal(THREE.upper, [0.5, 2.0])


def test_quarter_turn_twists_are_exact():
    """A twist of π/2 leaves exact zeros: cos(π/2) = 6e-17 would tilt every frame behind it."""
    T = link_transforms(DHChain((Joint(name="j", type="fixed", alpha_rad=np.pi / 2),)), [])[0]
    np.testing.assert_array_equal(T, [[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


@pytest.mark.parametrize("q", [0.0, [], [1.0], [1.0, 2.0, 3.0], [[1.0], [2.0]], np.zeros((2, 0))])
@pytest.mark.parametrize("function", [forward_kinematics, frame_transforms, link_transforms])
def test_a_wrong_number_of_joints_is_an_error_with_both_counts(function, q):
    """Joint vectors of a wrong length raise KinematicsError that says what was expected and found."""
    with pytest.raises(KinematicsError, match=r"expected 2 joint values .* found shape \("):
        function(THREE, q)


def test_select_joints_brings_a_logs_order_into_the_chains():
    """Positions follow their names, whatever the log's order, and joints the chain lacks are dropped."""
    found = select_joints(THREE, ("turn", "camera", "slide"), [[1.0, 9.0, 2.0], [3.0, 9.0, 4.0]])
    np.testing.assert_array_equal(found, [[2.0, 1.0], [4.0, 3.0]])


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("turn", "elbow"), "needs the joints slide; the log has turn, elbow"),
        ((), "needs the joints slide, turn; the log has none"),
    ],
)
def test_select_joints_names_the_joints_that_are_missing(names, message):
    """A log without a needed joint raises KinematicsError with the missing names and those there are."""
    with pytest.raises(KinematicsError, match=message):
        select_joints(THREE, names, np.zeros(len(names)))


STEP = 1e-6


@pytest.mark.parametrize("convention", ["standard", "modified"])
@pytest.mark.parametrize("row", [None, "j3", "j4"])
def test_the_jacobian_is_the_derivative(convention, row):
    """Central differences of the pose agree with every column to 1e-8, for the tool and for frames before it."""
    rng = np.random.default_rng(3)
    kinds = ("prismatic", "revolute", "fixed", "revolute", "prismatic", "revolute")
    chain = DHChain(
        tuple(
            Joint(name=f"j{index}", type=kind, **dict(zip(LENGTHS, rng.uniform(-1.0, 1.0, 4), strict=True)))
            for index, kind in enumerate(kinds)
        ),
        convention,
        THREE.T_last_tool,
    )

    def pose(q):
        frames = frame_transforms(chain, q)
        return (
            frames[..., -1, :, :] @ chain.T_last_tool
            if row is None
            else frames[..., row_index(chain, row), :, :]
        )

    q = rng.uniform(-1.0, 1.0, (2, 5))
    J = jacobian_of_frames(chain, frame_transforms(chain, q), row)
    for column, change in enumerate(STEP * np.eye(5)):
        dT = (pose(q + change) - pose(q - change)) / (2 * STEP)
        W = dT[:, :3, :3] @ np.swapaxes(pose(q)[:, :3, :3], 1, 2)
        np.testing.assert_allclose(J[:, :3, column], dT[:, :3, 3], atol=1e-8)
        np.testing.assert_allclose(
            J[:, 3:, column], np.stack([W[:, 2, 1], W[:, 0, 2], W[:, 1, 0]], -1), atol=1e-8
        )


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


def test_joints_are_found_by_alias():
    """Logs of the older component, with outer_yaw for yaw, are read by the same chain."""
    profile = load_profile("dvrk-psm")
    assert profile.robot is not None
    chain = chain_of(profile.robot)
    names = ("jaw", *(f"outer_{name}" for name in chain.joint_names))
    np.testing.assert_array_equal(select_joints(chain, names, np.arange(7.0)), np.arange(1.0, 7.0))

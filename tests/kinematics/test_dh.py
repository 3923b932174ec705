"""DH chains, held against an explicit product of elementary matrices."""

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
    link_transforms,
    select_joints,
)
from svmdist.profile import load_profile
from svmdist.profile.robot import Joint
from svmdist.transforms import make_transform, rotation_x, rotation_z

LENGTHS = ("a_m", "alpha_rad", "d_m", "theta_rad")
angles_rad = st.floats(-np.pi, np.pi)
row_angles_rad, row_lengths_m = (st.floats(-limit, limit).map(lambda value: round(value, 15)) for limit in (3.14, 1.0))
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


def elementary_product(row: Joint, value: float, convention: str) -> np.ndarray:
    """The four elementary motions of one row, in the convention's order; along and about one axis commute."""
    theta = row.theta_rad + (value if row.type == "revolute" else 0.0)
    d = row.d_m + (value if row.type == "prismatic" else 0.0)
    zero, along_x, along_z = np.zeros(3), np.array([row.a_m, 0.0, 0.0]), np.array([0.0, 0.0, d])
    about_z = make_transform(rotation_z(theta), zero) @ make_transform(np.eye(3), along_z)
    about_x = make_transform(rotation_x(row.alpha_rad), zero) @ make_transform(np.eye(3), along_x)
    return about_z @ about_x if convention == "standard" else about_x @ about_z


@settings(max_examples=30)
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
    np.testing.assert_allclose(forward_kinematics(chain, long)[-1], forward_kinematics(chain, long[-1]), atol=1e-15)


def test_joints_are_selected_by_name():
    """In the chain's order, fixed rows without one; a log's other joints are dropped, its missing ones named."""
    assert THREE.joint_names == ("slide", "turn")
    np.testing.assert_array_equal([THREE.lower, THREE.upper], [[0.0, -1.0], [0.5, 2.0]])
    found = select_joints(THREE, ("turn", "camera", "slide"), [[1.0, 9.0, 2.0], [3.0, 9.0, 4.0]])
    np.testing.assert_array_equal(found, [[2.0, 1.0], [4.0, 3.0]])
    for names, message in (
        (("turn", "elbow"), "needs the joints slide; the log has turn, elbow"),
        ((), "needs the joints slide, turn; the log has none"),
    ):
        with pytest.raises(KinematicsError, match=message):
            select_joints(THREE, names, np.zeros(len(names)))
    # Logs of an older dVRK component have outer_yaw for yaw.
    dvrk = chain_of(load_profile("dvrk-psm").robot)
    older = ("jaw", *(f"outer_{name}" for name in dvrk.joint_names))
    np.testing.assert_array_equal(select_joints(dvrk, older, np.arange(7.0)), np.arange(1.0, 7.0))


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


def _published_psm(q: np.ndarray) -> np.ndarray:
    """The Classic PSM with a Large Needle Driver as a product of screws: along x by (α, a), then z by (θ, d).

    Written from the published table: Craig's convention is a screw about x followed by one about z.
    """

    def screw(axis: int, angle_rad: float, length_m: float) -> np.ndarray:
        """Turn about an axis of the current frame and shift along it, by SciPy's rotations."""
        R = Rotation.from_rotvec(angle_rad * np.eye(3)[axis]).as_matrix()
        return make_transform(R, length_m * np.eye(3)[axis])

    half = np.pi / 2
    T = screw(0, half, 0.0) @ screw(2, half + q[0], 0.0)
    T = T @ screw(0, -half, 0.0) @ screw(2, -half + q[1], 0.0)
    T = T @ screw(0, half, 0.0) @ screw(2, 0.0, q[2] - 0.4318)
    T = T @ screw(0, 0.0, 0.0) @ screw(2, q[3], 0.4162)
    T = T @ screw(0, -half, 0.0) @ screw(2, -half + q[4], 0.0)
    T = T @ screw(0, -half, 0.0091) @ screw(2, -half + q[5], 0.0)
    return T @ make_transform([[0, -1, 0], [0, 0, 1], [-1, 0, 0]], np.zeros(3))


def test_dvrk_chain_equals_an_independent_one():
    """Position and rotation agree to 1e-12 over 1,000 random joint vectors inside the limits."""
    chain = chain_of(load_profile("dvrk-psm").robot)
    q = np.random.default_rng(5).uniform(chain.lower, chain.upper, (1000, 6))
    expected = np.stack([_published_psm(row) for row in q])
    np.testing.assert_allclose(forward_kinematics(chain, q), expected, atol=1e-12)

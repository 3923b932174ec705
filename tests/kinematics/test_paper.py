"""The paper's kinematic equations: what was published, what is corrected, and where they differ."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.estimation.plane_mapping import (
    displacement_cm_as_published,
    displacement_cm_corrected,
    planar_distance_cm,
)
from svmdist.kinematics import DHChain, forward_kinematics
from svmdist.profile import Joint, load_profile
from svmdist.transforms import Array

ANGLES_RAD = (0.0, 0.3, np.pi / 2, -2.0, np.pi)


def first_link(l1_m: float, d1_m: float) -> Array:
    """eq. (29), shape (4, 4): standard DH with α = 0, θ = 0, a = l1 and d = d1."""
    T = np.eye(4)
    T[0, 3], T[2, 3] = l1_m, d1_m
    return T


def last_link_as_published(theta_rad: float) -> Array:
    """eq. (30) as published, shape (4, 4): its rotation part has determinant -1, a reflection."""
    c, s = np.cos(theta_rad), np.sin(theta_rad)
    return np.array([[c, 0.0, -s, 0.0], [s, 0.0, c, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def last_link_corrected(theta_rad: float) -> Array:
    """eq. (30) corrected, shape (4, 4): standard DH with α = +π/2, a = d = 0."""
    c, s = np.cos(theta_rad), np.sin(theta_rad)
    return np.array([[c, 0.0, s, 0.0], [s, 0.0, -c, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


@pytest.mark.parametrize("q_m", [0.0, 0.17])
def test_eq_29_is_a_standard_dh_row(q_m):
    """eq. (29) equals the row a = l1, α = 0, d = d1, θ = 0 of a prismatic joint, bit for bit."""
    chain = DHChain((Joint(name="slide", type="prismatic", a_m=0.09, d_m=0.6),))
    np.testing.assert_array_equal(first_link(0.09, 0.6 + q_m), forward_kinematics(chain, [q_m]))


@pytest.mark.parametrize("theta_rad", ANGLES_RAD)
def test_eq_30_corrected_is_a_standard_dh_row(theta_rad):
    """eq. (30), corrected, equals the row a = 0, α = π/2, d = 0 of a revolute joint, bit for bit."""
    chain = DHChain((Joint(name="jaw", type="revolute", alpha_rad=np.pi / 2),))
    np.testing.assert_array_equal(last_link_corrected(theta_rad), forward_kinematics(chain, [theta_rad]))


@pytest.mark.parametrize("theta_rad", ANGLES_RAD)
def test_eq_30_as_published_is_a_reflection(theta_rad):
    """The published rotation part is orthogonal with determinant -1, the corrected one +1, within 1e-15."""
    published, corrected = last_link_as_published(theta_rad)[:3, :3], last_link_corrected(theta_rad)[:3, :3]
    np.testing.assert_allclose(published @ published.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(published) == pytest.approx(-1.0, abs=1e-15)
    assert np.linalg.det(corrected) == pytest.approx(1.0, abs=1e-15)
    # Only the third column differs, by its sign.
    np.testing.assert_array_equal(published * [1, 1, -1], corrected)


def test_the_shipped_chain_begins_with_eq_29_and_ends_with_eq_30():
    """Joint 1 is prismatic with α = θ = 0, joint 13 revolute with α = π/2 and a = d = 0 (Table II)."""
    robot = load_profile().robot
    assert robot is not None
    first, last = robot.joints[0], robot.joints[-1]
    assert robot.convention == "standard"
    assert (first.type, first.alpha_rad, first.theta_rad) == ("prismatic", 0.0, 0.0)
    assert (last.type, last.a_m, last.d_m, last.theta_rad) == ("revolute", 0.0, 0.0, 0.0)
    assert last.alpha_rad == np.pi / 2


def test_eqs_33_34_as_published_divide_metres_by_a_hundred():
    """The published displacement is (0.099 - x) / 100, (0.043 - y) / 100, from numbers written out here."""
    found = displacement_cm_as_published(np.array([0.059, 0.013, 0.5]))
    np.testing.assert_allclose(found, [0.0004, 0.0003], rtol=1e-12)


def test_eqs_33_34_corrected_are_ten_thousand_times_the_as_published_ones():
    """With the tissue at (0.099, 0.043) m, the two readings differ by 10^4 and by nothing else."""
    p_m = np.random.default_rng(1).normal(size=(20, 3))
    corrected = displacement_cm_corrected(p_m, np.array([0.099, 0.043, 0.7]))
    np.testing.assert_allclose(corrected, 1e4 * displacement_cm_as_published(p_m), rtol=1e-12)


def test_eqs_33_to_35_corrected_give_centimetres():
    """A tool 3 cm and 4 cm beside the tissue is 5 cm away, whatever their depths."""
    p_m = np.array([[0.01, 0.02, 0.1], [0.01, 0.02, 9.0]])
    tissue_m = np.array([[0.04, 0.06, 0.0], [-0.02, -0.02, 1.0]])
    np.testing.assert_allclose(planar_distance_cm(displacement_cm_corrected(p_m, tissue_m)), 5.0, rtol=1e-12)

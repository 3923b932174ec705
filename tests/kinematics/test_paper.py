"""The paper's kinematic equations: what was published, what is corrected, and where they differ."""

from __future__ import annotations

import numpy as np

from svmdist.estimation.plane_mapping import (
    displacement_cm_as_published,
    displacement_cm_corrected,
    planar_distance_cm,
)
from svmdist.kinematics import DHChain, chain_of, forward_kinematics
from svmdist.profile import load_profile


def test_the_shipped_chain_begins_with_eq_29_and_ends_with_eq_30_corrected():
    """Joint 1 slides with α = θ = 0, joint 13 turns with α = π/2 and a = d = 0 (Table II); bit for bit."""
    robot = load_profile().robot
    assert robot is not None
    first, *_, last = chain_of(robot).rows
    T = np.eye(4)
    T[0, 3], T[2, 3] = first.a_m, first.d_m + 0.17
    np.testing.assert_array_equal(forward_kinematics(DHChain((first,)), [0.17]), T)
    # As published the third column of the rotation has the other sign: a reflection.
    for theta_rad in (0.0, 0.3, np.pi / 2, -2.0, np.pi):
        c, s = np.cos(theta_rad), np.sin(theta_rad)
        T = [[c, 0.0, s, 0.0], [s, 0.0, -c, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
        np.testing.assert_array_equal(forward_kinematics(DHChain((last,)), [theta_rad]), T)


def test_eqs_33_34_as_published_divide_metres_by_a_hundred():
    """(0.099 - x) / 100 and (0.043 - y) / 100: with the tissue there, 10^4 less than corrected."""
    found = displacement_cm_as_published(np.array([0.059, 0.013, 0.5]))
    np.testing.assert_allclose(found, [0.0004, 0.0003], rtol=1e-12)
    p_m = np.random.default_rng(1).normal(size=(20, 3))
    corrected = displacement_cm_corrected(p_m, np.array([0.099, 0.043, 0.7]))
    np.testing.assert_allclose(corrected, 1e4 * displacement_cm_as_published(p_m), rtol=1e-12)


def test_eqs_33_to_35_corrected_give_centimetres():
    """A tool 3 cm and 4 cm beside the tissue is 5 cm away, whatever their depths."""
    p_m = np.array([[0.01, 0.02, 0.1], [0.01, 0.02, 9.0]])
    tissue_m = np.array([[0.04, 0.06, 0.0], [-0.02, -0.02, 1.0]])
    np.testing.assert_allclose(planar_distance_cm(displacement_cm_corrected(p_m, tissue_m)), 5.0, rtol=1e-12)

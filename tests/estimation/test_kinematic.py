"""The interval of `kinematic` over many robots: what the simulator draws, held against what the profile states."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from svmdist.estimation.filtering.believed import believed_tool
from svmdist.kinematics.chain import chain_of
from svmdist.kinematics.dh import forward_kinematics
from svmdist.profile import load_profile
from svmdist.simulation.belief import draw_belief
from svmdist.simulation.scene import make_scene

SEEDS = 600


def test_the_stated_ellipsoid_holds_the_tool() -> None:
    """One draw a log, so over seeds: 95 % of the true tools within the 95 % ellipsoid, and along each camera axis.

    Of 2,000 seeds 93.7 % were inside; what lacks is of second order (`believed_tool`). 600 seeds settle it to 1 %.
    """
    profile = load_profile()
    assert profile.robot is not None
    assert profile.simulation is not None
    chain = chain_of(profile.robot)
    q = np.array([profile.simulation.posture[name] for name in chain.joint_names])
    T_camera_base = make_scene(profile, 0).T_camera_base
    truth_m = (T_camera_base @ forward_kinematics(chain, q))[:3, 3]
    nees, within = [], []
    for seed in range(SEEDS):
        belief = draw_belief(chain, T_camera_base, profile, seed, scale=1.0)
        joints = q + belief.joint_offsets
        stated = believed_tool(chain, profile.kinematic_error, joints, belief.T_camera_base)
        error_m, covariance = truth_m - stated.position_m, stated.position_covariance
        nees.append(float(error_m @ np.linalg.solve(covariance, error_m)))
        within.append(np.abs(error_m) < 1.96 * np.sqrt(np.diag(covariance)))
    assert 0.90 < np.mean(np.array(nees) < chi2.ppf(0.95, 3)) < 0.99
    coverage = np.mean(within, axis=0)
    assert np.all((coverage > 0.90) & (coverage < 0.99)), coverage

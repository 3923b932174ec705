"""The robot that ships, in the posture that its profile gives it: what many tests measure with."""

from __future__ import annotations

import numpy as np

from svmdist.kinematics.chain import chain_of
from svmdist.profile import load_profile

PROFILE = load_profile()
assert PROFILE.robot is not None
assert PROFILE.simulation is not None
CHAIN = chain_of(PROFILE.robot)
POSTURE = np.array([PROFILE.simulation.posture[name] for name in CHAIN.joint_names])
"""Joint values, shape (n_joints,), in rad and m; to be copied before they are changed."""
POSTURE.setflags(write=False)

"""From a profile's robot to the DH chain that it describes."""

from __future__ import annotations

from svmdist.kinematics.dh import DHChain, DHRow
from svmdist.profile import Robot


def chain_of(robot: Robot) -> DHChain:
    """Build the chain from base to tool; the profile has been checked when it was read."""
    rows = tuple(
        DHRow(
            joint.name,
            joint.type,
            joint.a_m,
            joint.alpha_rad,
            joint.d_m,
            joint.theta_rad,
            joint.lower,
            joint.upper,
            joint.aliases,
        )
        for joint in robot.joints
    )
    tolerance = (robot.limit_tolerance_rad, robot.limit_tolerance_m)
    return DHChain(rows, robot.convention, robot.T_last_tool, *tolerance)

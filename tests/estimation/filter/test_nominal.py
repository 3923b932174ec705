"""The tool under nominal kinematics is where the filter starts."""

from __future__ import annotations

import numpy as np

from svmdist.estimation.instrument.error_model import nominal_tool
from svmdist.estimation.instrument.kinematic_error_filter import KinematicErrorFilter
from svmdist.kinematics.robot_state import RobotState
from svmdist.transforms import make_transform, rotation_of
from tests.shipped import CHAIN, POSTURE, PROFILE


def test_it_equals_a_filter_that_was_given_nothing() -> None:
    """Pose, covariance and axis, bit for bit."""
    robot = RobotState(CHAIN, 0, POSTURE, make_transform(rotation_of([2.0, 0.4, -0.3]), [0.1, -0.2, 0.9]))
    kalman = KinematicErrorFilter(CHAIN, PROFILE.kinematic_error)
    kalman.predict(robot)
    found, expected = nominal_tool(CHAIN, PROFILE.kinematic_error, robot), kalman.tool_pose()
    np.testing.assert_array_equal(found.T_camera_tool, expected.T_camera_tool)
    np.testing.assert_array_equal(found.covariance, expected.covariance)
    np.testing.assert_array_equal(found.axis, expected.axis)
    np.testing.assert_allclose(found.T_camera_tool, robot.T_camera_tool, atol=1e-14)

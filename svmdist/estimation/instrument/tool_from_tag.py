"""From the tag's pose to the tool's: through the mounting and the joints between them."""

from __future__ import annotations

import numpy as np

from svmdist.estimation.instrument.wrist import wrist_in_tool
from svmdist.kinematics.jacobian import row_index
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile import Fiducial, KinematicError
from svmdist.results import ToolPose
from svmdist.transforms import Array, inverse, skew
from svmdist.vision.tag.refinement import TagPose


def tool_from_tag(tag: TagPose, fiducial: Fiducial, robot: RobotState, error: KinematicError) -> ToolPose:
    """The tool's pose from the tag's, through the mounting and the joints behind it."""
    T_base_tag = robot.T_base_link(fiducial.link) @ fiducial.T_link_tag
    T_camera_base = tag.T_camera_tag @ inverse(T_base_tag)
    T_camera_tool = T_camera_base @ robot.T_base_tool
    # The tag's turning moves the tool at the end of its arm: δp_tool = δp + δθ x arm.
    arm_m = T_camera_tool[:3, 3] - tag.T_camera_tag[:3, 3]
    J = np.eye(6)
    J[:3, 3:] = -skew(arm_m)
    covariance = J @ tag.covariance @ J.T
    covariance += _joint_covariance(robot, fiducial.link, T_camera_base[:3, :3], error)
    axis = T_camera_tool[:3, :3] @ wrist_in_tool(robot.chain, robot.q).shaft
    return ToolPose(T_camera_tool, covariance, axis)


def _joint_covariance(robot: RobotState, link: str, R_camera_base: Array, error: KinematicError) -> Array:
    """What the errors of the joints behind the tag's link do to the tool, shape (6, 6) in the camera frame."""
    chain, tool_m = robot.chain, robot.T_base_tool[:3, 3]
    covariance = np.zeros((6, 6))
    for index in range(row_index(chain, link) + 1, len(chain.rows)):
        kind = chain.rows[index].joint
        if kind == "fixed":
            continue
        z, at_m = robot.joint_axes[index]
        if kind == "revolute":
            column = error.joint_std_rad * np.concatenate([np.cross(z, tool_m - at_m), z])
        else:
            column = error.joint_std_m * np.concatenate([z, np.zeros(3)])
        turned = np.concatenate([R_camera_base @ column[:3], R_camera_base @ column[3:]])
        covariance += np.outer(turned, turned)
    return covariance

"""From the tag's pose to the tool's: through the mounting and the joints between them."""

from __future__ import annotations

import numpy as np

from svmdist.estimation.filter.constants import EXACT, Deviations
from svmdist.estimation.instrument.wrist import wrist_in_tool
from svmdist.kinematics.dh import row_index
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile import Fiducial, KinematicError
from svmdist.results import ToolPose
from svmdist.transforms import Array, inverse, skew
from svmdist.vision.tag.refinement import TagPose

NO_FOCAL_PX = np.ones(2)
"""Where no deviation asks for it."""


def tool_from_tag(
    tag: TagPose,
    fiducial: Fiducial,
    robot: RobotState,
    error: KinematicError,
    deviations: Deviations = EXACT,
    focal_px: Array = NO_FOCAL_PX,
) -> ToolPose:
    """The tool's pose from the tag's, through the mounting and the joints behind it.

    `deviations` are those of camera, tag and mounting, whose errors the tag's own covariance does not hold; they need
    the camera's focal lengths, shape (2,).
    """
    T_base_tag = robot.T_base_link(fiducial.link) @ fiducial.T_link_tag
    T_camera_base = tag.T_camera_tag @ inverse(T_base_tag)
    T_camera_tool = T_camera_base @ robot.T_base_tool
    # The tag's turning moves the tool at the end of its arm: δp_tool = δp + δθ x arm.
    arm_m = T_camera_tool[:3, 3] - tag.T_camera_tag[:3, 3]
    J = np.eye(6)
    J[:3, 3:] = -skew(arm_m)
    constants = sum(
        (bias.jacobian @ bias.jacobian.T for bias in deviations.of_tag(tag.T_camera_tag, focal_px)),
        np.zeros((6, 6)),
    )
    covariance = J @ (tag.covariance + constants) @ J.T
    covariance += _joint_covariance(robot, fiducial.link, T_camera_base[:3, :3], error)
    axis = T_camera_tool[:3, :3] @ wrist_in_tool(robot.chain, robot.q).shaft
    return ToolPose(T_camera_tool, covariance, axis)


def _joint_covariance(robot: RobotState, link: str, R_camera_base: Array, error: KinematicError) -> Array:
    """What the errors of the joints behind the tag's link do to the tool, shape (6, 6) in the camera frame."""
    chain, tool_m = robot.chain, robot.T_base_tool[:3, 3]
    columns, late = [], np.zeros(6)
    for index in range(row_index(chain, link) + 1, len(chain.rows)):
        row = chain.rows[index]
        z, at_m = robot.joint_axes[index]
        turning, sliding = np.concatenate([np.cross(z, tool_m - at_m), z]), np.concatenate([z, np.zeros(3)])
        if row.a_m != 0.0:
            columns.append(error.length_std_m * np.concatenate([robot.frames[index][:3, 0], np.zeros(3)]))
        if row.joint == "fixed":
            continue
        is_turning = row.joint == "revolute"
        column = turning if is_turning else sliding
        stds = (
            (error.joint_std_rad, error.play_std_rad) if is_turning else (error.joint_std_m, error.play_std_m)
        )
        columns.append(float(np.hypot(*stds)) * column)
        late += robot.rates[chain.joint_names.index(row.name)] * column
    columns.append(error.time_offset_std_s * late)
    turned = np.array(columns).reshape(-1, 2, 3) @ R_camera_base.T
    J = turned.reshape(-1, 6).T
    return np.asarray(J @ J.T)

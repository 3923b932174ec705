"""From the tag's pose to the tool's: through the mounting and the joints between them, and back to a prediction."""

from __future__ import annotations

import numpy as np

from svmdist.estimation.instrument.model import wrist_in_tool
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.kinematics.dh import DHChain, frame_transforms
from svmdist.kinematics.jacobian import joint_axis, row_index
from svmdist.profile import Fiducial, KinematicError
from svmdist.transforms import Array, inverse, skew
from svmdist.vision.tag.refinement import TagPose


def tool_from_tag(
    tag: TagPose, fiducial: Fiducial, chain: DHChain, q: Array, error: KinematicError
) -> ToolPose:
    """The tool's pose from the tag's, through the mounting and the joints behind it, shape (n_joints,)."""
    frames = frame_transforms(chain, q)
    T_base_tool = frames[-1] @ chain.T_last_tool
    T_base_tag = frames[row_index(chain, fiducial.link)] @ fiducial.T_link_tag
    T_camera_tool = tag.T_camera_tag @ inverse(T_base_tag) @ T_base_tool
    # The tag's turning moves the tool at the end of its arm: δp_tool = δp + δθ x arm.
    arm_m = T_camera_tool[:3, 3] - tag.T_camera_tag[:3, 3]
    J = np.eye(6)
    J[:3, 3:] = -skew(arm_m)
    covariance = J @ tag.covariance @ J.T
    R_camera_base = tag.T_camera_tag[:3, :3] @ T_base_tag[:3, :3].T
    covariance += _joint_covariance(chain, frames, fiducial.link, T_base_tool[:3, 3], R_camera_base, error)
    axis = T_camera_tool[:3, :3] @ wrist_in_tool(chain, q).shaft
    return ToolPose(T_camera_tool, covariance, axis)


def nominal_tag_rotation(
    T_camera_base: Array | None, fiducial: Fiducial, chain: DHChain, q: Array
) -> Array | None:
    """The tag's rotation in the camera frame by the nominal kinematics, shape (3, 3); None without the robot's base."""
    if T_camera_base is None:
        return None
    T_base_link = frame_transforms(chain, q)[row_index(chain, fiducial.link)]
    return np.asarray((T_camera_base @ T_base_link @ fiducial.T_link_tag)[:3, :3])


def _joint_covariance(
    chain: DHChain, frames: Array, link: str, tool_m: Array, R_camera_base: Array, error: KinematicError
) -> Array:
    """What the errors of the joints behind the tag's link do to the tool, shape (6, 6) in the camera frame."""
    covariance = np.zeros((6, 6))
    for index in range(row_index(chain, link) + 1, len(chain.rows)):
        kind = chain.rows[index].joint
        if kind == "fixed":
            continue
        z, at_m = joint_axis(chain, frames, index)
        if kind == "revolute":
            column = error.joint_std_rad * np.concatenate([np.cross(z, tool_m - at_m), z])
        else:
            column = error.joint_std_m * np.concatenate([z, np.zeros(3)])
        turned = np.concatenate([R_camera_base @ column[:3], R_camera_base @ column[3:]])
        covariance += np.outer(turned, turned)
    return covariance

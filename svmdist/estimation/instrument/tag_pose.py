"""The tag's pose from one image, its planar ambiguity resolved, and the tool behind it."""

from __future__ import annotations

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.estimation.instrument.wrist import wrist_in_tool
from svmdist.geometry.rays import pixel_rays
from svmdist.kinematics.dh import DHChain, frame_transforms
from svmdist.kinematics.jacobian import joint_axis, row_index
from svmdist.profile import Fiducial, KinematicError
from svmdist.samples import Image
from svmdist.transforms import Array, inverse, make_transform, rotation_angle, skew
from svmdist.vision.tag.detection import pose_candidates
from svmdist.vision.tag.pattern import TagPattern
from svmdist.vision.tag.refinement import TagPose, refine_pose

WINDOW_MARGIN = 0.2
"""Pixels around the tag that are looked at, over its size in the image."""
FIRST_ITERATIONS = 10
DECIDED = 1.15
"""Ratio of the residuals above which the image itself decides between the two poses. Over 347 frames of
simulated logs the ratio was above 1.3 in nine of ten."""
NEAR_RAD = 0.05
"""Poses closer than this are one: a tag that is seen head-on has one minimum, with a wide covariance."""
SURE_RAD = 0.03
"""A belief this sure tells the two poses apart even where they are closest, at 10° of tilt 0.35 rad."""
BELIEVED_WITHIN_RAD = 0.35
"""How far the believed pose may be off for it to decide: twice 2° about each axis and 1° in each of seven joints."""


def find_tag_pose(
    image_grey: Image,
    corners_px: Array,
    camera: Camera,
    pattern: TagPattern,
    R_camera_tag_believed: Array | None,
    believed_std_rad: float = np.inf,
) -> TagPose | None:
    """Pose of a tag with these corners, shape (4, 2); None where nothing decides between the two that fit.

    The pattern's residual decides where it can; else the rotation that the robot believes, shape (3, 3). A belief of
    which `believed_std_rad` is small leaves one pose to look for, a third of the work.
    """
    brightness, rays = _window(image_grey, corners_px, camera)
    focal_px = float(camera.K[0, 0])
    starts = pose_candidates(corners_px, pattern.size_m, camera.K, camera.D)
    if R_camera_tag_believed is not None and believed_std_rad < SURE_RAD and starts:
        off = [float(rotation_angle(T[:3, :3], R_camera_tag_believed)) for T in starts]
        nearest = starts[int(np.argmin(off))]
        if min(off) < BELIEVED_WITHIN_RAD:
            start = make_transform(R_camera_tag_believed, nearest[:3, 3])
            return refine_pose(brightness, rays, start, pattern, focal_px)
    found = [refine_pose(brightness, rays, T, pattern, focal_px, FIRST_ITERATIONS) for T in starts]
    poses = sorted((pose for pose in found if pose is not None), key=lambda pose: pose.residual)
    if not poses:
        return None
    best = _decide(poses, R_camera_tag_believed)
    if best is None:
        return None
    return refine_pose(brightness, rays, best.T_camera_tag, pattern, focal_px)


def tool_behind_tag(
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


def believed_tag_rotation(
    T_camera_base: Array | None, fiducial: Fiducial, chain: DHChain, q: Array
) -> Array | None:
    """The tag's rotation in the camera frame that the robot believes, shape (3, 3); None without its base."""
    if T_camera_base is None:
        return None
    T_base_link = frame_transforms(chain, q)[row_index(chain, fiducial.link)]
    return np.asarray((T_camera_base @ T_base_link @ fiducial.T_link_tag)[:3, :3])


def _decide(poses: list[TagPose], R_believed: Array | None) -> TagPose | None:
    best, *others = poses
    if not others or others[0].residual > DECIDED * best.residual:
        return best
    if float(rotation_angle(best.T_camera_tag[:3, :3], others[0].T_camera_tag[:3, :3])) < NEAR_RAD:
        return best
    if R_believed is None:
        return None
    off = [float(rotation_angle(pose.T_camera_tag[:3, :3], R_believed)) for pose in poses]
    nearest = int(np.argmin(off))
    return poses[nearest] if off[nearest] < BELIEVED_WITHIN_RAD else None


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


def _window(image_grey: Image, corners_px: Array, camera: Camera) -> tuple[Array, Array]:
    """Brightness, shape (n,), and rays, shape (n, 3), of the pixels around a tag."""
    height, width = image_grey.shape
    margin = WINDOW_MARGIN * float(np.ptp(corners_px, axis=0).max())
    x0, y0 = np.clip(np.floor(corners_px.min(0) - margin), 0, [width - 1, height - 1]).astype(int)
    x1, y1 = np.clip(np.ceil(corners_px.max(0) + margin) + 1, 1, [width, height]).astype(int)
    # Only what is inside the quadrilateral and its margin can lie on the tag.
    mask = np.zeros((y1 - y0, x1 - x0), np.uint8)
    middle = corners_px.mean(0)
    grown = middle + (1.0 + 2.0 * WINDOW_MARGIN) * (corners_px - middle) - [x0, y0]
    cv2.fillConvexPoly(mask, np.round(grown).astype(np.int32), 255)
    y, x = np.nonzero(mask)
    points_px = np.column_stack([x + x0, y + y0]).astype(np.float64)
    return image_grey[y + y0, x + x0].astype(np.float64), pixel_rays(camera, points_px)

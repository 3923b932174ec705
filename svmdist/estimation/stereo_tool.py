"""The tool from a rectified pair: the knuckle's disparity gives its depth, the shaft's silhouette its direction.

The two views cut the knuckle alike, so that most of what moves its centroid is gone from the disparity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.filter.nominal import nominal_tool
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.estimation.instrument.shaft_model import apparent_radius_px
from svmdist.estimation.instrument.shaft_sight import Knuckle
from svmdist.kinematics.dh import DHChain
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile import KinematicError
from svmdist.transforms import Array, rotation_of
from svmdist.vision.rectified import FAR_M, RectifiedPair

ROW_TOLERANCE_PX = 3.0
"""Corresponding points of rectified images lie on one row; the knuckle is cut a little differently."""
DISPARITY_STD = 0.012
"""Over the knuckle's radius: jaws and fork hide other parts of it from another side. 3 degrees between the views of
the 45 thousandths by which they move the centroid in either."""
DISPARITY_NOISE_PX = 0.05
SIZE_TOLERANCE = 0.2
"""A whole knuckle is as large as its depth makes it; what is smaller is partly hidden, in both views alike."""
MAX_DEPTH_STD_M = 0.004
GATE_STDS = 3.5


@dataclass(frozen=True, slots=True)
class SeenTwice:
    """The knuckle in both views: centre in the left one, (2,), disparity, and their standard deviations, in px."""

    left_px: Array
    std_px: float
    disparity_px: float
    disparity_std_px: float


def match_knuckle(
    left: Knuckle | None, right: Knuckle | None, pair: RectifiedPair, radius_m: float | None, camera: Camera
) -> SeenTwice | str:
    """Pair the knuckles of both views; or why they cannot be, in words. `radius_m` is a whole knuckle's, if known."""
    if left is None or right is None:
        return "the instrument is seen in one view only"
    if abs(left.centre_px[1] - right.centre_px[1]) > ROW_TOLERANCE_PX + left.std_px + right.std_px:
        return "the views do not agree on the instrument"
    disparity_px = pair.disparity_px(float(left.centre_px[0]), float(right.centre_px[0]))
    if disparity_px <= pair.disparity_at(FAR_M):
        return f"the instrument's disparity, {disparity_px:.1f} px, is that of a point beyond {FAR_M} m"
    p_camera_m, _ = pair.point(left.centre_px, disparity_px)
    whole_px = left.radius_px or right.radius_px or 2.0 * left.std_px
    if radius_m is not None:
        whole_px = float(apparent_radius_px(p_camera_m, radius_m, camera))
    std_px = left.std_px
    disparity_std_px = float(np.hypot(DISPARITY_NOISE_PX, DISPARITY_STD * whole_px))
    for knuckle in (left, right):
        radius_px = knuckle.radius_px
        if radius_px is None or abs(radius_px / whole_px - 1.0) > SIZE_TOLERANCE:
            # How much is hidden may differ between the views by as much as it moves the centroid in one.
            std_px = max(std_px, 0.5 * whole_px)
            disparity_std_px = float(np.hypot(disparity_std_px, 0.5 * whole_px))
    depth_std_m = p_camera_m[2] / disparity_px * disparity_std_px
    if depth_std_m > MAX_DEPTH_STD_M:
        return "the instrument is partly hidden: its disparity tells no depth"
    return SeenTwice(left.centre_px, std_px, disparity_px, disparity_std_px)


def deepen(pose: ToolPose, seen: SeenTwice, pair: RectifiedPair) -> ToolPose | None:
    """A pose of one view, corrected by the disparity; None where the two contradict each other.

    A Kalman update with the single observation d = f b / z, iterated, since it is far from linear.
    """
    P = pose.covariance
    position_m = pose.position_m
    step: Array = np.zeros(6)
    for iteration in range(4):
        z = float(position_m[2] + step[2])
        if z <= 0.0:
            return None
        H = np.zeros(6)
        H[2] = -pair.disparity_at(z) / z
        S = float(H @ P @ H) + seen.disparity_std_px**2
        innovation = seen.disparity_px - pair.disparity_at(z) + float(H @ step)
        if iteration == 0 and abs(innovation) > GATE_STDS * np.sqrt(S):
            return None
        K = P @ H / S
        step = K * innovation
    T = pose.T_camera_tool.copy()
    T[:3, 3] += step[:3]
    turn = rotation_of(step[3:])
    T[:3, :3] = turn @ T[:3, :3]
    keep = np.eye(6) - np.outer(K, H)
    covariance = keep @ P @ keep.T + np.outer(K, K) * seen.disparity_std_px**2
    return ToolPose(T, covariance, turn @ pose.axis)


def believed_pose(
    seen: SeenTwice, pair: RectifiedPair, belief: RobotState, chain: DHChain, error: KinematicError
) -> ToolPose:
    """The triangulated position with the direction that the robot believes, as sure as the profile says."""
    p_camera_m, J = pair.point(seen.left_px, seen.disparity_px)
    believed = nominal_tool(chain, error, belief)
    T_camera_tool, covariance = believed.T_camera_tool.copy(), np.zeros((6, 6))
    T_camera_tool[:3, 3] = p_camera_m
    variances = np.array([seen.std_px, seen.std_px, seen.disparity_std_px]) ** 2
    covariance[:3, :3] = J @ np.diag(variances) @ J.T
    covariance[3:, 3:] = believed.covariance[3:, 3:]
    return ToolPose(T_camera_tool, covariance, believed.axis)

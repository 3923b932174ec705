"""The tool's pose from the distal marker's disparity alone: it places the nominal one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from svmdist.estimation.detection.stereo_match import StereoMatch
from svmdist.estimation.filter.constants import Deviations
from svmdist.results import ToolPose
from svmdist.samples import RightView
from svmdist.transforms import inverse
from svmdist.vision.rectified import RectifiedPair


def with_calibration(
    match: StereoMatch, right: RightView, pair: RectifiedPair, deviations: Deviations
) -> StereoMatch:
    """The match with what baseline and the right camera's rotation may be off by in its disparity's deviation."""
    p_camera_m, _ = pair.point(match.left_px, match.disparity_px)
    biases = deviations.of_disparity_at(
        p_camera_m, right.camera, np.array(match.disparity_px), inverse(right.T_left_right)
    )
    variance_px2 = sum(float(np.sum(bias.jacobian**2)) for bias in biases)
    return replace(match, disparity_std_px=float(np.sqrt(match.disparity_std_px**2 + variance_px2)))


def nominal_orientation_pose(match: StereoMatch, pair: RectifiedPair, nominal: ToolPose) -> ToolPose:
    """The triangulated position with the orientation, and its covariance, of the nominal kinematics."""
    p_camera_m, J = pair.point(match.left_px, match.disparity_px)
    T_camera_tool, covariance = nominal.T_camera_tool.copy(), np.zeros((6, 6))
    T_camera_tool[:3, 3] = p_camera_m
    variances = np.array([match.std_px, match.std_px, match.disparity_std_px]) ** 2
    covariance[:3, :3] = J @ np.diag(variances) @ J.T
    covariance[3:, 3:] = nominal.covariance[3:, 3:]
    return ToolPose(T_camera_tool, covariance, nominal.axis)

"""The tool by each independent way that one frame has: kinematics, shaft, marker, disparity, tag."""

from __future__ import annotations

import numpy as np

from svmdist.estimation.comparison import DISPARITY, KINEMATICS, MARKER, SHAFT, TAG
from svmdist.estimation.frame import Frame
from svmdist.estimation.frame_methods import ANY_ORIENTATION, tool_from_tag, triangulated_tool
from svmdist.results import Failure, ToolPose
from svmdist.transforms import Array, cross
from svmdist.vision.lines import apparent_radius_px, axis_of_cylinder

MOST_WRONG = 3.0
"""By which factor a radius is mistaken: a diameter is twice. Farther off, a strip of the shaft was taken for all."""
WRIST_STD_M = 5e-3  # by which the shaft's axis passes before or behind the marker, where the wrist is bent


def places(frame: Frame) -> dict[str, ToolPose]:
    """The tool by each way that the log has."""
    arm, robot, found = frame.arm, frame.robot_in_camera, dict[str, ToolPose]()
    if not isinstance(robot, Failure):
        found[KINEMATICS] = arm.nominal_tool(robot)
    if arm.profile.segmentation.shaft is not None and arm.body is not None and arm.chain is not None:
        fit = frame.shaft_pose
        # Even if inconsistent: a wrong size makes it so. Without the sides it is by the marker's size.
        if not isinstance(fit, Failure) and len([name for name in fit.used if name.startswith("edge")]) == 2:
            found[SHAFT] = fit.pose
        elif (pose := _by_width(frame)) is not None:
            found[SHAFT] = pose
    if (size := _by_marker_size(frame)) is not None:
        found[MARKER] = size
    by_pair = triangulated_tool(frame, ANY_ORIENTATION)
    if not isinstance(by_pair, Failure):
        found[DISPARITY] = by_pair
    others_m = [found[name].position_m[2] for name in (MARKER, DISPARITY) if name in found]
    if SHAFT in found and others_m:
        ratio = found[SHAFT].position_m[2] / float(np.median(others_m))
        if not 1.0 / MOST_WRONG < ratio < MOST_WRONG:
            del found[SHAFT]
    if frame.tag is not None and not isinstance(frame.robot, Failure):
        found[TAG] = tool_from_tag(arm, frame.left.camera, frame.tag, frame.robot)
    return found


def _at_depth(depth_m: float, std_m: float, ray: Array) -> ToolPose:
    """A tool of which only the depth along a ray, (3,) with z = 1, is known."""
    T, covariance = np.eye(4), np.eye(6)
    T[:3, 3] = depth_m * ray
    covariance[:3, :3] = std_m**2 * np.outer(ray, ray) + 1e-8 * np.eye(3)
    return ToolPose(T, covariance, np.array([1.0, 0.0, 0.0]))


def _by_width(frame: Frame) -> ToolPose | None:
    """The tool where the shaft's axis passes before or behind the marker, by both sides; None without them."""
    view, instrument, marker = frame.left, frame.arm.profile.instrument, frame.left.distal_marker
    if instrument is None or marker is None or len(view.shaft.contours) < 2:
        return None
    planes = view.shaft.contours
    axis = axis_of_cylinder(planes, instrument.shaft_radius_m)
    if axis is None:
        return None
    ray = view.camera.rays(marker.centre_px)[0]
    depth_m = axis.depth_m(ray)
    width = float(np.linalg.norm(cross(planes[0].normal, planes[1].normal)))
    width_std = float(np.sqrt(sum(np.trace(plane.covariance) for plane in planes))) / max(width, 1e-6)
    std = float(np.hypot(width_std, instrument.shaft_radius_std_fraction))
    return _at_depth(depth_m, float(np.hypot(std * depth_m, WRIST_STD_M)), ray) if depth_m > 0.0 else None


def _by_marker_size(frame: Frame) -> ToolPose | None:
    """The tool where the distal marker has its size; None where it is not whole."""
    view, instrument = frame.left, frame.arm.profile.instrument
    marker = view.distal_marker
    if instrument is None or marker is None or marker.radius_px is None or marker.disc is None:
        return None
    ray = view.camera.rays(marker.disc.centre_px)[0]
    depth_m = float(apparent_radius_px(ray, instrument.knuckle_radius_m, view.camera)) / marker.radius_px
    std = float(np.hypot(marker.radius_std_px / marker.radius_px, instrument.knuckle_radius_std_fraction))
    return _at_depth(depth_m, std * depth_m, ray)

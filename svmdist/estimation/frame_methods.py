"""The methods without a filter: nominal kinematics, the instrument's tag, the shaft's silhouette, and both views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.distances import measured, with_tissue
from svmdist.estimation.frame import Frame
from svmdist.estimation.instrument.consistency import with_detections
from svmdist.estimation.instrument.distal_marker import pair_markers
from svmdist.estimation.instrument.error_model import ErrorModel, nominal_tool
from svmdist.estimation.instrument.factors import DISPARITY, marker_place_m
from svmdist.estimation.instrument.image_pose import ImagePose
from svmdist.estimation.instrument.model import wrist_in_tool
from svmdist.estimation.instrument.tag_pose import TagPose
from svmdist.estimation.scene import Arm
from svmdist.estimation.tissue.detection import TissuePose, require_tissue, tissue_plane
from svmdist.estimation.tissue.tracking import TissueTracker, surface_by_stereo
from svmdist.kinematics.robot_state import RobotState
from svmdist.results import Failure, FrameResult, ToolEstimate, ToolPose
from svmdist.samples import Rejection, Status
from svmdist.transforms import Array, inverse, skew

MUCH_SURER = 2.0  # than what is seen, the profile's surface is: breath and dents are seen only
BOUND_AT_M = 0.1  # from an endoscope to a tool at work


class KinematicEstimator:
    """`--method kinematic`: nothing of the tool is taken from the image. Keeps the tissue's pose between frames."""

    def __init__(self, arm: Arm) -> None:
        self._tissue = TissueTracker(arm.profile.settings.tissue)

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; without joints or a camera-to-base transform there is nothing to say."""
        tissue, result = self._tissue.add(frame.scene.tissue), with_tissue(frame)
        robot = frame.robot_in_camera
        if isinstance(robot, Failure):
            return result.rejected(Status.NO_JOINTS, robot.reason)
        if tissue is None:
            return result
        return measured(result.rejected(Status.OK), frame, ToolEstimate(_nominal(frame, robot), frame.joints), tissue)


def _nominal(frame: Frame, robot: RobotState) -> ToolPose:
    return nominal_tool(frame.arm.required_chain, frame.arm.profile.kinematic_error, robot)


def by_tag(frame: Frame) -> FrameResult:
    """`--method fiducial`; a frame that cannot be measured says why."""
    # The tissue, on the plane that it lies on.
    result, tissue = with_tissue(frame), frame.scene.tissue
    if tissue is None or tissue.pose is None:
        return result

    # The tag: corners, then both poses that they allow, and the one of them that is true.
    if frame.left.tag_corners_px is None:
        return result.rejected(Status.NO_FIDUCIAL)
    if isinstance(frame.robot, Failure):
        return result.rejected(Status.NO_JOINTS, frame.robot.reason)
    tag = frame.tag
    if tag is None:
        return result.rejected(Status.AMBIGUOUS_POSE)

    # Through mounting and wrist to the tool, and the distances from there.
    pose = tool_from_tag(frame.arm, frame.left.camera, tag, frame.robot)
    return measured(result, frame, ToolEstimate(pose, frame.joints, frame.left.has_plate), tissue.pose)


def tool_from_tag(arm: Arm, camera: Camera, tag: TagPose, robot: RobotState) -> ToolPose:
    """The tool's pose from that of the arm's tag, through the mounting and the joints behind it."""
    fiducial = arm.profile.fiducial
    assert fiducial is not None  # it was found
    T_base_tag = robot.T_base_link(fiducial.link) @ fiducial.T_link_tag
    robot = replace(robot, T_camera_base=tag.T_camera_tag @ inverse(T_base_tag))
    T_camera_tool = robot.T_camera_tool

    def carried(from_m: Array) -> Array:
        """What an error (δp, δθ) of a frame at a point, (3,), does to a tool that is fixed to it: (6, 6)."""
        J = np.eye(6)
        J[:3, 3:] = -skew(T_camera_tool[:3, 3] - from_m)
        return J

    J = carried(tag.T_camera_tag[:3, 3])
    biases = arm.deviations.of_tag(tag.T_camera_tag, np.diag(camera.K)[:2])
    of_parameters = sum((bias.jacobian @ bias.jacobian.T for bias in biases), np.zeros((6, 6)))
    covariance = J @ (tag.covariance + of_parameters) @ J.T
    # What the errors of kinematics do to the tool, less what they do to it through the tag's link.
    model = ErrorModel(robot.chain, arm.profile.kinematic_error)
    links = model.nominal_links(robot)
    link = links.link(fiducial.link)
    behind = links.link(None).derivative - carried(link.T_camera_link[:3, 3]) @ link.derivative
    covariance += behind @ model.prior(robot) @ behind.T
    axis = T_camera_tool[:3, :3] @ wrist_in_tool(robot.chain, robot.q).shaft
    return ToolPose(T_camera_tool, covariance, axis)


def certain(frame: Frame, found: ImagePose | Failure, max_std_m: float) -> ImagePose | Rejection:
    """A pose by images that nothing contradicts and that is as certain as a method wants it, or why there is none.

    Beyond `BOUND_AT_M` the bound grows in proportion: errors of size, focal length and disparity are shares of a depth.
    """
    if isinstance(found, Failure):
        return Rejection(frame.stamp_ns, Status.NO_INSTRUMENT, found.reason)
    if found.contradiction:
        return Rejection(frame.stamp_ns, Status.INCONSISTENT, found.contradiction)
    max_std_m *= max(1.0, float(np.linalg.norm(found.pose.position_m)) / BOUND_AT_M)
    if not found.pose.position_std_m <= max_std_m:  # NaN is not
        said = f"the position is uncertain by {found.pose.position_std_m * 1e3:.1f} mm"
        return Rejection(frame.stamp_ns, Status.UNCERTAIN, said)
    return found


def by_shaft(frame: Frame) -> FrameResult:
    """`--method shaft`; a frame that cannot be measured says why."""
    # The tissue, on the plane that it lies on.
    result, tissue = with_tissue(frame), frame.scene.tissue
    if tissue is None or tissue.pose is None:
        return result

    # The shaft's edges and end, the distal marker, and the pose that fits them through the wrist.
    fit = frame.shaft_pose
    if isinstance(fit, Failure) and len(frame.left.shaft.contours) == 2:
        return result.rejected(Status.UNCERTAIN, fit.reason)
    if isinstance(fit, ImagePose):
        result = with_detections(result, fit.gating)
    found = certain(frame, fit, frame.arm.profile.settings.shaft.max_position_std_m)
    if isinstance(found, Rejection):
        return result.rejected(found.status, found.detail)
    return measured(result, frame, ToolEstimate(found.pose, frame.joints, frame.left.has_plate), tissue.pose)


def by_both_views(frame: Frame) -> FrameResult:
    """`--method stereo`; a frame that cannot be measured says why."""
    # The tissue's outline in the left view, and the pair's geometry.
    result, tissue, pair = with_tissue(frame), frame.scene.tissue, frame.scene.stereo_pair
    if tissue is None or tissue.pose is None:
        return result
    if isinstance(pair, Failure):
        return result.rejected(Status.NO_STEREO, pair.reason)

    # The tool: its distal marker in both views, and the shaft's direction.
    profile = frame.arm.profile
    has_sizes = profile.segmentation.shaft is not None and profile.instrument is not None
    located = frame.pair_pose if has_sizes else _triangulated(frame)
    if isinstance(located, ImagePose):
        result = with_detections(result, located.gating)
    max_std_m = profile.settings.stereo.max_depth_std_m
    found = located if isinstance(located, Rejection) else certain(frame, located, max_std_m)
    if isinstance(found, Rejection):
        return result.rejected(found.status, found.detail)

    # The tissue's surface, and the distances. A surface by stereo has its own error in place of the dome's.
    seen = surface_by_stereo(frame, tissue.pose)
    tool = ToolEstimate(found.pose, frame.joints, frame.left.has_plate)
    if seen is not None:
        return _to_tissue(result, frame, tool, seen, tissue.pose)
    if not any(name == DISPARITY or name.startswith("right ") for name in found.used):
        return result.rejected(Status.NO_STEREO, "the right view shows neither the instrument nor the tissue's surface")
    said = "the views do not agree on the tissue's surface: the profile's is used"
    return measured(replace(result, detail=said), frame, tool, tissue.pose)


def _triangulated(frame: Frame) -> ImagePose | Rejection | Failure:
    """Without sizes of a shaft: the triangulated marker, with the nominal orientation."""
    robot = frame.robot_in_camera
    pose = triangulated_tool(frame, ANY_ORIENTATION if isinstance(robot, Failure) else _nominal(frame, robot))
    if isinstance(pose, Failure):
        return pose
    if isinstance(robot, Failure):  # a place, and no direction
        return Rejection(frame.stamp_ns, Status.NO_JOINTS, robot.reason)
    return ImagePose(pose, (DISPARITY,), "")


ANY_ORIENTATION = ToolPose(np.eye(4), np.eye(6), np.array([1.0, 0.0, 0.0]))
"""Stands in for one that is not known."""


def triangulated_tool(frame: Frame, nominal: ToolPose) -> ToolPose | Failure:
    """The tool by the triangulated marker, with the orientation, and its covariance, of the nominal kinematics."""
    pair, right = frame.scene.stereo_pair, frame.right
    if isinstance(pair, Failure):
        return pair
    assert right is not None  # the pair has one
    markers = pair_markers(frame, pair)
    if isinstance(markers, Failure):
        return markers
    p_camera_m, J = pair.point(markers.left.pixel, markers.disparity_px)
    # What baseline and the right camera's rotation may be off by is in the disparity's deviation.
    disparity_px = np.array(markers.disparity_px)
    biases = frame.arm.deviations.of_disparity(p_camera_m, right.camera, disparity_px, right.T_view_left)
    of_cameras_px2 = sum(float(np.sum(bias.jacobian**2)) for bias in biases)
    seen, of_disparity_px2 = markers.left, markers.std_px**2 + markers.bias_std_px**2 + of_cameras_px2
    T_camera_tool = nominal.T_camera_tool.copy()
    arm_m = T_camera_tool[:3, :3] @ marker_place_m(frame.arm, seen)
    T_camera_tool[:3, 3] = p_camera_m - arm_m
    lever = np.concatenate([skew(arm_m), np.eye(3)])  # what a turn does to place and direction
    covariance = lever @ nominal.covariance[3:, 3:] @ lever.T
    covariance[:3, :3] += J @ np.diag([seen.std_px**2, seen.std_px**2, of_disparity_px2]) @ J.T
    covariance[:3, :3] += (seen.error.place_std_m**2 + seen.error.part_std_m**2) * np.eye(3)
    return ToolPose(T_camera_tool, covariance, nominal.axis)


def _to_tissue(
    result: FrameResult, frame: Frame, tool: ToolEstimate, seen: TissuePose, by_profile: TissuePose
) -> FrameResult:
    """Distances to the tissue as both views show it, or to the profile's where that is much surer: far from that.

    A profile that what is seen contradicts is no surer.
    """
    found = measured(result, frame, tool, seen)
    normal = tissue_plane(require_tissue(frame.arm.profile)).normal
    # By the profile, without the tool's
    least_std_m = float(np.sqrt(normal @ by_profile.covariance @ normal))
    std_m = None if seen.surface_std_m > 0.0 else _std_m(found)
    if std_m is None or std_m <= MUCH_SURER * least_std_m:
        return found
    said = "the tissue next to the tool is hidden: the profile's is used"
    other = measured(replace(result, detail=said), frame, tool, by_profile)
    if (other_std_m := _std_m(other)) is not None and MUCH_SURER * other_std_m < std_m:
        return other
    frame.left.measured_surface = seen.surface
    return found


def _std_m(result: FrameResult) -> float | None:
    clearance = result.distances.clearance
    return None if clearance is None else clearance.without_overlap_std_m

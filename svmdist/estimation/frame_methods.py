"""The methods without a filter: nominal kinematics, tag, silhouette, both views; the tool by each way of a frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation import comparison
from svmdist.estimation.distances import measured, with_tissue
from svmdist.estimation.frame import Arm, Frame
from svmdist.estimation.instrument.consistency import with_detections
from svmdist.estimation.instrument.distal_marker import pair_markers
from svmdist.estimation.instrument.error_model import ErrorModel
from svmdist.estimation.instrument.factors import DISPARITY, marker_place_m
from svmdist.estimation.instrument.image_pose import ImagePose
from svmdist.estimation.instrument.measurement import disparity_biases, tag_biases
from svmdist.estimation.instrument.model import wrist_in_tool
from svmdist.estimation.instrument.tag_pose import TagPose
from svmdist.estimation.tissue.detection import TissuePose, require_tissue
from svmdist.estimation.tissue.tracking import TissueTracker, surface_by_stereo
from svmdist.kinematics.robot_state import RobotState
from svmdist.results import Failure, FrameResult, ToolEstimate, ToolPose
from svmdist.samples import Rejection, Status
from svmdist.transforms import Array, cross, inverse, skew
from svmdist.vision.lines import apparent_radius_px

MUCH_SURER = 2.0  # than what is seen, the profile's surface is: breath and dents are seen only
BOUND_AT_M = 0.1  # from an endoscope to a tool at work
ANY_ORIENTATION = ToolPose(np.eye(4), np.eye(6), np.array([1.0, 0.0, 0.0]))
"""Stands in for one that is not known."""
MOST_WRONG = 3.0
"""By which factor a radius is mistaken: a diameter is twice. Farther off, a strip of the shaft was taken for all."""
WRIST_STD_M = 5e-3  # by which the shaft's axis passes before or behind the marker, where the wrist is bent


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
        tool = ToolEstimate(frame.arm.nominal_tool(robot), frame.joints)
        return measured(result.rejected(Status.OK), frame, tool, tissue)


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
    biases = tag_biases(tag.T_camera_tag, np.diag(camera.K)[:2], arm.profile.camera_error, fiducial)
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
    """A pose by images that nothing contradicts and that is as certain as a method wants it, or why there is none."""
    if isinstance(found, Failure):
        return Rejection(frame.stamp_ns, Status.NO_INSTRUMENT, found.reason)
    if found.contradiction:
        return Rejection(frame.stamp_ns, Status.INCONSISTENT, found.contradiction)
    # Beyond, the bound grows in proportion: errors of size, focal length and disparity are shares of a depth.
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
    fit = frame.pair_pose if has_sizes else _triangulated(frame)
    if isinstance(fit, ImagePose):
        result = with_detections(result, fit.gating)
    found = fit if isinstance(fit, Rejection) else certain(frame, fit, profile.settings.stereo.max_depth_std_m)
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
    pose = triangulated_tool(frame, ANY_ORIENTATION if isinstance(robot, Failure) else frame.arm.nominal_tool(robot))
    if isinstance(pose, Failure):
        return pose
    if isinstance(robot, Failure):  # a place, and no direction
        return Rejection(frame.stamp_ns, Status.NO_JOINTS, robot.reason)
    return ImagePose(pose, (DISPARITY,), "")


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
    error = frame.arm.profile.camera_error
    biases = disparity_biases(p_camera_m, right.camera, disparity_px, right.T_view_left, error)
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
    """Distances to the tissue as both views show it, or to the profile's where that is much surer: far from that."""
    found = measured(result, frame, tool, seen)
    normal = np.array(require_tissue(frame.arm.profile).plane_normal)
    least_std_m = float(np.sqrt(normal @ by_profile.covariance @ normal))  # by the profile, without the tool's
    std_m = None if seen.surface_std_m > 0.0 else _std_m(found)  # a profile that what is seen contradicts is no surer
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


def places_of(frame: Frame) -> dict[str, ToolPose]:
    """The tool by each way that the log has."""
    arm, robot, found = frame.arm, frame.robot_in_camera, dict[str, ToolPose]()
    if not isinstance(robot, Failure):
        found[comparison.KINEMATICS] = arm.nominal_tool(robot)
    if arm.profile.segmentation.shaft is not None and arm.body is not None and arm.chain is not None:
        fit = frame.shaft_pose
        # Even if inconsistent: a wrong size makes it so. Without the sides it is by the marker's size.
        if not isinstance(fit, Failure) and len([name for name in fit.used if name.startswith("edge")]) == 2:
            found[comparison.SHAFT] = fit.pose
        elif (pose := _by_width(frame)) is not None:
            found[comparison.SHAFT] = pose
    if (size := _by_marker_size(frame)) is not None:
        found[comparison.MARKER] = size
    by_pair = triangulated_tool(frame, ANY_ORIENTATION)
    if not isinstance(by_pair, Failure):
        found[comparison.DISPARITY] = by_pair
    others_m = [found[name].position_m[2] for name in (comparison.MARKER, comparison.DISPARITY) if name in found]
    if comparison.SHAFT in found and others_m:
        ratio = found[comparison.SHAFT].position_m[2] / float(np.median(others_m))
        if not 1.0 / MOST_WRONG < ratio < MOST_WRONG:
            del found[comparison.SHAFT]
    if frame.tag is not None and not isinstance(frame.robot, Failure):
        found[comparison.TAG] = tool_from_tag(arm, frame.left.camera, frame.tag, frame.robot)
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
    axis, planes = view.shaft.axis, view.shaft.contours
    if instrument is None or marker is None or axis is None:
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

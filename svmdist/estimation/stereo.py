"""Both cameras: shaft and disparity give the tool, matching and alignment the tissue's surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from svmdist.estimation.distances import measured, with_tissue
from svmdist.estimation.frame import Frame, Needs, View
from svmdist.estimation.instrument.consistency import with_detections
from svmdist.estimation.instrument.distal_marker import MarkerPair, pair_markers
from svmdist.estimation.instrument.error_model import nominal_tool
from svmdist.estimation.instrument.factors import DISPARITY
from svmdist.estimation.instrument.image_pose import ImagePose
from svmdist.estimation.instrument.measurement import Deviations
from svmdist.estimation.one_view import uncertainty
from svmdist.estimation.scene import Arm
from svmdist.estimation.tissue.detection import TissuePose, require_tissue, tissue_plane
from svmdist.estimation.tissue.tracking import surface_by_stereo
from svmdist.results import Failure, FrameResult, ToolEstimate, ToolPose
from svmdist.samples import Rejection, Status
from svmdist.vision.stereo import RectifiedPair

MUCH_SURER = 2.0  # than what is seen, the profile's surface is: breath and dents are seen only
BOUND_AT_M = 0.1  # from an endoscope to a tool at work


def nominal_orientation_pose(
    markers: MarkerPair, pair: RectifiedPair, right: View, nominal: ToolPose, deviations: Deviations
) -> ToolPose:
    """The triangulated position with the orientation, and its covariance, of the nominal kinematics."""
    p_camera_m, J = pair.point(markers.left.pixel, markers.disparity_px)
    # What baseline and the right camera's rotation may be off by is in the disparity's deviation.
    disparity_px = np.array(markers.disparity_px)
    biases = deviations.of_disparity(p_camera_m, right.camera, disparity_px, right.T_view_left)
    of_cameras_px2 = sum(float(np.sum(bias.jacobian**2)) for bias in biases)
    pixel_std_px = float(
        np.hypot(markers.left.std_px, markers.left.radius_px * markers.left.error.part_std_m)
    )
    disparity_std_px = float(np.hypot(markers.std_px, markers.lasting_std_px))
    T_camera_tool, covariance = nominal.T_camera_tool.copy(), np.zeros((6, 6))
    T_camera_tool[:3, 3] = p_camera_m
    variances = np.array([pixel_std_px**2, pixel_std_px**2, disparity_std_px**2 + of_cameras_px2])
    covariance[:3, :3] = J @ np.diag(variances) @ J.T
    covariance[3:, 3:] = nominal.covariance[3:, 3:]
    return ToolPose(T_camera_tool, covariance, nominal.axis)


def _to_tissue(
    result: FrameResult, frame: Frame, tool: ToolEstimate, seen: TissuePose, by_profile: TissuePose
) -> FrameResult:
    """Distances to the tissue as both views show it, or to the profile's where that is much surer: far from that.

    A profile that what is seen contradicts is no surer.
    """
    found = measured(result, frame, tool, seen)
    normal = tissue_plane(require_tissue(frame.arm.profile)).normal
    least_std_m = float(
        np.sqrt(normal @ by_profile.covariance @ normal)
    )  # by the profile, without the tool's
    std_m = None if seen.surface_std_m > 0.0 else _std_m(found)
    if std_m is None or std_m <= MUCH_SURER * least_std_m:
        return found
    said = "the tissue next to the tool is hidden: the profile's is used"
    other = measured(replace(result, detail=said), frame, tool, by_profile)
    if (other_std_m := _std_m(other)) is not None and MUCH_SURER * other_std_m < std_m:
        return other
    frame.left.found["measured_surface"] = seen.surface
    return found


def _std_m(result: FrameResult) -> float | None:
    clearance = result.distances.clearance
    return None if clearance is None else clearance.without_overlap_std_m


class StereoEstimator:
    """`--method stereo`. Keeps between frames whether it saw the tag's plate, and nothing else."""

    name = "stereo"
    keeps_state = True

    def __init__(self, arm: Arm) -> None:
        profile = arm.profile
        require_tissue(profile)
        self._chain = arm.required_chain
        self._profile = profile
        self._uses_shaft = profile.segmentation.shaft is not None and profile.instrument is not None
        self._has_plate = False
        parts = ("distal_marker", "shaft") if self._uses_shaft else ("distal_marker",)
        views = tuple(f"{view}.{part}" for part in parts for view in ("left", "right"))
        self.needs = Needs(("tissue", "stereo_surface", "left.tags"), views, right_view=True)

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; a frame that cannot be measured says why."""
        # The tissue's outline in the left view, and the pair's geometry.
        result, tissue, pair = with_tissue(frame), frame.scene.tissue, frame.scene.stereo_pair
        if tissue is None or tissue.pose is None:
            return result
        if isinstance(pair, Failure):
            return result.rejected(Status.NO_STEREO, pair.reason)

        # The tool: its distal marker in both views, and the shaft's direction.
        located = self._located(frame, pair)
        if isinstance(located, ImagePose):
            result = with_detections(result, located.gating)
        found = self._certain(frame, located)
        if isinstance(found, Rejection):
            return result.rejected(found.status, found.detail)

        # The tissue's surface, and the distances. A surface by stereo has its own error in place of the dome's.
        seen = surface_by_stereo(frame, tissue.pose)
        tool = ToolEstimate(found.pose, frame.joints, self._has_plate)
        if seen is not None:
            return _to_tissue(result, frame, tool, seen, tissue.pose)
        if not found.is_by_right_view:
            said = "the right view shows neither the instrument nor the tissue's surface"
            return result.rejected(Status.NO_STEREO, said)
        said = "the views do not agree on the tissue's surface: the profile's is used"
        return measured(replace(result, detail=said), frame, tool, tissue.pose)

    def tool(self, frame: Frame, pair: RectifiedPair) -> ImagePose | Rejection:
        """The tool by both views, where it is certain enough."""
        return self._certain(frame, self._located(frame, pair))

    def _certain(self, frame: Frame, found: ImagePose | Rejection | Failure) -> ImagePose | Rejection:
        if isinstance(found, Rejection):
            return found
        if isinstance(found, Failure):
            return Rejection(frame.stamp_ns, Status.NO_INSTRUMENT, found.reason)
        if found.doubt:
            return Rejection(frame.stamp_ns, Status.INCONSISTENT, found.doubt)
        # What a disparity tells of depth is a share of it.
        share = max(1.0, float(np.linalg.norm(found.pose.position_m)) / BOUND_AT_M)
        if said := uncertainty(found.pose, share * self._profile.stereo_in_range.max_depth_std_m):
            return Rejection(frame.stamp_ns, Status.UNCERTAIN, said)
        return found

    def _located(self, frame: Frame, pair: RectifiedPair) -> ImagePose | Rejection | Failure:
        """What both views show, fitted together; without sizes of a shaft the triangulated marker, turned nominally."""
        self._has_plate |= frame.left.tag_corners_px is not None
        return frame.pair_pose if self._uses_shaft else self._triangulated(frame, pair)

    def _triangulated(self, frame: Frame, pair: RectifiedPair) -> ImagePose | Rejection | Failure:
        robot, right = frame.robot_in_camera, frame.right
        markers = pair_markers(frame, pair)
        if isinstance(markers, Failure):
            return markers
        if isinstance(robot, Failure):  # a place, and no direction
            return Rejection(frame.stamp_ns, Status.NO_JOINTS, robot.reason)
        assert right is not None  # the pair has one
        nominal = nominal_tool(self._chain, self._profile.kinematic_error, robot)
        pose = nominal_orientation_pose(markers, pair, right, nominal, frame.arm.deviations)
        return ImagePose(pose, (DISPARITY,), "")

"""Both cameras: shaft and disparity give the tool, matching and alignment the tissue's surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from svmdist.estimation.distances import measured, with_tissue
from svmdist.estimation.frame import Frame, Needs
from svmdist.estimation.instrument.consistency import with_detections
from svmdist.estimation.instrument.error_model import nominal_tool
from svmdist.estimation.instrument.factors import DISPARITY, MarkerPair, pair_markers
from svmdist.estimation.instrument.image_pose import ImagePose, pose_by_pair
from svmdist.estimation.instrument.measurement import Deviations
from svmdist.estimation.one_view import uncertainty
from svmdist.estimation.scene import Arm
from svmdist.estimation.surface import StereoSurface
from svmdist.estimation.tissue import require_tissue
from svmdist.estimation.tissue_tracking import depth_biases
from svmdist.geometry import Cloud
from svmdist.results import Failure, FrameResult, ToolEstimate, ToolPose
from svmdist.samples import Rejection, RightView, Status
from svmdist.transforms import inverse
from svmdist.vision.stereo import RectifiedPair

DEPTH_GATE_STDS = 3.5  # between disparity and one view's pose, above which they contradict each other


def nominal_orientation_pose(
    markers: MarkerPair, pair: RectifiedPair, right: RightView, nominal: ToolPose, deviations: Deviations
) -> ToolPose:
    """The triangulated position with the orientation, and its covariance, of the nominal kinematics."""
    p_camera_m, J = pair.point(markers.left.pixel, markers.disparity_px)
    # What baseline and the right camera's rotation may be off by is in the disparity's deviation.
    biases = deviations.of_disparity_at(
        p_camera_m, right.camera, np.array(markers.disparity_px), inverse(right.T_left_right)
    )
    of_cameras_px2 = sum(float(np.sum(bias.jacobian**2)) for bias in biases)
    pixel_std_px, disparity_std_px = markers.total_std_px
    T_camera_tool, covariance = nominal.T_camera_tool.copy(), np.zeros((6, 6))
    T_camera_tool[:3, 3] = p_camera_m
    variances = np.array([pixel_std_px**2, pixel_std_px**2, disparity_std_px**2 + of_cameras_px2])
    covariance[:3, :3] = J @ np.diag(variances) @ J.T
    covariance[3:, 3:] = nominal.covariance[3:, 3:]
    return ToolPose(T_camera_tool, covariance, nominal.axis)


class StereoEstimator:
    """`--method stereo`. Keeps between frames whether it saw the tag's plate, and nothing else."""

    name = "stereo"
    keeps_state = True

    def __init__(self, arm: Arm) -> None:
        profile = arm.profile
        self._tissue = require_tissue(profile)
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
        surface, seen = frame.scene.stereo_surface, tissue.pose
        if surface is None and not found.is_by_right_view:
            said = "the right view shows neither the instrument nor the tissue's surface"
            return result.rejected(Status.NO_STEREO, said)
        if surface is None:
            said = "the views do not agree on the tissue's surface: the profile's is used"
            result = replace(result, detail=said)
        else:
            std_m = float(np.hypot(surface.std_m, self._calibration_std_m(surface, frame)))
            std_m = float(np.hypot(std_m, self._off_plane_m(surface, std_m)))
            seen = replace(tissue.pose, surface=Cloud(surface.points_m), surface_std_m=std_m, dome=None)
        return measured(result, frame, ToolEstimate(found.pose, frame.joints, self._has_plate), seen)

    def _off_plane_m(self, surface: StereoSurface, std_m: float) -> float:
        """How far the surface stands off where the profile's plane and shape allow it, 0 where it does not."""
        tissue = self._tissue
        if tissue.mesh is not None:
            return 0.0
        height_m = surface.points_m @ np.array(tissue.plane_normal) + tissue.plane_distance_m
        top_m, shape_m = 0.0, tissue.surface_std_m
        if tissue.dome is not None:
            top_m, shape_m = tissue.dome.height_m, tissue.dome.height_std_m
        tilt_m = tissue.plane_tilt_std_rad * float(np.linalg.norm(np.median(surface.points_m, 0)[:2]))
        parts = (std_m, tissue.plane_distance_std_m, tissue.motion_std_m, shape_m, tilt_m)
        allowed_m = DEPTH_GATE_STDS * float(np.linalg.norm(parts))
        middle_m = float(np.median(height_m))
        off_m = max(-middle_m, middle_m - top_m, 0.0)
        return off_m if off_m > allowed_m else 0.0

    def _calibration_std_m(self, surface: StereoSurface, frame: Frame) -> float:
        """How far all of the surface may be off in depth by focal length, baseline and the right camera's rotation."""
        right = frame.scene.observation.right
        assert right is not None  # the surface is of both views
        at_m = np.median(surface.points_m, 0)
        biases = depth_biases(at_m, frame.left.camera, right, frame.arm.deviations)
        return float(np.sqrt(sum(float(np.sum(bias.jacobian**2)) for bias in biases)))

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
        if said := uncertainty(found.pose, self._profile.stereo_in_range.max_depth_std_m):
            return Rejection(frame.stamp_ns, Status.UNCERTAIN, said)
        return found

    def _located(self, frame: Frame, pair: RectifiedPair) -> ImagePose | Rejection | Failure:
        """What both views show, fitted together; without sizes of a shaft the triangulated marker, turned nominally."""
        self._has_plate |= frame.left.tag_corners_px is not None
        return pose_by_pair(frame, pair) if self._uses_shaft else self._triangulated(frame, pair)

    def _triangulated(self, frame: Frame, pair: RectifiedPair) -> ImagePose | Rejection | Failure:
        robot, right = frame.robot_in_camera, frame.scene.observation.right
        markers = pair_markers(frame, pair)
        if isinstance(markers, Failure):
            return markers
        if isinstance(robot, Failure):  # a place, and no direction
            return Rejection(frame.stamp_ns, Status.NO_JOINTS, robot.reason)
        assert right is not None  # the pair has one
        nominal = nominal_tool(self._chain, self._profile.kinematic_error, robot)
        pose = nominal_orientation_pose(markers, pair, right, nominal, frame.arm.deviations)
        return ImagePose(pose, (DISPARITY,), "")

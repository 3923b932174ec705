"""What the detections of one frame say to the filter: each becomes a measurement of a link, with noise and bias."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.distances import measured, with_tissue, with_tool
from svmdist.estimation.frame import Frame, Needs
from svmdist.estimation.instrument.consistency import GatingResult, chi_square_bound
from svmdist.estimation.instrument.error_model import nominal_tool
from svmdist.estimation.instrument.kinematic_error_filter import KinematicErrorFilter, Start, as_measurement
from svmdist.estimation.instrument.measurement import LinkMeasurement
from svmdist.estimation.instrument.measurement_kinds import (
    POSE_CORRELATION_TIME_S,
    ContourMeasurement,
    DisparityMeasurement,
    PointMeasurement,
    PoseMeasurement,
    SizeMeasurement,
)
from svmdist.estimation.instrument.shaft_detection import BORDER_STD_PER_BLUR, DistalMarker, marker_centre
from svmdist.estimation.instrument.two_views import ROW_TOLERANCE_PX
from svmdist.estimation.one_view import tool_from_tag
from svmdist.estimation.scene import Arm
from svmdist.estimation.stereo import StereoEstimator
from svmdist.estimation.tissue_tracking import FollowedTissue
from svmdist.kinematics.robot_state import RobotState
from svmdist.results import Distances, Failure, FrameResult, ToolEstimate, ToolPose
from svmdist.samples import JointSample, Status
from svmdist.transforms import inverse
from svmdist.vision.edges import Disc
from svmdist.vision.regions import Region

VISIBLE_MIDDLE = 0.05  # off the true one over the radius: 6 % of the disc hidden on one side moves it so
SHADING_BIAS = 0.12  # over radius and angle of the light: half of √(1 - 0.97²), Lambert's dark limb
CENTRE_NOISE = 0.02  # what is left over the radius: pixels, shading, the view's angle
UNKNOWN_SHAPE_STD_PX = 4.0  # a third of the marker's radius, as where blood covers a side of it
MIN_VISIBLE_FRACTION = 0.4  # of a whole marker's area: with less of it visible its centroid cannot be used
WHOLE_AREA_SPREAD = 0.1  # of a whole marker over its disc's: jaws hide some, a fork adds
MIN_RELATIVE_DEPTH_STD = 0.01  # where depth is known this well, the marker's size adds nothing
TRACKED_DISPARITY_NOISE = 0.008  # over the radius, where a filter estimates what lasts
INTERLACED_DISPARITY_NOISE = 0.03  # over the radius: colours of both fields are mixed, 0.4 px at 12 px
LASTING_DISPARITY = 0.016  # over the radius: blood and shading differ in each view, 0.1 to 0.2 px at 12 px
# By how much the marker's areas in both views differ when nothing is wrong, over their sum
EVEN_AREA_FRACTION = 0.02
MAX_IMAGE_STD_M = 0.008  # a pose by one view that is less certain tells nothing of where to begin
LOCATED_STD_M = 0.01  # a prediction as certain that agrees with the images needs no start by them
CONTRADICTING_SHARE = (
    0.3  # of what the filter measured, refused: the prediction is wrong, not the images' pose alone
)
MAX_CONTRADICTIONS = 3  # frames in a row: what hides an instrument misleads one or two
LASTING_IMAGE_SHARE = (
    0.8  # of the variance of a pose by the images: edges, end and sizes err alike in each frame
)
YOUNG_S = 2.0  # how long a filter that has begun anew is held to be hardly surer than the images
DEPTH_KNOWN_FRACTION = 0.05  # standard deviation over depth, below which depth tells the marker's size


def measurements(frame: Frame, robot: RobotState, predicted: ToolPose) -> list[LinkMeasurement]:
    """All measurements of the tool in a frame; `predicted` is where the filter expects it."""
    is_told_by_shape = frame.left.masks.seen is not None
    return [
        *(_wrist(frame, predicted) if is_told_by_shape else _distal_marker(frame, predicted)),
        *_size(frame, predicted),
        *_tag(frame, robot, predicted),
        *_contours(frame),
    ]


def _distal_marker(frame: Frame, predicted: ToolPose) -> Iterator[LinkMeasurement]:
    """The distal marker's centre is a point on the tool, as certain as its region is whole; and its disparity."""
    profile, region, camera = frame.arm.profile, frame.left.region, frame.left.camera
    instrument = profile.instrument
    radius_m = instrument.knuckle_radius_m if instrument is not None else 0.0
    if region is None:
        return
    whole_std_px = _centroid_std_px(camera, region, predicted, radius_m)
    if whole_std_px is None:
        return
    depth_m, radius_px = float(predicted.position_m[2]), float(np.sqrt(region.area_px / np.pi))
    place_m, place_std_m = np.zeros(3), 0.0
    if instrument is not None:
        place_m, place_std_m = np.array(instrument.knuckle_position_m), instrument.knuckle_position_std_m
    point_std_m = float(np.hypot(VISIBLE_MIDDLE * radius_m, place_std_m))
    shading_px = SHADING_BIAS * radius_px if radius_m > 0.0 else 0.0
    centre_px, blur_px = marker_centre(region, _disc(frame.left.distal_marker), camera, depth_m, radius_m)
    std_px = float(np.hypot(whole_std_px, BORDER_STD_PER_BLUR * blur_px))
    covariance = std_px**2 * np.eye(2)
    lasts_s = profile.settings.filter.point_correlation_time_s
    yield PointMeasurement(
        "distal marker",
        None,
        camera,
        place_m,
        centre_px,
        covariance,
        point_std_m,
        shading_px,
        correlation_time_s=lasts_s,
        deviations=frame.arm.deviations,
    )

    right, geometry = frame.right, frame.scene.observation.right
    if right is None or right.region is None or geometry is None:
        return
    other = right.region
    if abs(other.centroid_px[1] - region.centroid_px[1]) > ROW_TOLERANCE_PX:
        return
    if _centroid_std_px(right.camera, other, predicted, radius_m) is None:
        return
    # What one view shows more of moves its centroid by up to half of it.
    uneven = abs(region.area_px - other.area_px) / (region.area_px + other.area_px)
    noise = INTERLACED_DISPARITY_NOISE if frame.scene.is_interlaced else TRACKED_DISPARITY_NOISE
    std_px = radius_px * float(np.hypot(noise, max(0.0, uneven - EVEN_AREA_FRACTION)))
    other_px, _ = marker_centre(other, _disc(right.distal_marker), right.camera, depth_m, radius_m)
    yield DisparityMeasurement(
        "disparity",
        None,
        camera,
        right.camera,
        inverse(geometry.T_left_right),
        float(centre_px[0] - other_px[0]),
        np.array([[std_px**2]]),
        point_std_m,
        shading_px,
        correlation_time_s=lasts_s,
        deviations=frame.arm.deviations,
        lasting_std_px=radius_px * LASTING_DISPARITY,
        p_link_m=place_m,
    )


def _wrist(frame: Frame, predicted: ToolPose) -> Iterator[LinkMeasurement]:
    """The tool's origin by the outline of its wrist, where no marker has a colour; and its disparity."""
    wrist, right = frame.left.shaft.wrist, frame.right
    geometry, settings = frame.scene.observation.right, frame.arm.profile.settings
    camera = frame.left.camera
    depth_m = float(predicted.position_m[2])
    if wrist is None or depth_m <= 0.0:
        return
    lasts_s = settings.filter.point_correlation_time_s
    lasting_m = np.sqrt(0.5) * wrist.std_px * depth_m / float(camera.K[0, 0])
    yield PointMeasurement(
        "wrist",
        None,
        camera,
        np.zeros(3),
        wrist.pixel,
        0.5 * wrist.std_px**2 * np.eye(2),
        lasting_m,
        bias_name="wrist",
        correlation_time_s=lasts_s,
        deviations=frame.arm.deviations,
    )
    if right is None or right.shaft.wrist is None or geometry is None:
        return
    other = right.shaft.wrist
    if abs(other.pixel[1] - wrist.pixel[1]) > ROW_TOLERANCE_PX + wrist.std_px:
        return
    variance_px2 = wrist.std_px**2 + other.std_px**2
    yield DisparityMeasurement(
        "disparity",
        None,
        camera,
        right.camera,
        inverse(geometry.T_left_right),
        float(wrist.pixel[0] - other.pixel[0]),
        np.array([[0.5 * variance_px2]]),
        bias_name="wrist",
        correlation_time_s=lasts_s,
        deviations=frame.arm.deviations,
        lasting_std_px=float(np.sqrt(0.5 * variance_px2)),
    )


def _centroid_std_px(camera: Camera, region: Region, predicted: ToolPose, radius_m: float) -> float | None:
    """How far the marker's centroid may be off, by what part of it is missing; None where too much is."""
    x, y, width, height = cv2.boundingRect(region.hull)
    if x <= 0 or y <= 0 or x + width >= camera.width_px or y + height >= camera.height_px:
        return None
    depth_m, depth_std_m = predicted.position_m[2], np.sqrt(predicted.covariance[2, 2])
    if radius_m == 0.0 or depth_m <= 0.0 or depth_std_m > DEPTH_KNOWN_FRACTION * depth_m:
        return UNKNOWN_SHAPE_STD_PX
    radius_px = camera.K[0, 0] * radius_m / depth_m
    whole = region.area_px / (np.pi * radius_px**2)
    if whole < MIN_VISIBLE_FRACTION:
        return None
    # What is missing, or too much, lies on one side: at worst it moves the centroid by half of it.
    wrong = max(0.0, abs(1.0 - whole) - WHOLE_AREA_SPREAD)
    return float(radius_px * np.hypot(CENTRE_NOISE, 0.5 * wrong))


def _size(frame: Frame, predicted: ToolPose) -> Iterator[LinkMeasurement]:
    """The whole marker's radius: a depth right within some percent, where nothing better tells one yet."""
    instrument = frame.arm.profile.instrument
    depth_std_m = np.sqrt(predicted.covariance[2, 2])
    if instrument is None or depth_std_m < MIN_RELATIVE_DEPTH_STD * predicted.position_m[2]:
        return
    marker = frame.left.distal_marker
    if marker is not None and marker.radius_px is not None:
        yield SizeMeasurement(
            "size",
            None,
            frame.left.camera,
            instrument.knuckle_radius_m,
            marker.radius_px,
            np.array([[0.25 * marker.radius_std_px**2]]),
            marker.radius_std_px,
            frame.arm.profile.settings.filter.point_correlation_time_s,
            frame.arm.deviations,
        )


def _tag(frame: Frame, robot: RobotState, predicted: ToolPose) -> Iterator[LinkMeasurement]:
    """The tag's pose; the predicted tool tells how the tag is turned, but for the wrist's joints between them."""
    fiducial = frame.arm.profile.fiducial
    if fiducial is None or frame.left.tag_corners_px is None:
        return
    T_base_tag = robot.T_base_link(fiducial.link) @ fiducial.T_link_tag
    R_camera_tag = predicted.T_camera_tool[:3, :3] @ robot.T_base_tool[:3, :3].T @ T_base_tag[:3, :3]
    std_rad = float(np.sqrt(np.linalg.eigvalsh(predicted.covariance[3:, 3:])[-1]))
    tag = frame.tag_near(R_camera_tag, std_rad)
    if tag is not None:
        share = frame.arm.profile.settings.fused.lasting_share
        yield PoseMeasurement(
            "tag",
            fiducial.link,
            fiducial.T_link_tag,
            tag.T_camera_tag,
            (1.0 - share) * tag.covariance,
            share * tag.covariance,
            POSE_CORRELATION_TIME_S,
            _focal_px(frame),
            frame.arm.deviations,
        )


def _contours(frame: Frame) -> Iterator[LinkMeasurement]:
    """Both edges of a shaft that is longer than wide; on a stub something else is easily taken for one."""
    instrument, axis, shaft = frame.arm.profile.instrument, frame.arm.shaft_axis, frame.left.shaft
    if instrument is None or axis is None or shaft.is_stub:
        return
    share = frame.arm.profile.settings.fused.lasting_share
    for contour in shaft.contours:
        _, axes = np.linalg.eigh(contour.plane.covariance)
        across = axes[:, 1:].T
        covariance = across @ contour.plane.covariance @ across.T
        yield ContourMeasurement(
            f"edge {contour.side:+d}",
            axis.link,
            contour.plane.normal,
            across,
            (1.0 - share) * covariance,
            axis.p_axis_m,
            axis.axis,
            instrument.shaft_radius_m,
            contour.side,
            share * covariance,
            frame.arm.profile.settings.filter.edge_correlation_time_s,
            _focal_px(frame),
            frame.arm.deviations,
        )


def _disc(marker: DistalMarker | None) -> Disc | None:
    return None if marker is None else marker.disc


def _focal_px(frame: Frame) -> tuple[float, float]:
    K = frame.left.camera.K
    return float(K[0, 0]), float(K[1, 1])


class FusedEstimator:
    """`--method fused`: keeps the filter, and the tissue's pose and shape, between frames.

    Images alone say where to linearise at first, and where to begin anew when they contradict the prediction for
    several frames: the filter then takes the start that prior and measurements make the most probable.
    """

    name = "fused"
    keeps_state = True
    needs = Needs(
        scene=("tissue", "left.tags", "stereo_surface"),
        frame=("left.distal_marker", "right.distal_marker", "left.shaft"),
        right_view=True,
    )

    def __init__(self, arm: Arm) -> None:
        profile = arm.profile
        self._arm, self._chain = arm, arm.required_chain
        self._followed = FollowedTissue(arm)
        self._filter = KinematicErrorFilter(self._chain, profile.kinematic_error, profile.settings.filter)
        has_sizes = profile.segmentation.shaft is not None and profile.instrument is not None
        self._stereo = StereoEstimator(arm) if has_sizes else None
        self._has_plate = self._is_located = False
        self._contradictions, self._has_agreed = 0, False
        self._begun_ns: int | None = None
        self._image_variance_m2 = 0.0

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; a result needs joints and a tissue seen before, and nothing of this image."""
        tissue, result = self._followed.see(frame), with_tissue(frame)
        robot = frame.robot_in_camera
        if isinstance(robot, Failure):
            return result.rejected(Status.NO_JOINTS, robot.reason)

        # Predict by the joints, begin anew where the images say so, correct by what they show.
        kalman = self._filter
        kalman.predict(robot)
        image = self._image_pose(frame)
        start = self._start(frame, image)
        contradiction = 0.0 if start is not None or image is None else kalman.distance(image)
        seen = self._seen(frame, start or kalman.tool_pose(), image)
        gating = kalman.update(seen)
        said = self._watch(frame, image, contradiction, gating)
        height = self._followed.measure_height(frame, kalman)

        # The tool with the error found, and the distances from there.
        self._has_plate |= frame.left.tag_corners_px is not None
        region, consistency = frame.left.region, kalman.consistency
        result = replace(result, detail=_detail(gating, height), consistency=consistency.ratio).with_image(
            tool_area_px=region.area_px if region else None,
            match_count=len(gating),
            inlier_count=sum(judged.is_accepted for judged in gating),
        )
        joints = JointSample(frame.stamp_ns, self._chain.joint_names, kalman.corrected_joints())
        tool = ToolEstimate(kalman.tool_pose(), joints, self._has_plate)
        if tissue is None:
            result = with_tool(result, frame, tool)
            return result.rejected(Status.NO_TISSUE, "no tissue, in this frame or before")
        placed, coupling = self._followed.placed(tissue, frame, kalman)
        found = measured(result, frame, tool, placed, coupling)
        doubt = said or consistency.doubt if found.measured else ""
        return replace(found.rejected(Status.INCONSISTENT, doubt), distances=Distances()) if doubt else found

    def _image_pose(self, frame: Frame) -> ToolPose | None:
        """The tool by the images alone: by both views, or by the shaft in the left one; None where neither tells."""
        if self._stereo is None:
            return None
        pair = frame.scene.stereo_pair
        if not isinstance(pair, Failure):
            found = self._stereo.tool(frame, pair)
            if isinstance(found, ToolPose):
                return found
        fit = frame.shaft_pose
        if not isinstance(fit, Failure) and not fit.doubt and fit.pose.position_std_m < MAX_IMAGE_STD_M:
            return fit.pose
        return None

    def _start(self, frame: Frame, image: ToolPose | None) -> ToolPose | None:
        """Begin anew where it is due, and give the pose to linearise at; None where the filter goes on."""
        kalman = self._filter
        if image is None:
            return None
        if not self._is_located:
            # What was measured before may have led there already.
            is_near = kalman.distance(image) <= chi_square_bound(6)
            self._is_located = is_near and kalman.tool_pose().position_std_m < LOCATED_STD_M
        if self._is_located and self._contradictions < MAX_CONTRADICTIONS:
            return None
        self._is_located, self._has_agreed, self._contradictions = True, False, 0
        self._begun_ns = frame.stamp_ns
        poses = [image]
        fit = frame.shaft_pose
        if not isinstance(fit, Failure) and fit.pose is not image:
            poses.append(fit.pose)
        if (by_tag := self._pose_by_tag(frame)) is not None:
            poses.append(by_tag)
        starts: list[Start] = [(pose, self._seen(frame, pose, image)) for pose in poses]
        nominal = nominal_tool(self._chain, self._arm.profile.kinematic_error, kalman.robot)
        starts.append((None, self._seen(frame, nominal, image)))
        return starts[kalman.begin(starts)][0] or kalman.tool_pose()

    def _pose_by_tag(self, frame: Frame) -> ToolPose | None:
        fiducial = self._arm.profile.fiducial
        if fiducial is None or frame.left.tag_corners_px is None or frame.tag is None:
            return None
        error, deviations = self._arm.profile.kinematic_error, self._arm.deviations
        focal_px = np.array(_focal_px(frame))
        return tool_from_tag(frame.tag, fiducial, self._filter.robot, error, deviations, focal_px)

    def _seen(self, frame: Frame, predicted: ToolPose, image: ToolPose | None) -> list[LinkMeasurement]:
        """The measurements about a predicted pose. Where no marker ends the shaft, the images' pose stands for them."""
        seen = measurements(frame, self._filter.robot, predicted)
        ends = {"distal marker", "wrist", "tag"} & {measurement.name for measurement in seen}
        shows_marker = self._shows_marker(frame)
        if shows_marker and (ends or image is None):
            return seen
        seen = [measurement for measurement in seen if measurement.name == "tag"]
        if image is None:
            return seen
        return [*seen, as_measurement(image, LASTING_IMAGE_SHARE, POSE_CORRELATION_TIME_S, "views")]

    def _shows_marker(self, frame: Frame) -> bool:
        """Whether what is coloured is the marker that the profile describes, as far as one can tell."""
        if frame.left.distal_marker is None and self._arm.profile.instrument is not None:
            return frame.left.masks.seen is not None or frame.left.region is None
        return True

    def _watch(
        self, frame: Frame, image: ToolPose | None, contradiction: float, gating: Sequence[GatingResult]
    ) -> str:
        """Why the images' pose, that far off, contradicts the prediction; empty where it does not.

        That pose may be what is mistaken: what the filter takes must contradict the prediction, too. Until what agrees
        has been seen for a while, the filter is hardly surer than the images.
        """
        consistency = self._filter.consistency
        consistency.excess = 1.0
        degrees = sum(judged.degrees_of_freedom for judged in gating)
        refused = sum(judged.degrees_of_freedom for judged in gating if not judged.is_accepted)
        if image is not None:
            self._image_variance_m2 = float(np.trace(image.position_covariance))
        if self._begun_ns is None:
            self._begun_ns = frame.stamp_ns
        age = (frame.stamp_ns - self._begun_ns) / 1e9
        if age < YOUNG_S:
            own_m2 = float(np.trace(self._filter.tool_pose().position_covariance)) / consistency.widening
            more = max(self._image_variance_m2 / own_m2 - 1.0, 0.0)
            consistency.excess = 1.0 + (1.0 - age / YOUNG_S) * more
        is_off = contradiction > chi_square_bound(6) and refused >= CONTRADICTING_SHARE * max(degrees, 1)
        if not is_off and not consistency.doubt:
            self._contradictions, self._has_agreed = 0, self._has_agreed or age >= YOUNG_S
            return ""
        # What never agreed would begin anew for ever.
        self._contradictions += is_off or self._has_agreed
        return (
            f"what the images show is {np.sqrt(contradiction):.0f} deviations from the prediction"
            if is_off
            else ""
        )


def _detail(gating: Sequence[GatingResult], height: GatingResult | None) -> str:
    refused = [judged.name for judged in gating if not judged.is_accepted]
    alone = len(refused) == len(gating)
    if height is not None and not height.is_accepted:
        refused.append(height.name)
    said = f"refused: {', '.join(refused)}" if refused else ""
    if alone:
        how = "joints alone" if gating else "nothing of the tool detected: joints alone"
        return f"{said}; {how}" if said else how
    return said

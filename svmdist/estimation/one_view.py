"""The methods of one view: nominal kinematics, the tag on the instrument, and the shaft's silhouette."""

from __future__ import annotations

import numpy as np

from svmdist.camera import Camera
from svmdist.errors import ProfileError
from svmdist.estimation.distances import measured, with_tissue
from svmdist.estimation.frame import Frame, Needs
from svmdist.estimation.instrument.consistency import with_detections
from svmdist.estimation.instrument.error_model import nominal_tool
from svmdist.estimation.instrument.model import wrist_in_tool
from svmdist.estimation.instrument.tag_pose import TagPose
from svmdist.estimation.scene import Arm
from svmdist.estimation.tissue.detection import require_tissue
from svmdist.estimation.tissue.tracking import TissueTracker
from svmdist.kinematics import joint_axis, row_index
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.robot import KinematicError
from svmdist.results import Failure, FrameResult, ToolEstimate, ToolPose
from svmdist.samples import Status
from svmdist.transforms import Array, inverse, skew


class KinematicEstimator:
    """`--method kinematic`: nothing of the tool is taken from the image. Keeps the tissue's pose between frames."""

    name = "kinematic"
    keeps_state = True
    needs = Needs(scene=("tissue",))

    def __init__(self, arm: Arm) -> None:
        require_tissue(arm.profile)
        self._chain = arm.required_chain
        self._error = arm.profile.kinematic_error
        self._tissue = TissueTracker(arm.profile.settings.tissue)

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; without joints or a camera-to-base transform there is nothing to say."""
        tissue, result = self._tissue.add(frame.scene.tissue), with_tissue(frame)
        robot = frame.robot_in_camera
        if isinstance(robot, Failure):
            return result.rejected(Status.NO_JOINTS, robot.reason)
        if tissue is None:
            return result
        tool = ToolEstimate(nominal_tool(self._chain, self._error, robot), frame.joints)
        return measured(result.rejected(Status.OK), frame, tool, tissue)


def tool_from_tag(arm: Arm, camera: Camera, tag: TagPose, robot: RobotState) -> ToolPose:
    """The tool's pose from that of the arm's tag, through the mounting and the joints behind it."""
    fiducial = arm.profile.fiducial
    assert fiducial is not None  # it was found
    T_base_tag = robot.T_base_link(fiducial.link) @ fiducial.T_link_tag
    T_camera_base = tag.T_camera_tag @ inverse(T_base_tag)
    T_camera_tool = T_camera_base @ robot.T_base_tool
    # The tag's turning moves the tool at the end of its arm: δp_tool = δp + δθ x arm.
    arm_m = T_camera_tool[:3, 3] - tag.T_camera_tag[:3, 3]
    J = np.eye(6)
    J[:3, 3:] = -skew(arm_m)
    biases = arm.deviations.of_tag(tag.T_camera_tag, np.diag(camera.K)[:2])
    constants = sum((bias.jacobian @ bias.jacobian.T for bias in biases), np.zeros((6, 6)))
    covariance = J @ (tag.covariance + constants) @ J.T
    covariance += _joint_covariance(robot, fiducial.link, T_camera_base[:3, :3], arm.profile.kinematic_error)
    axis = T_camera_tool[:3, :3] @ wrist_in_tool(robot.chain, robot.q).shaft
    return ToolPose(T_camera_tool, covariance, axis)


def _joint_covariance(robot: RobotState, link: str, R_camera_base: Array, error: KinematicError) -> Array:
    """What the errors of the joints behind the tag's link do to the tool, shape (6, 6) in the camera frame."""
    chain, tool_m = robot.chain, robot.T_base_tool[:3, 3]
    columns, late = [], np.zeros(6)
    for index in range(row_index(chain, link) + 1, len(chain.rows)):
        row = chain.rows[index]
        z, at_m = joint_axis(chain, robot.frames, index)
        turning, sliding = np.concatenate([np.cross(z, tool_m - at_m), z]), np.concatenate([z, np.zeros(3)])
        if row.a_m != 0.0:
            # Along x of its own frame; modified DH moves before it turns, along x of the frame before.
            x_row = index - 1 if chain.convention == "modified" else index
            columns.append(error.length_std_m * np.concatenate([robot.frames[x_row][:3, 0], np.zeros(3)]))
        if row.type == "fixed":
            continue
        column, stds = sliding, (error.joint_std_m, error.play_std_m)
        if row.type == "revolute":
            column, stds = turning, (error.joint_std_rad, error.play_std_rad)
        columns.append(float(np.hypot(*stds)) * column)
        late += robot.rates[chain.joint_names.index(row.name)] * column
    columns.append(error.time_offset_std_s * late)
    turned = np.array(columns).reshape(-1, 2, 3) @ R_camera_base.T
    J = turned.reshape(-1, 6).T
    return np.asarray(J @ J.T)


class FiducialEstimator:
    """`--method fiducial`. Keeps no state between frames."""

    name = "fiducial"
    keeps_state = False
    needs = Needs(scene=("tissue", "left.tags"), frame=("tag",))

    def __init__(self, arm: Arm) -> None:
        profile = arm.profile
        if profile.fiducial is None or profile.robot is None:
            raise ProfileError(
                f"profile {profile.name} has no {'[fiducial]' if profile.robot else '[robot]'}: the method"
                " fiducial needs the tag, the link that carries it, and the chain from there to the tool"
            )
        require_tissue(profile)

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; a frame that cannot be measured says why."""
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
        return measured(result, frame, ToolEstimate(pose, frame.joints, has_plate=True), tissue.pose)


def uncertainty(pose: ToolPose, max_std_m: float) -> str:
    """Why a position is too uncertain; empty if it is not."""
    is_known = pose.position_std_m <= max_std_m  # NaN is not
    return "" if is_known else f"the position is uncertain by {pose.position_std_m * 1e3:.1f} mm"


class ShaftEstimator:
    """`--method shaft`. Keeps between frames whether it saw the tag's plate, and nothing else."""

    name = "shaft"
    keeps_state = True
    needs = Needs(scene=("tissue", "left.tags"), frame=("shaft_pose",))

    def __init__(self, arm: Arm) -> None:
        profile = arm.profile
        if profile.segmentation.shaft is None or profile.robot is None or profile.instrument is None:
            raise ProfileError(
                f"profile {profile.name} cannot serve the method shaft: it needs [segmentation.shaft], [robot] and"
                " [instrument]"
            )
        require_tissue(profile)
        self._settings = profile.settings.shaft
        self._has_plate = False

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; a frame that cannot be measured says why."""
        # The tissue, on the plane that it lies on.
        result, tissue = with_tissue(frame), frame.scene.tissue
        if tissue is None or tissue.pose is None:
            return result

        # The shaft's edges and end, the distal marker, and the pose that fits them through the wrist.
        self._has_plate |= frame.left.tag_corners_px is not None
        fit = frame.shaft_pose
        if isinstance(fit, Failure):
            is_seen = len(frame.left.shaft.contours) == 2
            return result.rejected(Status.UNCERTAIN if is_seen else Status.NO_INSTRUMENT, fit.reason)
        result = with_detections(result, fit.gating)
        if fit.doubt:
            return result.rejected(Status.INCONSISTENT, fit.doubt)
        if said := uncertainty(fit.pose, self._settings.max_position_std_m):
            return result.rejected(Status.UNCERTAIN, said)
        return measured(result, frame, ToolEstimate(fit.pose, frame.joints, self._has_plate), tissue.pose)

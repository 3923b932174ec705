"""Where nominal kinematics put an instrument in an image, and how its shaft runs there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.arm import Arm
from svmdist.estimation.association.motion import Gaussian, NominalPlace
from svmdist.estimation.association.regions import ShaftAxis
from svmdist.estimation.filter.nominal import nominal_tool
from svmdist.estimation.instrument.model import NECK_PER_RADIUS, WRIST_LENGTH_PER_RADIUS
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile import Instrument
from svmdist.profile.settings import AssociationSettings
from svmdist.results import Failure, ToolPose
from svmdist.transforms import Array

DEFAULT = AssociationSettings()


@dataclass(frozen=True)
class NominalInstrument:
    """The nominal pose of a tool in a camera's frame, and the instrument's sizes."""

    pose: ToolPose
    instrument: Instrument | None
    settings: AssociationSettings = DEFAULT

    def moved(self, T_other_camera: Array) -> NominalInstrument:
        """The same in the frame of another camera beside this one; covariances stay as they are."""
        pose = replace(
            self.pose,
            T_camera_tool=T_other_camera @ self.pose.T_camera_tool,
            axis=T_other_camera[:3, :3] @ self.pose.axis,
        )
        return replace(self, pose=pose)

    def place(self, camera: Camera) -> NominalPlace:
        """Where the tool is in the image by nominal kinematics, to first order."""
        x, y, z = self.pose.position_m
        z = max(float(z), self.settings.min_depth_m)
        fx, fy = float(camera.K[0, 0]), float(camera.K[1, 1])
        mean = np.array([camera.K[0, 2] + fx * x / z, camera.K[1, 2] + fy * y / z])
        J = np.array([[fx / z, 0.0, -fx * x / z**2], [0.0, fy / z, -fy * y / z**2]])
        place = Gaussian(mean, J @ self.pose.position_covariance @ J.T)
        return NominalPlace(place, self.pose.position_m, fx / z)

    def shaft_from(self, tool_px: Array, region_radius_px: float, camera: Camera) -> ShaftAxis | None:
        """The shaft's axis in the image where the tool is at a pixel, shape (2,); None where it points at the camera.

        The image of p + t b, with b towards the base, leaves p's pixel along b_xy - b_z p_xy / p_z: which way it runs
        needs no depth, which is what the robot knows worst.
        """
        if self.instrument is None:
            return None
        fx, fy = float(camera.K[0, 0]), float(camera.K[1, 1])
        ray = np.array([(tool_px[0] - camera.K[0, 2]) / fx, (tool_px[1] - camera.K[1, 2]) / fy])
        back = -self.pose.axis
        slope = (back[:2] - back[2] * ray) * [fx, fy]
        length = float(np.linalg.norm(slope))
        if length < 0.1 * fx:
            return None
        sizes = self.instrument
        wrist_m = WRIST_LENGTH_PER_RADIUS * sizes.wrist_radius_m
        end_m = sizes.shaft_end_m or NECK_PER_RADIUS * sizes.wrist_radius_m
        px_per_m = region_radius_px / sizes.knuckle_radius_m
        begin_px = (wrist_m + end_m) * px_per_m * length / fx
        return ShaftAxis(tool_px, slope / length, begin_px, sizes.shaft_radius_m * px_per_m)


def nominal_instrument(arm: Arm, robot: RobotState | Failure) -> NominalInstrument | None:
    """The nominal pose of an instrument; None where the log tells none near the image."""
    if isinstance(robot, Failure) or robot.T_camera_base is None or arm.chain is None:
        return None
    tool = nominal_tool(arm.chain, arm.profile.kinematic_error, robot)
    return NominalInstrument(tool, arm.profile.instrument, arm.profile.settings.association)

"""Where the robot believes one of its instruments to be in an image, and how its shaft runs there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.filter.nominal import nominal_tool
from svmdist.estimation.filtering.robot_scene import belief_of
from svmdist.estimation.identity.motion import Believed, Gaussian
from svmdist.estimation.identity.regions import ShaftAxis
from svmdist.estimation.instrument.model import NECK_PER_RADIUS, WRIST_LENGTH_PER_RADIUS
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.kinematics.chain import chain_of
from svmdist.profile import Instrument, Profile
from svmdist.samples import Observation
from svmdist.transforms import Array

MIN_DEPTH_M = 0.02
"""A tool is not believed to be nearer to the camera, for its pixel would run away."""


@dataclass(frozen=True)
class ArmBelief:
    """The believed pose of a tool in a camera's frame, and the instrument's sizes."""

    pose: ToolPose
    instrument: Instrument | None

    def moved(self, T_other_camera: Array) -> ArmBelief:
        """The same in the frame of another camera beside this one; covariances stay as they are."""
        pose = replace(
            self.pose,
            T_camera_tool=T_other_camera @ self.pose.T_camera_tool,
            axis=T_other_camera[:3, :3] @ self.pose.axis,
        )
        return replace(self, pose=pose)

    def place(self, camera: Camera) -> Believed:
        """Where the tool is believed to be in the image, to first order."""
        x, y, z = self.pose.position_m
        z = max(float(z), MIN_DEPTH_M)
        fx, fy = float(camera.K[0, 0]), float(camera.K[1, 1])
        mean = np.array([camera.K[0, 2] + fx * x / z, camera.K[1, 2] + fy * y / z])
        J = np.array([[fx / z, 0.0, -fx * x / z**2], [0.0, fy / z, -fy * y / z**2]])
        place = Gaussian(mean, J @ self.pose.position_covariance @ J.T)
        return Believed(place, self.pose.position_m, fx / z)

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


class InstrumentBelief:
    """What the robot believes of one instrument, image by image."""

    def __init__(self, profile: Profile) -> None:
        self._profile = profile
        self._chain = chain_of(profile.robot) if profile.robot else None

    def of(self, observation: Observation) -> ArmBelief | None:
        """The believed pose; None where the log tells none near the image."""
        if self._chain is None:
            return None
        belief = belief_of(observation, self._chain)
        if isinstance(belief, str):
            return None
        error = self._profile.kinematic_error
        tool = nominal_tool(self._chain, error, belief)
        return ArmBelief(tool, self._profile.instrument)

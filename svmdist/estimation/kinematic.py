"""The robot's word for it: the tool where forward kinematics put it, the tissue from the image.

As bad as joints and camera-to-base transform are; the standard deviations say how bad that may be.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from svmdist.camera import Camera
from svmdist.errors import KinematicsError, ProfileError
from svmdist.estimation.distances import measure
from svmdist.estimation.filter import KinematicErrorFilter
from svmdist.estimation.instrument_model import InstrumentModel
from svmdist.estimation.tissue import TissueSight, require_tissue, see_tissue
from svmdist.estimation.tissue_memory import TissueMemory
from svmdist.kinematics.chain import chain_of
from svmdist.kinematics.dh import DHChain, select_joints
from svmdist.profile import Profile
from svmdist.samples import Estimate, Observation, Status
from svmdist.transforms import Array
from svmdist.vision.segmenter import Segmenter, make_segmenter


@dataclass(frozen=True, slots=True)
class Belief:
    """What the robot believes: joints in the chain's order, shape (n,), and `T_camera_base`, shape (4, 4)."""

    q: Array
    T_camera_base: Array


class KinematicEstimator:
    """`--method kinematic`: nothing of the tool is taken from the image."""

    name = "kinematic"

    def __init__(self, profile: Profile, segmenter: Segmenter | None = None) -> None:
        require_tissue(profile)
        self._profile = profile
        self._segmenter = segmenter or make_segmenter(profile.segmentation)
        self._chain = require_chain(profile)
        self._model = InstrumentModel.of(profile)
        self._tissue = TissueMemory()

    def estimate(self, observation: Observation) -> Estimate:
        """Measure one frame; without joints or a camera-to-base transform there is nothing to say."""
        belief = belief_of(observation, self._chain)
        sight = see_tissue(self._segmenter.masks(observation.image_bgr), self._profile, observation.camera)
        tissue = self._tissue.add(sight.fix if sight else None)
        row = with_tissue(Estimate(observation.stamp_ns, Status.NO_TISSUE), sight)
        if isinstance(belief, str):
            return replace(row, status=Status.NO_JOINTS, detail=belief)
        if tissue is None:
            return row

        # A filter that has seen nothing: believed kinematics, and the profile's uncertainty.
        kalman = KinematicErrorFilter(self._chain, self._profile.kinematic_error)
        kalman.predict(observation.stamp_ns, belief.q, belief.T_camera_base)
        pose = kalman.tool_pose()
        row = with_tool_pixel(row, observation.camera, pose.position_m)
        return measure(row, pose, tissue, self._model, observation.joints)


def require_chain(profile: Profile) -> DHChain:
    """The profile's chain; raises ProfileError where it has none."""
    if profile.robot is None:
        raise ProfileError(f"profile {profile.name} has no [robot]: kinematics need its chain")
    return chain_of(profile.robot)


def belief_of(observation: Observation, chain: DHChain) -> Belief | str:
    """What the robot believes at an image's stamp, or what of it the log lacks."""
    if observation.joints is None:
        return "no joints near the image"
    if observation.T_camera_base is None:
        return "no transform from the camera to the base"
    try:
        q = select_joints(chain, observation.joints.names, observation.joints.positions)
    except KinematicsError as problem:
        return str(problem)
    return Belief(q, observation.T_camera_base)


def with_tissue(row: Estimate, sight: TissueSight | None) -> Estimate:
    """The row with what the image shows of the tissue."""
    if sight is None:
        return row
    x, y = sight.outline.centroid_px
    return replace(row, tissue_x_px=float(x), tissue_y_px=float(y), tissue_area_px=sight.region.area_px)


def with_tool_pixel(row: Estimate, camera: Camera, position_m: Array) -> Estimate:
    """The row with the tool's origin in the image, where that is before the camera."""
    if position_m[2] <= 0.0:
        return row
    x, y = camera.project(position_m[None])[0]
    return replace(row, tool_x_px=float(x), tool_y_px=float(y))

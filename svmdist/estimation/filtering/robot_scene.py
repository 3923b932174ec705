"""What the methods that know the robot start from: its chain and belief, the tissue so far, and a row to fill."""

from __future__ import annotations

from dataclasses import dataclass, replace

from svmdist.camera import Camera
from svmdist.errors import KinematicsError, ProfileError
from svmdist.estimation.distances import measure, with_tool
from svmdist.estimation.instrument.model import InstrumentModel
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.estimation.tissue.dome import DomeModel
from svmdist.estimation.tissue.fix import TissuePose, TissueSight, require_tissue, see_tissue, with_tissue
from svmdist.estimation.tissue.memory import TissueMemory
from svmdist.estimation.tissue.stereo_surface import fit_dome, see_surface
from svmdist.kinematics.chain import chain_of
from svmdist.kinematics.dh import DHChain, select_joints
from svmdist.profile import Profile
from svmdist.samples import Estimate, JointSample, Observation, Status
from svmdist.transforms import Array
from svmdist.vision.rectified import rectified_pair
from svmdist.vision.segmentation.segmenter import Masks, Segmenter, make_segmenter, own_masks


@dataclass(frozen=True, slots=True)
class Belief:
    """What the robot believes: joints in the chain's order, shape (n,), and `T_camera_base`, shape (4, 4)."""

    q: Array
    T_camera_base: Array


@dataclass(frozen=True, slots=True)
class Look:
    """One frame before the tool is measured: the image's masks, the robot's belief, the tissue as it is known."""

    row: Estimate
    masks: Masks
    belief: Belief | None
    tissue: TissuePose | None


class RobotScene:
    """The set-up of a robot over tissue that holds still; keeps the tissue's place between frames.

    With `sees_shape` it finds the dome's apex and height too, where frames have both views.
    """

    def __init__(
        self, profile: Profile, segmenter: Segmenter | None = None, sees_shape: bool = False
    ) -> None:
        require_tissue(profile)
        self.profile = profile
        self.segmenter = segmenter or make_segmenter(profile.segmentation)
        self.chain = require_chain(profile)
        self._model = InstrumentModel.of(profile)
        self._tissue = TissueMemory()
        self._sees_shape = sees_shape

    def look(self, observation: Observation) -> Look:
        """Segment a frame, take up its tissue, and select its joints; the row says what is lacking."""
        belief = belief_of(observation, self.chain)
        masks = own_masks(self.segmenter, observation.image_bgr, observation.foreign)
        sight = see_tissue(masks, self.profile, observation.camera)
        tissue = self._tissue.add(sight.fix if sight else None, self._dome(observation, sight, masks))
        row = with_tissue(Estimate(observation.stamp_ns, Status.NO_TISSUE), sight)
        if isinstance(belief, str):
            return Look(replace(row, status=Status.NO_JOINTS, detail=belief), masks, None, tissue)
        return Look(row, masks, belief, tissue)

    def _dome(self, observation: Observation, sight: TissueSight | None, masks: Masks) -> DomeModel | None:
        """The dome as both views show it, where another look at it is wanted."""
        right = observation.right
        if not self._sees_shape or right is None or sight is None or sight.fix is None:
            return None
        if sight.fix.dome is None or not self._tissue.wants_shape:
            return None
        pair = rectified_pair(observation, right)
        if isinstance(pair, str):
            return None
        right_masks = own_masks(self.segmenter, right.image_bgr, right.foreign)
        surface = see_surface(observation, right, pair, sight.region.hull, (masks.tissue, right_masks.tissue))
        return None if surface is None else fit_dome(sight.fix.dome, surface)

    def finish(
        self,
        row: Estimate,
        pose: ToolPose,
        tissue: TissuePose | None,
        camera: Camera,
        joints: JointSample,
        has_plate: bool = False,
    ) -> Estimate:
        """The row with the tool's place in the image, and the distances where the tissue is known."""
        row = with_tool(row, pose, camera)
        if tissue is None:
            return replace(row, detail="no tissue, in this frame or before")
        return measure(row, pose, tissue, self._model, joints, has_plate=has_plate)


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

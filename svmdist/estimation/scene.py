"""The images of one instant, each looked at once, and the arms that carry the instruments in them."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import cached_property

from svmdist.errors import ProfileError
from svmdist.estimation.instrument.measurement import Deviations
from svmdist.estimation.instrument.model import InstrumentModel
from svmdist.estimation.instrument.shaft_model import ShaftModel
from svmdist.estimation.tissue.detection import TissueDetection, detect_tissue
from svmdist.estimation.tissue.surface import StereoSurface, detect_stereo_surface
from svmdist.kinematics import DHChain, chain_of, shaft_of
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile import Profile
from svmdist.results import Failure
from svmdist.samples import Observation
from svmdist.vision.frame_context import FrameContext, as_pinholes, mixes_colours, with_first_fields
from svmdist.vision.segmentation import Segmenter
from svmdist.vision.stereo import LEVEL, RectifiedPair, RowAlignment, rectified_pair
from svmdist.vision.tags import TagPattern

OF_BOTH_VIEWS = "stereo_pair", "stereo_surface"  # what a scene finds by both of its views


class Arm:
    """An instrument's profile, with its chain, its body and its fiducial made ready; shared by all methods.

    It `has_plate` where its tag, or that of another instrument, is seen anywhere in the log.
    """

    def __init__(self, profile: Profile, has_plate: bool = False) -> None:
        self.profile, self.has_plate = profile, has_plate

    @cached_property
    def chain(self) -> DHChain | None:
        """The robot's chain; None where the profile has none."""
        return chain_of(self.profile.robot) if self.profile.robot else None

    @property
    def required_chain(self) -> DHChain:
        """The robot's chain; raises ProfileError where the profile has none."""
        if self.chain is None:
            raise ProfileError(f"profile {self.profile.name} has no [robot]: kinematics need its chain")
        return self.chain

    @cached_property
    def body(self) -> InstrumentModel | None:
        """The instrument as capsules; None where the profile has no sizes of it."""
        return InstrumentModel.of(self.profile)

    @cached_property
    def deviations(self) -> Deviations:
        """Standard deviations of the calibration parameters of cameras, instrument and tag."""
        return Deviations.of(self.profile)

    @cached_property
    def straight(self) -> ShaftModel | None:
        """The instrument with straight joints, in no place; None without its sizes, or a chain with a shaft."""
        instrument = self.profile.instrument
        if instrument is None or self.chain is None or shaft_of(self.chain) is None:
            return None
        return ShaftModel.of(Failure(""), self.chain, instrument)

    @property
    def plate_beside(self) -> float:
        """By how much its tag's plate is wider than the shaft, over its width."""
        tag, instrument = self.profile.fiducial, self.profile.instrument
        if tag is None or instrument is None:
            return 0.0
        plate_m = self.profile.settings.tag.plate_ratio * tag.size_m
        return max(0.5 * plate_m / instrument.shaft_radius_m - 1.0, 0.0)

    @cached_property
    def tag_pattern(self) -> TagPattern | None:
        """The fiducial's printed pattern; None where the profile has no fiducial."""
        tag = self.profile.fiducial
        return TagPattern(tag.family, tag.id, tag.size_m) if tag else None

    def state_at(self, seen: Observation) -> RobotState | Failure:
        """Joints and nominal poses at an image's stamp; or what of them the log lacks."""
        if self.chain is None:
            return Failure(f"profile {self.profile.name} has no [robot]")
        return RobotState.of(self.chain, seen.joints, seen.T_camera_base, seen.stamp_ns, seen.joint_track)


class Scene:
    """One instant of a log before the instruments are associated; all methods and instruments share its detections.

    Its `observation` is what ideal cameras would have seen; `lens` is the left camera as it is. The right
    view's `rows` are aligned with the left one's. Detections are computed as those of a view are.
    """

    def __init__(
        self, observation: Observation, profile: Profile, segmenter: Segmenter, rows: RowAlignment = LEVEL
    ) -> None:
        interlace = profile.settings.interlace
        self.lens, self.profile, self._rows = observation.camera, profile, rows
        first = with_first_fields(observation, interlace)
        is_combed = first.image_bgr is not observation.image_bgr
        self.mixes_colours = is_combed and mixes_colours(observation.image_bgr, interlace)
        self.observation = observation = as_pinholes(first, rows)
        right = observation.right
        self.left = FrameContext(observation.image_bgr, segmenter, profile)
        self.right = None if right is None else FrameContext(right.image_bgr, segmenter, profile)

    def left_alone(self) -> Scene:
        """The same without the right view, with what was found in the left one."""
        alone = copy(self)
        alone.observation, alone.right = replace(self.observation, right=None), None
        for name in OF_BOTH_VIEWS:
            vars(alone).pop(name, None)
        return alone

    @cached_property
    def tissue(self) -> TissueDetection | None:
        """The tissue's outline and pose, by the left view."""
        return detect_tissue(self.left.masks, self.profile, self.observation.camera)

    @cached_property
    def stereo_pair(self) -> RectifiedPair | Failure:
        """The geometry of both views, where they are a rectified pair."""
        right = self.observation.right
        return Failure("no right view") if right is None else rectified_pair(self.observation.camera, right)

    @cached_property
    def stereo_surface(self) -> StereoSurface | None:
        """The tissue's surface by both views, as a distance needs it; None where they do not show it."""
        return self.surface()

    def surface(self, **resolution: int) -> StereoSurface | None:
        """The same at a resolution, as `detect_stereo_surface` takes it."""
        pair = self.stereo_pair
        if self.right is None or isinstance(pair, Failure):
            return None
        settings, field = self.profile.settings.stereo, self.profile.field
        return detect_stereo_surface((self.left, self.right), pair, settings, field, self._rows, **resolution)

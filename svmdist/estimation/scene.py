"""The images of one moment, each looked at once, and the arms that carry the instruments in them."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Generic, TypeVar, overload

from svmdist.camera import Camera
from svmdist.errors import ProfileError
from svmdist.profile import Profile
from svmdist.results import Failure
from svmdist.samples import Image, Observation
from svmdist.transforms import Array
from svmdist.vision.frame_context import FrameContext, as_pinholes, with_first_fields
from svmdist.vision.segmentation import InstrumentMasks, Masks, Segmenter

if TYPE_CHECKING:
    from svmdist.estimation.instrument.measurement import Deviations
    from svmdist.estimation.instrument.model import InstrumentModel
    from svmdist.estimation.surface import StereoSurface
    from svmdist.estimation.tissue import TissueDetection
    from svmdist.kinematics.dh import DHChain, ShaftAxis
    from svmdist.kinematics.robot_state import RobotState
    from svmdist.vision.stereo import RectifiedPair
    from svmdist.vision.tag_overlay import TagPattern


class Arm:
    """An instrument's profile, with its chain, its body and its fiducial made ready; shared by all methods."""

    def __init__(self, profile: Profile) -> None:
        self.profile = profile

    @cached_property
    def chain(self) -> DHChain | None:
        """The robot's chain; None where the profile has none."""
        from svmdist.kinematics.dh import chain_of

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
        from svmdist.estimation.instrument.model import InstrumentModel

        return InstrumentModel.of(self.profile)

    @cached_property
    def deviations(self) -> Deviations:
        """How wrong the constants of cameras, instrument and tag may be."""
        from svmdist.estimation.instrument.measurement import Deviations

        return Deviations.of(self.profile)

    @cached_property
    def shaft_axis(self) -> ShaftAxis | None:
        """Which link carries the shaft, and where its axis is there; None without such a chain."""
        from svmdist.kinematics.dh import shaft_of

        return shaft_of(self.chain) if self.chain else None

    @cached_property
    def tag_pattern(self) -> TagPattern | None:
        """The fiducial's printed pattern; None where the profile has no fiducial."""
        from svmdist.vision.tag_overlay import TagPattern

        tag = self.profile.fiducial
        return TagPattern(tag.family, tag.id, tag.size_m) if tag else None

    def state_at(self, observation: Observation) -> RobotState | Failure:
        """Joints and nominal poses at an image's stamp; or what of them the log lacks."""
        from svmdist.kinematics.robot_state import RobotState

        if self.chain is None:
            return Failure(f"profile {self.profile.name} has no [robot]")
        return RobotState.of(
            self.chain,
            observation.joints,
            observation.T_camera_base,
            observation.stamp_ns,
            observation.joint_track,
        )


Value = TypeVar("Value")
Key = tuple[int, str]
Clock = Callable[[], float]


class CostLedger:
    """What the detections of one frame cost in s, each without those that it is made of.

    A frame is worked on by one thread at a time; `clock` is by default that thread's processor time, so that what
    other threads do meanwhile counts for nothing.
    """

    def __init__(self, clock: Clock = time.thread_time) -> None:
        self._clock = clock
        self._own_s: dict[Key, float] = {}
        self._parts: dict[Key, set[Key]] = {}
        self._open: list[tuple[set[Key], float]] = []

    def computed(self, key: Key, make: Callable[[], Value]) -> Value:
        """Compute a detection and note its cost."""
        self._open.append((set(), 0.0))
        start_s = self._clock()
        try:
            return make()
        finally:
            elapsed_s = self._clock() - start_s
            parts, inner_s = self._open.pop()
            self._own_s[key] = elapsed_s - inner_s
            self._parts[key] = {key}.union(*(self._parts[part] for part in parts))
            self._charge(key, elapsed_s)

    def used(self, key: Key) -> None:
        """Note that a detection was asked for which is known already."""
        self._charge(key, 0.0)

    def _charge(self, key: Key, elapsed_s: float) -> None:
        if self._open:
            asked, inner_s = self._open[-1]
            asked.add(key)
            self._open[-1] = asked, inner_s + elapsed_s

    @contextmanager
    def method(self, add_s: Callable[[float], None]) -> Any:
        """Tell what the steps inside cost, as if every detection had been computed for them."""
        self._open.append((set(), 0.0))
        start_s = self._clock()
        try:
            yield
        finally:
            elapsed_s = self._clock() - start_s
            asked, inner_s = self._open.pop()
            every = set[Key]().union(*(self._parts[key] for key in asked))
            add_s(elapsed_s - inner_s + sum(self._own_s[key] for key in every))


class detected(Generic[Value]):  # noqa: N801  (used as a decorator)
    """A property that is computed once an object, whose cost goes to the object's `ledger`."""

    def __init__(self, make: Callable[[Any], Value]) -> None:
        self._make = make
        self._name = make.__name__
        self.__doc__ = make.__doc__

    @overload
    def __get__(self, instance: None, owner: type) -> detected[Value]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> Value: ...

    def __get__(self, instance: Any, owner: type) -> Value | detected[Value]:
        """Give the value, computed now or before."""
        if instance is None:
            return self
        key = (id(instance), self._name)
        values: dict[str, Value] = instance.found
        if self._name in values:
            instance.ledger.used(key)
        else:
            values[self._name] = instance.ledger.computed(key, lambda: self._make(instance))
        return values[self._name]


@dataclass(frozen=True)
class View:
    """A camera, its image, and the pixels of other instruments in it.

    `others`, shape (h, w), marks the pixels that have an instrument's colours and belong to another one, or to none
    that is known; None where there is one instrument only.
    """

    camera: Camera
    context: FrameContext
    others: Image | None = None

    @cached_property
    def masks(self) -> Masks:
        """What is what, at normalised exposure, without the other instruments."""
        masks = self.context.masks
        return masks if self.others is None else InstrumentMasks(masks, self.others)

    @cached_property
    def masks_as_recorded(self) -> Masks:
        """The same of the image as it is, for the paper's methods."""
        masks = self.context.masks_as_recorded
        return masks if self.others is None else InstrumentMasks(masks, self.others)


class Scene:
    """One moment of a log before the instruments are told apart; all methods and instruments share its detections.

    Its `observation` is what ideal cameras would have seen; `lens` is the left camera as it is. `row_offset_px`
    is by how much the right view's rows lie below the left one's.
    """

    def __init__(
        self,
        observation: Observation,
        profile: Profile,
        segmenter: Segmenter,
        ledger: CostLedger | None = None,
        row_offset_px: float = 0.0,
    ) -> None:
        self.lens = observation.camera
        recorded = observation
        observation = with_first_fields(observation, profile.settings.interlace)
        self.is_interlaced = observation is not recorded
        self.observation = observation = as_pinholes(observation, row_offset_px)
        self.ledger = ledger or CostLedger()
        self.found: dict[str, Any] = {}
        self._profile = profile
        exposure = profile.settings.exposure
        self.left = FrameContext(observation.image_bgr, segmenter, exposure)
        right = observation.right
        self.right = None if right is None else FrameContext(right.image_bgr, segmenter, exposure)

    @detected
    def tissue(self) -> TissueDetection | None:
        """The tissue's outline and pose, by the left view."""
        from svmdist.estimation.tissue import detect_tissue

        return detect_tissue(self.left.masks, self._profile, self.observation.camera)

    @detected
    def stereo_pair(self) -> RectifiedPair | Failure:
        """The geometry of both views, where they are a rectified pair."""
        from svmdist.vision.stereo import rectified_pair

        right = self.observation.right
        return Failure("no right view") if right is None else rectified_pair(self.observation.camera, right)

    @detected
    def stereo_surface(self) -> StereoSurface | None:
        """The tissue's surface by both views; None where it is not seen, or they do not agree."""
        from svmdist.estimation.surface import detect_stereo_surface

        tissue, pair = self.tissue, self.stereo_pair
        if tissue is None or self.right is None or isinstance(pair, Failure):
            return None
        return detect_stereo_surface(
            self.left.grey,
            self.right.grey,
            pair,
            tissue.region.hull,
            (self.left.masks.tissue, self.right.masks.tissue),
            self._profile.stereo_in_range,
        )

    @detected
    def tags(self) -> dict[int, Array]:
        """Corners, shape (4, 2) in px, of every tag of the fiducial's family in the left view, by number."""
        return self._tags(self.left)

    @detected
    def right_tags(self) -> dict[int, Array]:
        """The same in the right view."""
        return {} if self.right is None else self._tags(self.right)

    def _tags(self, view: FrameContext) -> dict[int, Array]:
        from svmdist.vision.tags import find_tags

        fiducial = self._profile.fiducial
        return {} if fiducial is None else find_tags(view.grey, fiducial.family, self._profile.settings.tag)

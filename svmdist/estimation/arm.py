"""One instrument and the robot arm that carries it, as a profile describes them: the same in every frame."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

from svmdist.errors import ProfileError
from svmdist.profile import Profile
from svmdist.results import Failure
from svmdist.samples import Observation

if TYPE_CHECKING:  # a method imports what it uses of an arm, and starts sooner
    from svmdist.estimation.filter.constants import Deviations
    from svmdist.estimation.instrument.model import InstrumentModel
    from svmdist.kinematics.dh import DHChain, ShaftAxis
    from svmdist.kinematics.robot_state import RobotState
    from svmdist.vision.tag.pattern import TagPattern


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
        from svmdist.estimation.filter.constants import Deviations

        return Deviations.of(self.profile)

    @cached_property
    def shaft_axis(self) -> ShaftAxis | None:
        """Which link carries the shaft, and where its axis is there; None without such a chain."""
        from svmdist.kinematics.dh import shaft_of

        return shaft_of(self.chain) if self.chain else None

    @cached_property
    def tag_pattern(self) -> TagPattern | None:
        """The fiducial's printed pattern; None where the profile has no fiducial."""
        from svmdist.vision.tag.pattern import TagPattern

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

"""The part of a profile about further instruments: what of it is another for each of them."""

from __future__ import annotations

from collections.abc import Set

from pydantic import Field, model_validator

from svmdist.profile_robot import Instrument, Robot
from svmdist.toml_model import Angle, StrictModel

ARM_TOPICS = ("joints", "pose", "ground_truth_distance")
"""The topics that every instrument has of its own; the others are the whole scene's."""


class ArmTopics(StrictModel):
    """Topics of one instrument. A log without its joints and without its pose has not got the instrument."""

    joints: str | None = None
    pose: str | None = None
    ground_truth_distance: str | None = None

    @model_validator(mode="after")
    def _tells_of_the_instrument(self) -> ArmTopics:
        if self.joints is None and self.pose is None:
            raise ValueError("an instrument is known by its topics: name joints or pose")
        return self

    def are_in(self, topics: Set[str]) -> bool:
        """Whether a log with these topics has the instrument."""
        return bool(topics & {self.joints, self.pose})

    @property
    def named(self) -> dict[str, str]:
        """The topics that have a name, by role."""
        topics = {role: getattr(self, role) for role in ARM_TOPICS}
        return {role: topic for role, topic in topics.items() if topic is not None}


class ArmFrames(StrictModel):
    """Frames of one instrument."""

    base: str
    tool: str


class Placement(StrictModel):
    """Where a simulated arm's base stands in the world."""

    base_position_m: tuple[float, float, float]
    base_yaw_rad: Angle = 0.0


class OtherInstrument(StrictModel):
    """An instrument beside the profile's own; what is left out is as for that one."""

    name: str = Field(min_length=1)
    topics: ArmTopics
    frames: ArmFrames
    fiducial_id: int | None = Field(default=None, ge=0)
    """The number of the tag that this instrument carries where the profile's own does."""
    robot: Robot | None = None
    instrument: Instrument | None = None
    simulation: Placement | None = None

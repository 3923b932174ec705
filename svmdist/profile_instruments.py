"""The part of a profile about further instruments: what of it is another for each of them."""

from __future__ import annotations

from collections.abc import Set
from typing import Literal

from pydantic import Field, model_validator

from svmdist.profile_robot import Instrument, Robot
from svmdist.toml_model import Angle, StrictModel

EntrySide = Literal["left", "right", "above", "below"]
"""The side of the picture that an instrument comes in from."""
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
    """An instrument beside the profile's own; what is left out is as for that one.

    Without topics nothing but images tells of it: every log has it, and it is told by its side of the picture.
    """

    name: str = Field(min_length=1)
    topics: ArmTopics | None = None
    frames: ArmFrames | None = None
    entry: EntrySide | None = None
    """The side that it comes in from, where no joints tell it from the others."""
    fiducial_id: int | None = Field(default=None, ge=0)
    """The number of the tag that this instrument carries where the profile's own does."""
    robot: Robot | None = None
    instrument: Instrument | None = None
    simulation: Placement | None = None

    @model_validator(mode="after")
    def _frames_of_what_moves(self) -> OtherInstrument:
        if self.topics is not None and self.frames is None:
            raise ValueError("an instrument with topics has frames: give frames.base and frames.tool")
        return self

    @property
    def logged_topics(self) -> dict[str, str]:
        """Its topics that have a name, by role; none of an instrument that only images tell of."""
        return {} if self.topics is None else self.topics.named

    def is_in(self, topics: Set[str]) -> bool:
        """Whether a log with these topics has the instrument."""
        return self.topics is None or self.topics.are_in(topics)

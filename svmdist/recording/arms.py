"""Which of a profile's instruments a recording has, and the topics and frames of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from svmdist.profile import Frames, Profile
from svmdist.profile.robot import ARM_TOPICS
from svmdist.recording.sources import Source
from svmdist.recording.topics import TopicChoice
from svmdist.transforms import Array


@dataclass(frozen=True)
class FixedTransform:
    """A camera-to-base transform that holds for a whole log, `T_camera_base`, (4, 4); None says that none is known."""

    T_camera_base: Array | None


@dataclass(frozen=True)
class LoggedArm:
    """One instrument of a recording: the roles of the topics and the frames as it sees them."""

    name: str
    choice: TopicChoice
    frames: Frames
    fixed: FixedTransform | None = None
    """Where the base stands in place of what the log's transforms say; None: they say it."""


def find_arms(source: Source, profile: Profile, overrides: Mapping[str, str]) -> tuple[LoggedArm, ...]:
    """The profile's own instrument, and every other one whose joints or pose the recording has.

    The own one is left out where the profile names its joints or pose, the recording has neither, and another one is
    there: a profile of a robot's three arms serves a log of one.

    `overrides` choose topics by role: those of an arm are the first one's, and what they name is no other's.
    """
    infos = source.topics()
    there = {info.topic for info in infos} - {overrides[role] for role in ARM_TOPICS if role in overrides}
    others = [other for other in profile.other_instruments if other.is_in(there)]
    first = profile.topics
    of_first = {overrides.get(role) or getattr(first, role) for role in ARM_TOPICS} - {None}
    there |= of_first & set(overrides.values())
    known_by = {overrides.get(role) or getattr(first, role) for role in ("joints", "pose")} - {None}
    is_elsewhere = any(there & set(other.logged_topics.values()) for other in others)
    claims = {} if is_elsewhere and known_by and not known_by & there else {profile.instrument_name: of_first}
    claims |= {other.name: set(other.logged_topics.values()) for other in others}
    arms = []
    for name in claims:
        view = profile.for_instrument(name)
        is_first = name == profile.instrument_name
        chosen = {role: topic for role, topic in overrides.items() if is_first or role not in ARM_TOPICS}
        claimed = frozenset(topic for owner in claims if owner != name for topic in claims[owner] if topic)
        choice = TopicChoice(infos, view.topics, chosen, source.path.name, claimed)
        found = view.camera_to_base
        fixed = None if found is None else FixedTransform(found.T_camera_base)
        arms.append(LoggedArm(name, choice, view.frames, fixed))
    return tuple(arms)

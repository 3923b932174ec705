"""The commands and methods that a recording can serve with a profile, and what the others lack."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from svmdist.estimation.methods import REGISTRY
from svmdist.profile import Profile
from svmdist.recording.log import Recording
from svmdist.recording.observations import EVERYTHING, LEFT_IMAGES, Needs
from svmdist.recording.summary import RecordingSummary
from svmdist.recording.topics import Role
from svmdist.samples import Observation, Rejection
from svmdist.vision.colour import to_grey
from svmdist.vision.tags import find_tags

IMAGES = ("image", "camera_info")
COMMANDS = {
    "calibrate": (*IMAGES, "ground_truth_tf"),
    "validate": (*IMAGES, "reference"),
    "compare": (*IMAGES, "ground_truth_distance"),
    "blur-bench": (*IMAGES, "ground_truth_distance"),
    "fk": ("joints",),
}
"""What each command but `estimate` needs: topics by role, and inputs as of a method."""
PARTS = ("fiducial", "instrument", "robot", "tissue")
"""Tables of a profile that methods need."""
DEFAULT_METHOD = "overlay"  # of `estimate`
TAG_IMAGES = 8  # that a tag is looked for in, spread over the log


@dataclass(frozen=True, slots=True)
class TagCheck:
    """A tag's family and number, the images that it was looked for in, and those that show it."""

    name: str
    image_count: int
    found_count: int


@dataclass(frozen=True, slots=True)
class Capability:
    """A command or method, and what is missing for it; `note` is a condition under which it can be served."""

    name: str
    missing: tuple[str, ...]
    note: str = ""

    @property
    def served(self) -> bool:
        """Whether it can be served."""
        return not self.missing


def capabilities(
    summary: RecordingSummary, profile: Profile, tags: TagCheck | None = None
) -> tuple[Capability, ...]:
    """What this recording lacks for each command that reads recordings; `tags` is what `look_for_tag` found."""
    methods = method_capabilities(summary, profile, tags)
    profile = _seen_by_first(summary, profile)
    missing = {name: _missing(needs, summary, profile) for name, needs in COMMANDS.items()}
    (default,) = (method for method in methods if method.name == DEFAULT_METHOD)
    images, note = _missing(IMAGES, summary, profile), ""
    if not images and not default.served:
        lacks = f"the default method {DEFAULT_METHOD} lacks {'; '.join(default.missing)}"
        if others := " or ".join(method.name for method in methods if method.served):
            note = f"with --method {others}; {lacks}"
        else:
            images = (f"a method that log and profile serve ({lacks})",)
    return (Capability("estimate", images, note), *(Capability(*of) for of in missing.items()))


def method_capabilities(
    summary: RecordingSummary, profile: Profile, tags: TagCheck | None = None
) -> tuple[Capability, ...]:
    """The same for each method of `estimate`."""
    profile = _seen_by_first(summary, profile)
    return tuple(
        Capability(method.name, _missing((*IMAGES, *method.inputs), summary, profile, tags))
        for method in REGISTRY.values()
    )


def look_for_tag(recording: Recording, profile: Profile) -> TagCheck | None:
    """Look for the fiducial of the first instrument in some images of a log; None where the profile has none."""
    view = profile.for_instrument(recording.instruments[0])
    if view.fiducial is None:
        return None
    topic = recording.topic_of("image")
    count = next((info.message_count for info in recording.topics() if info.topic == topic), None) or 0
    looked = found = 0
    for observation in observations_of(recording, count // TAG_IMAGES, LEFT_IMAGES):
        tags = find_tags(to_grey(observation.image_bgr), view.fiducial.family, profile.settings.tag)
        looked += 1
        found += view.fiducial.id in tags
    return TagCheck(f"{view.fiducial.family} {view.fiducial.id}", looked, found)


def observations_of(recording: Recording, stride: int, needs: Needs = EVERYTHING) -> Iterator[Observation]:
    """What the first instrument's method would see, at each n-th image that can be decoded."""
    for number, encoded in enumerate(recording.encoded_observations(recording.instruments[:1], needs)):
        if number % max(1, stride) == 0 and not isinstance(found := encoded.decode().found, Rejection):
            yield found[0]


def instruments_in(summary: RecordingSummary, profile: Profile) -> tuple[str, ...]:
    """Names of the instruments that the log has: the profile's own, and the others whose joints or pose it has."""
    topics = {topic.topic for topic in summary.topics}
    others = [other for other in profile.other_instruments if other.is_in(topics)]
    names = tuple(other.name for other in others)
    theirs = {topic for other in others for topic in other.logged_topics.values()}
    named = {getattr(profile.topics, role) for role in ("joints", "pose")} - {None}
    own = (named | {summary.roles.get(role) for role in ("joints", "pose")}) - theirs
    is_elsewhere = theirs & topics and named and not own & topics
    return names if is_elsewhere else (profile.instrument_name, *names)


def _seen_by_first(summary: RecordingSummary, profile: Profile) -> Profile:
    first = instruments_in(summary, profile)[0]
    return profile if first == profile.instrument_name else profile.for_instrument(first)


def _missing(
    needs: tuple[str, ...], summary: RecordingSummary, profile: Profile, tags: TagCheck | None = None
) -> tuple[str, ...]:
    """What is missing of the needs of a command or a method, in words."""
    frames, of_profile = profile.frames, f"in profile {profile.name}"

    def topics(*roles: str) -> tuple[str, ...]:
        return tuple(f"a topic for {role}" for role in roles if role not in summary.roles)

    def unless(condition: object, words: str) -> tuple[str, ...]:
        return () if condition else (words,)

    has_base = profile.camera_to_base or {frames.camera, frames.base} <= set(summary.frames)
    tag = ""
    if tags is not None and tags.image_count and not tags.found_count:
        tag = f"the tag {tags.name}: it is in none of {tags.image_count} images looked at"
    lacking = {
        **{role: topics(role) for role in Role},
        **{part: unless(getattr(profile, part), f"[{part}] {of_profile}") for part in PARTS},
        "right_image": topics("right_image", "right_camera_info")
        or unless(
            summary.roles["right_image"] != summary.roles.get("image"), "a left image: it has the right"
        ),
        "joints": topics("joints") + _missing_chain(summary, profile),
        "reference": _missing_reference(summary, profile),
        "calibration": unless(profile.calibration, f"a calibration {of_profile} (--calibration)"),
        "camera_to_base": unless(has_base, f"transforms from {frames.camera} to {frames.base}"),
        "shaft": unless(profile.segmentation.shaft, f"[segmentation.shaft] {of_profile}"),
        "tag": unless(not tag, tag),
    }
    return tuple(words for need in needs for words in lacking[need])


def _missing_reference(summary: RecordingSummary, profile: Profile) -> tuple[str, ...]:
    if "ground_truth_distance" in summary.roles:
        return ()
    tissue, missing = profile.frames.tissue, []
    has_chain = "joints" in summary.roles and not _missing_chain(summary, profile)
    if not (has_chain or "pose" in summary.roles or profile.frames.tool in summary.frames):
        missing.append("the tool's pose (transforms, a pose topic or joint states)")
    if not ("ground_truth_tf" in summary.roles or tissue in summary.frames):
        missing.append(f"the tissue's place (a transform to {tissue}, or --truth-tf)")
    return tuple(missing)


def _missing_chain(summary: RecordingSummary, profile: Profile) -> tuple[str, ...]:
    if profile.robot is None:
        return (f"a [robot] in profile {profile.name}",)
    topic = summary.roles.get("joints")
    missing = profile.robot.missing_joints(summary.joint_names.get(topic, ())) if topic else ()
    return (f"the joints {', '.join(missing)} of profile {profile.name}",) if missing else ()

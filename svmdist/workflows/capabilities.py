"""Which topic of an unknown log plays which role, by schemas and by the names that recorders give."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from svmdist.errors import RecordingError, UsageError, did_you_mean
from svmdist.estimation.methods import METHODS
from svmdist.profile import Profile
from svmdist.recording.log import Recording
from svmdist.recording.observations import LEFT_IMAGES
from svmdist.recording.source import sanitize, sanitize_list
from svmdist.recording.summary import RecordingSummary
from svmdist.recording.topics import Role
from svmdist.samples import Rejection
from svmdist.vision.tags import find_tags

OTHER_ARMS = re.compile(r"/(ECM|MTM\w*|SUJ\w*|MTML|MTMR)(/|$)")
"""Arms of a da Vinci that carry no instrument."""
INSTRUMENT = re.compile(r"/(PSM\d+|[A-Za-z]\w*)")


@dataclass(frozen=True)
class InstrumentTopics:
    """An instrument's name and its topics."""

    name: str
    joints: str | None
    pose: str | None


@dataclass(frozen=True)
class LogRoles:
    """Topics by role, and the instruments; `other_images` are topics with images that play none."""

    topics: dict[str, str]
    instruments: tuple[InstrumentTopics, ...]
    other_images: tuple[str, ...]


def find_roles(summary: RecordingSummary, given: Mapping[str, str]) -> LogRoles:
    """Find the topics; `given` chooses some by role.

    Raises RecordingError where a choice is the user's to make, and for a given topic that is not in the log;
    UsageError for an unknown role.
    """
    there = [topic.topic for topic in summary.topics]
    for role, chosen in given.items():
        if role not in list(Role):
            raise UsageError(f"no role {role} for a topic: {did_you_mean(role, list(Role))}")
        if chosen not in there:
            raise RecordingError(
                f"{summary.path.name}: no topic {sanitize(chosen)} for {sanitize(role)}; the topics are"
                f" {sanitize_list(there) or 'none'}"
            )
    kinds: dict[str, list[str]] = {}
    for topic in summary.topics:
        if topic.kind is not None and topic.message_count:
            kinds.setdefault(topic.kind, []).append(topic.topic)
    images = [topic for topic in kinds.get("images", []) if not _is_depth(topic)]
    image = given.get("image") or _left_image(images, summary)
    topics = {"image": image, "camera_info": given.get("camera_info") or _nearest(image, kinds, summary)}
    right = given.get("right_image") or _right_of(image, images)
    if right is not None:
        topics["right_image"] = right
        others = {
            **kinds,
            "camera calibrations": [
                c for c in kinds.get("camera calibrations", []) if c != topics["camera_info"]
            ],
        }
        if given.get("right_camera_info") or others["camera calibrations"]:
            topics["right_camera_info"] = given.get("right_camera_info") or _nearest(right, others, summary)
        else:
            del topics["right_image"]
    transforms = [topic for topic in kinds.get("transforms", []) if "ground_truth" not in topic]
    moving = [topic for topic in transforms if not topic.endswith("tf_static")]
    if given.get("tf") or len(moving) == 1:
        topics["tf"] = given.get("tf") or moving[0]
    instruments = _instruments(
        [given["joints"]] if "joints" in given else _tools(kinds.get("joint states", []), "measured_js"),
        [given["pose"]] if "pose" in given else _tools(kinds.get("poses", []), "measured_cp"),
    )
    used = set(topics.values())
    return LogRoles(topics, instruments, tuple(topic for topic in images if topic not in used))


def _left_image(images: Sequence[str], summary: RecordingSummary) -> str:
    """The only topic of images that is not a right camera's, or the only left one."""
    lefts = [topic for topic in images if not _is_right(topic)] or list(images)
    if len(lefts) > 1:
        lefts = [topic for topic in lefts if _right_of(topic, images)] or lefts
    if len(lefts) > 1:
        lefts = [topic for topic in lefts if "left" in topic.lower()] or lefts
    if len(lefts) > 1:
        lefts = [topic for topic in lefts if "rect" in topic.lower()] or lefts
    if len(lefts) == 1:
        return lefts[0]
    name = summary.path.name
    if not lefts:
        there = sanitize_list(topic.topic for topic in summary.topics)
        raise RecordingError(f"{name}: no topic with images; the topics are {there or 'none'}")
    raise RecordingError(
        f"{name}: several topics carry images: choose one with --topic image=TOPIC: {sanitize_list(lefts)}"
    )


def _right_of(left: str, images: Sequence[str]) -> str | None:
    """The topic that differs from a left one by saying right."""
    for one, other in (
        ("left", "right"),
        ("Left", "Right"),
        ("LEFT", "RIGHT"),
        ("_l/", "_r/"),
        ("/l/", "/r/"),
    ):
        name = left.replace(one, other)
        if name != left and name in images:
            return name
    rights = [topic for topic in images if _is_right(topic)]
    return rights[0] if len(rights) == 1 and rights[0] != left else None


def _is_right(topic: str) -> bool:
    return "right" in topic.lower() or bool(re.search(r"[/_]r([/_]|$)", topic.lower()))


def _is_depth(topic: str) -> bool:
    return "depth" in topic.lower() or "disparity" in topic.lower()


def _nearest(image: str, kinds: Mapping[str, Sequence[str]], summary: RecordingSummary) -> str:
    """The calibration whose topic shares most of its name with the images'."""
    cameras = kinds.get("camera calibrations", [])
    if not cameras:
        raise RecordingError(
            f"{summary.path.name}: no topic with camera calibrations: estimates need one"
            " (svmdist import writes a log of images and a calibration)"
        )
    return max(cameras, key=lambda topic: (_shared(topic, image), -len(topic)))


def _shared(a: str, b: str) -> int:
    parts = zip(a.split("/"), b.split("/"), strict=False)
    return next((place for place, (one, other) in enumerate(parts) if one != other), 99)


def _tools(topics: Sequence[str], preferred: str) -> list[str]:
    """Topics of arms that carry instruments; where an arm has several, the preferred one."""
    tools = [
        topic
        for topic in topics
        if not OTHER_ARMS.search(topic) and "jaw" not in topic and "ground_truth" not in topic
    ]
    named = [topic for topic in tools if topic.rpartition("/")[2] == preferred]
    return named or tools


def _instruments(joints: Sequence[str], poses: Sequence[str]) -> tuple[InstrumentTopics, ...]:
    """Joints and poses by the name of the arm that their topics have."""
    found: dict[str, dict[str, str]] = {}
    for role, topics in (("joints", joints), ("pose", poses)):
        for topic in topics:
            found.setdefault(_name(topic), {}).setdefault(role, topic)
    return tuple(
        InstrumentTopics(name, roles.get("joints"), roles.get("pose"))
        for name, roles in sorted(found.items())
    )


def _name(topic: str) -> str:
    """PSM1 of `/dvrk/PSM1/state_joint_current`; else the first part that starts with a letter."""
    arm = re.search(r"/(PSM\d+)(/|$)", topic)
    if arm:
        return arm[1]
    first = INSTRUMENT.search(topic)
    return first[1] if first and topic.count("/") > 1 else "PSM1"


DEFAULT_METHOD = "overlay"
"""Of `estimate`."""
TAG_IMAGES = 8
"""Images that a tag is looked for in, spread over the log."""


@dataclass(frozen=True, slots=True)
class TagCheck:
    """A tag's family and number, the images that it was looked for in, and those that show it."""

    name: str
    image_count: int
    found_count: int


@dataclass(frozen=True, slots=True)
class Capability:
    """A command or method, and what is missing for it. Where nothing is missing, it can be served.

    `note` says under which condition, empty for none.
    """

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
    """Tell for each command that reads recordings what this one lacks; `tags` is what `look_for_tag` found."""
    profile = seen_by_first(summary, profile)
    images = _lacking(summary, "image", "camera_info")
    return (
        _estimate(images, method_capabilities(summary, profile, tags)),
        Capability("calibrate", images + _lacking(summary, "ground_truth_tf")),
        Capability("validate", images + _reference_lacking(summary, profile)),
        Capability("compare", images + _lacking(summary, "ground_truth_distance")),
        Capability("blur-bench", images + _lacking(summary, "ground_truth_distance")),
        Capability("fk", _lacking(summary, "joints") + _chain_lacking(summary, profile)),
    )


def _estimate(images: tuple[str, ...], methods: tuple[Capability, ...]) -> Capability:
    """`estimate` runs where its default method does, or else with another one that is named."""
    default = next(method for method in methods if method.name == DEFAULT_METHOD)
    others = [method.name for method in methods if method.served]
    if images or default.served:
        return Capability("estimate", images)
    lacks = f"the default method {DEFAULT_METHOD} lacks {'; '.join(default.missing)}"
    if not others:
        return Capability("estimate", (f"a method that log and profile serve ({lacks})",))
    return Capability("estimate", (), f"with --method {' or '.join(others)}; {lacks}")


def look_for_tag(recording: Recording, profile: Profile) -> TagCheck | None:
    """Look for the fiducial of the first instrument in some images of a log; None where the profile has none."""
    view = profile.for_instrument(recording.instruments[0])
    if view.fiducial is None:
        return None
    topic = recording.topic_of("image")
    count = next((info.message_count for info in recording.topics() if info.topic == topic), None) or 0
    stride = max(1, count // TAG_IMAGES)
    looked = found = 0
    for number, encoded in enumerate(recording.encoded_observations(recording.instruments[:1], LEFT_IMAGES)):
        if number % stride:
            continue
        observation = encoded.decode().found
        if isinstance(observation, Rejection):
            continue
        grey = cv2.cvtColor(observation[0].image_bgr, cv2.COLOR_BGR2GRAY)
        tags = find_tags(np.asarray(grey, np.uint8), view.fiducial.family, profile.settings.tag)
        looked += 1
        found += view.fiducial.id in tags
    return TagCheck(f"{view.fiducial.family} {view.fiducial.id}", looked, found)


def seen_by_first(summary: RecordingSummary, profile: Profile) -> Profile:
    """The profile as the first instrument of the log sees it."""
    first = instruments_in(summary, profile)[0]
    return profile if first == profile.instrument_name else profile.for_instrument(first)


def method_capabilities(
    summary: RecordingSummary, profile: Profile, tags: TagCheck | None = None
) -> tuple[Capability, ...]:
    """Tell for each method of `estimate` what log and profile lack; `tags` is what `look_for_tag` found."""
    profile = seen_by_first(summary, profile)
    images = _lacking(summary, "image", "camera_info")
    joints = _lacking(summary, "joints") + _chain_lacking(summary, profile)
    kinematics = joints + _camera_transform_lacking(summary, profile)
    in_3d = _parts_lacking(profile, "robot", "tissue")
    shaft = () if profile.segmentation.shaft else (f"[segmentation.shaft] in profile {profile.name}",)
    calibration = () if profile.calibration else (f"a calibration in profile {profile.name} (--calibration)",)
    needs = {
        "overlay": calibration,
        "centroid": calibration,
        "fiducial": joints + _parts_lacking(profile, "fiducial", "tissue") + _tag_lacking(tags),
        "shaft": shaft + _parts_lacking(profile, "instrument") + in_3d,
        "stereo": _lacking(summary, "right_image", "right_camera_info") + in_3d,
        "kinematic": kinematics + _parts_lacking(profile, "tissue"),
        "fused": kinematics + _parts_lacking(profile, "tissue"),
    }
    return tuple(Capability(method, images + needs.get(method, ())) for method in METHODS)


def _tag_lacking(tags: TagCheck | None) -> tuple[str, ...]:
    if tags is None or tags.found_count or not tags.image_count:
        return ()
    return (f"the tag {tags.name}: it is in none of {tags.image_count} images looked at",)


def _parts_lacking(profile: Profile, *tables: str) -> tuple[str, ...]:
    return tuple(
        f"[{table}] in profile {profile.name}" for table in tables if getattr(profile, table) is None
    )


def _camera_transform_lacking(summary: RecordingSummary, profile: Profile) -> tuple[str, ...]:
    frames = profile.frames
    if profile.camera_to_base is not None:
        return ()
    if {frames.camera, frames.base} <= set(summary.frames):
        return ()
    return (f"transforms from {frames.camera} to {frames.base}",)


def instruments_in(summary: RecordingSummary, profile: Profile) -> tuple[str, ...]:
    """Names of the instruments that the log has: the profile's own, and the others whose joints or pose it has."""
    topics = {topic.topic for topic in summary.topics}
    others = [other for other in profile.other_instruments if other.is_in(topics)]
    names = tuple(other.name for other in others)
    theirs = {topic for other in others for topic in other.logged_topics.values()}
    named = {getattr(profile.topics, role) for role in ("joints", "pose")} - {None}
    own = (named | {summary.roles.get(role) for role in ("joints", "pose")}) - theirs
    if theirs & topics and named and not own & topics:
        return names
    return (profile.instrument_name, *names)


def _lacking(summary: RecordingSummary, *roles: str) -> tuple[str, ...]:
    return tuple(f"a topic for {role}" for role in roles if role not in summary.roles)


def _reference_lacking(summary: RecordingSummary, profile: Profile) -> tuple[str, ...]:
    """A reference is ground truth, or a pose of the tool together with the tissue's place."""
    if "ground_truth_distance" in summary.roles:
        return ()
    tissue = profile.frames.tissue
    has_tissue = "ground_truth_tf" in summary.roles or tissue in summary.frames
    has_tool = (
        "pose" in summary.roles
        or profile.frames.tool in summary.frames
        or ("joints" in summary.roles and not _chain_lacking(summary, profile))
    )
    lacking = () if has_tool else ("the tool's pose (transforms, a pose topic or joint states)",)
    return (
        lacking if has_tissue else (*lacking, f"the tissue's place (a transform to {tissue}, or --truth-tf)")
    )


def _chain_lacking(summary: RecordingSummary, profile: Profile) -> tuple[str, ...]:
    if profile.robot is None:
        return (f"a [robot] in profile {profile.name}",)
    topic = summary.roles.get("joints")
    if topic is None:
        return ()
    there = set(summary.joint_names.get(topic, ()))
    missing = [
        joint.name
        for joint in profile.robot.joints
        if joint.type != "fixed" and not there & {joint.name, *joint.aliases}
    ]
    return (f"the joints {', '.join(missing)} of profile {profile.name}",) if missing else ()

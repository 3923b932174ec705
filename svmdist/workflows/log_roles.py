"""Which topic of an unknown log plays which role, by schemas and by the names that recorders give."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from svmdist.errors import RecordingError, UsageError, did_you_mean
from svmdist.recording.inspect import RecordingSummary
from svmdist.recording.names import sanitize, sanitize_list
from svmdist.recording.topics import Role

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

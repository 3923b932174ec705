"""The commands and methods that a recording can serve with a profile, and what the others lack."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from svmdist.estimation.methods import METHODS
from svmdist.profile import Profile
from svmdist.recording.encoded import LEFT_IMAGES
from svmdist.recording.inspect import RecordingSummary
from svmdist.recording.reader import Recording
from svmdist.samples import Rejection
from svmdist.vision.tag.detection import find_tags

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

"""A first profile of a log: topics by role, frames, chains, colours, and the plane that both views show."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import permutations
from typing import NamedTuple

import numpy as np

from svmdist.errors import RecordingError, UsageError, did_you_mean
from svmdist.estimation.entries import SIDE_MIDDLES
from svmdist.estimation.frame import Scene
from svmdist.estimation.tissue.surface import depth_biases
from svmdist.least_squares import scale_of
from svmdist.profile import Profile, Topics, load_profile
from svmdist.profile.robot import CameraError, EntrySide, Robot, Tissue
from svmdist.profile.segmentation import AutoSegmentation, ColourRegion, HsvSegmentation
from svmdist.profile.settings import AutoSettings
from svmdist.recording.log import Recording, open_recording
from svmdist.recording.messages import unread
from svmdist.recording.source import sanitize, sanitize_list
from svmdist.recording.summary import RecordingSummary, inspect_recording
from svmdist.recording.topics import Role, is_right
from svmdist.remote import LogPath
from svmdist.samples import Image, Observation
from svmdist.vision.colour import DistinctColour, find_distinct_colour
from svmdist.vision.frame_context import as_pinholes, make_segmenter
from svmdist.vision.instruments.evidence import Evidence
from svmdist.vision.instruments.find_instruments import find_instruments
from svmdist.vision.stereo import RowAlignment
from svmdist.workflows.capabilities import observations_of
from svmdist.workflows.check import SOMEWHERE, compare_views, offset_to_remove

OTHER_ARMS = re.compile(r"/(ECM|MTM\w*|SUJ\w*)(/|$)")  # of a da Vinci, without an instrument
SIDES = (("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT"), ("_l/", "_r/"), ("/l/", "/r/"))
"""How topics tell the left camera from the right one."""
TOOL_TOPICS = (("joints", "joint states", "measured_js"), ("pose", "poses", "measured_cp"))
CHAIN_PROFILES = ("dvrk-psm", "psm13")  # shipped profiles whose chains a log's joints may belong to
DA_VINCI_INSTRUMENT, UNKNOWN_INSTRUMENT = "da-vinci-8mm", "unknown"
LOOKED_AT = 12  # images that colours and plane are taken from, spread over the log
VIEWS_COMPARED = 4  # of them, against the cameras
ENOUGH_IMAGES = 1.0 / 3.0  # share that shows so many instruments: one may be out of view for a while
MIN_PLANES = 3
LEAST_PLANE_STD_M, LEAST_TILT_STD_RAD, LEAST_SURFACE_STD_M = 1e-3, 0.05, 1e-3
POINTS_PER_PAIR = 500


@dataclass(frozen=True)
class InstrumentDraft:
    """An instrument: its topics by role, the shipped profile whose chain fits its joints, or the side it enters by."""

    name: str
    topics: Mapping[str, str]
    base: str
    tool: str
    chain: str | None
    joint_names: tuple[str, ...] = ()
    entry: EntrySide | None = None


@dataclass(frozen=True)
class ProfileDraft:
    """What a first profile is made of; `instrument` is a name in the table of instruments."""

    name: str
    log: str
    size_px: tuple[int, int]
    topics: Mapping[str, str]
    other_images: tuple[str, ...]
    camera_frame: str
    instruments: tuple[InstrumentDraft, ...]
    mark: DistinctColour | None
    plane: Tissue | None
    pair_count: int  # of views, which show the plane
    instrument: str
    has_camera_to_base: bool
    image_count: int


class LogRoles(NamedTuple):
    """Topics by role, those for joints and pose by instrument, and topics with images that have no role."""

    topics: dict[str, str]
    instruments: dict[str, dict[str, str]]
    other_images: tuple[str, ...]


def draft_profile(path: LogPath, name: str, topics: Mapping[str, str], instrument: str | None = None) -> ProfileDraft:
    """Look at a log and draft its profile; `topics` chooses some by role, where `find_roles` would raise."""
    blank = _blank({})
    summary = inspect_recording(open_recording(path, blank))
    roles = find_roles(summary, topics)
    recording = open_recording(path, _blank(roles.topics))
    camera = recording.camera
    count = next(topic.message_count for topic in summary.topics if topic.topic == roles.topics["image"])
    observations = list(observations_of(recording, count // LOOKED_AT))
    views = compare_views(observations[:VIEWS_COMPARED], blank)
    if views.refusal:
        raise RecordingError(f"{path.name}: no profile of it would be right: {views.refusal}")
    images = [as_pinholes(seen).image_bgr for seen in observations]
    instruments = tuple(
        _instrument(name, own, summary, path, blank, len(roles.instruments)) for name, own in roles.instruments.items()
    )
    has_base = bool(instruments) and recording.nominal_tree.links(camera.frame_id, instruments[0].base)
    if not has_base and len(instruments) != 1:  # nothing else separates them
        seen = _instruments_by_entries(images)
        if len(seen) == len(instruments):
            instruments = tuple(replace(one, entry=other.entry) for one, other in zip(instruments, seen, strict=True))
        instruments = instruments or seen
    return ProfileDraft(
        name,
        path.name,
        (camera.width_px, camera.height_px),
        roles.topics,
        roles.other_images,
        camera.frame_id or "camera",
        instruments,
        find_distinct_colour(images, len(instruments)),
        *_surface(recording, observations, views.rows),
        instrument or (UNKNOWN_INSTRUMENT if instruments[0].chain is None else DA_VINCI_INSTRUMENT),
        has_base,
        len(images),
    )


def find_roles(summary: RecordingSummary, given: Mapping[str, str]) -> LogRoles:
    """Topics by schemas and usual names, or as `given` by role; RecordingError, UsageError."""
    log, there = summary.recording.path.name, [topic.topic for topic in summary.topics]
    for role, chosen in given.items():
        if role not in list(Role):
            raise UsageError(f"no role {role} for a topic: {did_you_mean(role, list(Role))}")
        if chosen not in there:
            known = did_you_mean(sanitize(chosen), map(sanitize, there))
            raise RecordingError(f"{log}: no topic {sanitize(chosen)} for {sanitize(role)}: {known}")

    def carrying(kind: str, *unwanted: str) -> list[str]:
        topics = [topic.topic for topic in summary.topics if topic.kind == kind and topic.message_count]
        return [topic for topic in topics if not any(word in topic.lower() for word in unwanted)]

    images, cameras = carrying("images", "depth", "disparity"), carrying("camera calibrations")
    image = given.get("image") or _left_image(images, summary)
    fitting = [topic for topic in cameras if is_right(image) or not is_right(topic)]
    if not (fitting or "camera_info" in given):
        none = f"{log}: no topic with camera calibrations"
        if cameras:
            remedy = "(--topic camera_info=TOPIC chooses another)"
            raise RecordingError(f"{none} for {sanitize(image)}: {sanitize_list(cameras)} is the right view's {remedy}")
        remedy = f"(svmdist import writes a log of images and a calibration){unread(summary.recording.topics())}"
        raise RecordingError(f"{none}: estimates need one {remedy}")
    camera = given.get("camera_info") or _nearest(image, fitting)
    topics = {"image": image, "camera_info": camera}
    right = given.get("right_image") or _right_of(image, images)
    others = [topic for topic in cameras if topic != camera]
    if right and (others or "right_camera_info" in given):
        topics |= {"right_image": right, "right_camera_info": given.get("right_camera_info") or _nearest(right, others)}
    moving = [topic for topic in carrying("transforms", "ground_truth") if not topic.endswith("tf_static")]
    truths = [topic for topic in carrying("transforms") if "ground_truth" in topic.lower()]
    for role, found in {"tf": moving, "ground_truth_tf": truths}.items():
        if role in given or len(found) == 1:
            topics[role] = given.get(role) or found[0]
    instruments: dict[str, dict[str, str]] = {}
    for role, kind, preferred in TOOL_TOPICS:
        tools = [topic for topic in carrying(kind, "jaw", "ground_truth") if not OTHER_ARMS.search(topic)]
        named = [topic for topic in tools if topic.rpartition("/")[2] == preferred]
        for topic in [given[role]] if role in given else named or tools:
            instruments.setdefault(_instrument_name(topic), {}).setdefault(role, topic)
    distance = given.get("ground_truth_distance")
    for topic in [distance] if distance else carrying("true distances"):
        named = [name for name in instruments if name in topic.split("/")]
        if len(named) < 2 and instruments:  # more are the distance of two instruments
            instruments[(named or sorted(instruments))[0]].setdefault("ground_truth_distance", topic)
    others = [topic for topic in images if topic not in topics.values()]
    return LogRoles(topics, dict(sorted(instruments.items())), tuple(others))


def _left_image(images: Sequence[str], summary: RecordingSummary) -> str:
    """The only topic of images that is not a right camera's, or the only left one."""
    name, lefts = summary.recording.path.name, list(images)
    if not lefts:
        there = sanitize_list(topic.topic for topic in summary.topics) or "none"
        said = f"the topics are {there}{unread(summary.recording.topics())}"
        raise RecordingError(f"{name}: no topic with images; {said}")
    lefts = [topic for topic in lefts if not is_right(topic)] or lefts
    lefts = [topic for topic in lefts if _right_of(topic, images)] or lefts
    for word in ("left", "rect"):
        lefts = [topic for topic in lefts if word in topic.lower()] or lefts
    if len(lefts) > 1:
        several = "several topics carry images: choose one with --topic image=TOPIC"
        raise RecordingError(f"{name}: {several}: {sanitize_list(lefts)}")
    return lefts[0]


def _right_of(left: str, images: Sequence[str]) -> str | None:
    named = (left.replace(one, other) for one, other in SIDES)
    rights = [topic for topic in images if is_right(topic)]
    only = rights[0] if len(rights) == 1 and rights[0] != left else None
    return next((name for name in named if name != left and name in images), only)


def _nearest(image: str, cameras: Sequence[str]) -> str:
    """The calibration whose topic shares most of its name with the images'."""

    def shared(topic: str) -> int:
        parts = zip(topic.split("/"), image.split("/"), strict=False)
        return next((place for place, (one, other) in enumerate(parts) if one != other), 99)

    return max(cameras, key=lambda topic: (shared(topic), -len(topic)))


def _instrument_name(topic: str) -> str:
    """PSM1 of `/dvrk/PSM1/state_joint_current`; else the first part that starts with a letter."""
    if arm := re.search(r"/(PSM\d+)(/|$)", topic):
        return arm[1]
    first = re.search(r"/([A-Za-z]\w*)", topic)
    return first[1] if first and topic.count("/") > 1 else "PSM1"


def _blank(topics: Mapping[str, str]) -> Profile:
    any_pixel = ColourRegion(hue=(0, 179), min_area_px=1)
    segmentation = HsvSegmentation(tissue=any_pixel, instrument=any_pixel)
    return Profile(name="blank", topics=Topics(**topics), segmentation=segmentation)


def _instruments_by_entries(images: Sequence[Image]) -> tuple[InstrumentDraft, ...]:
    """As many instruments as images often show, from right to left, with their nearest sides; else one of any side."""
    found = [find_instruments(Evidence(image, AutoSettings()))[: len(SIDE_MIDDLES)] for image in images]
    seen = [[one.entry_px / one.size[::-1] for one in instruments] for instruments in found]
    least = max(ENOUGH_IMAGES * len(images), min(2, len(images)), 1)
    several = range(2, len(SIDE_MIDDLES) + 1)
    count = max([1, *(n for n in several if sum(len(one) >= n for one in seen) >= least)])
    entries: tuple[EntrySide | None, ...] = (None,)
    if count > 1:
        # In the order of the picture's rim, from below over left, above and right, the same place is the same one
        around = [
            sorted(one[:count], key=lambda at: np.arctan2(0.5 - at[0], at[1] - 0.5) % (2.0 * np.pi))
            for one in seen
            if len(one) >= count
        ]
        middles = np.array(sorted(np.median(around, 0), key=lambda at: -float(at[0])))
        off = {side: np.sum((middles - at) ** 2, 1) for side, at in SIDE_MIDDLES.items()}
        ways = permutations(SIDE_MIDDLES, count)  # no two come in from one side
        nearest = min(ways, key=lambda sides: sum(off[side][n] for n, side in enumerate(sides)))
        entries = nearest
    return tuple(
        InstrumentDraft(f"PSM{number}", {}, f"PSM{number}_base", f"PSM{number}", None, entry=entry)
        for number, entry in enumerate(entries, 1)
    )


def _surface(
    recording: Recording, observations: Sequence[Observation], rows: RowAlignment | None
) -> tuple[Tissue | None, int]:
    """The plane through the tissue's surface as pairs of views show it, and how many; None where too few agree."""
    if recording.right_camera is None:
        return None, 0
    rules = _blank({}).model_copy(update={"segmentation": AutoSegmentation(method="auto"), "tissue": SOMEWHERE})
    segmenter = make_segmenter(rules.segmentation)
    rows = rows or offset_to_remove(observations, rules)
    clouds, stds_m = [], []
    for observation in observations:
        scene = Scene(observation, rules, segmenter, rows)
        surface, right = scene.stereo_surface, scene.observation.right
        if surface is None or right is None:
            continue
        clouds.append(surface.points_m[:: max(1, len(surface.points_m) // POINTS_PER_PAIR)])
        biases = depth_biases(np.median(surface.points_m, 0), scene.observation.camera, right, CameraError())
        stds_m.append(float(np.sqrt(sum(float(np.sum(bias.jacobian**2)) for bias in biases))))
    if len(clouds) < MIN_PLANES:
        return None, 0
    points_m = np.concatenate(clouds)
    normal = np.linalg.svd(points_m - points_m.mean(0), full_matrices=False)[2][2]
    normal *= -np.sign(normal[2])
    if normal[2] > -0.3:  # too steep for a surface that an endoscope looks at
        return None, 0
    distances_m = np.array([-np.mean(cloud @ normal) for cloud in clouds])
    heights_m = points_m @ normal - np.mean(points_m @ normal)
    distance_std_m = np.hypot(np.median(stds_m), scale_of(distances_m - np.median(distances_m)))
    tissue = Tissue.model_construct(  # what is found is written down, plausible or not
        plane_normal=tuple(normal.tolist()),
        plane_distance_m=float(np.median(distances_m)),
        plane_distance_std_m=max(float(distance_std_m), LEAST_PLANE_STD_M),
        plane_tilt_std_rad=LEAST_TILT_STD_RAD,
        surface_std_m=max(float(np.sqrt(np.mean(heights_m**2))), LEAST_SURFACE_STD_M),
    )
    return tissue, len(clouds)


def _instrument(
    name: str, topics: Mapping[str, str], summary: RecordingSummary, path: LogPath, blank: Profile, count: int
) -> InstrumentDraft:
    joint_names = summary.joint_names.get(topics.get("joints", ""), ())
    base, frames = None, set(summary.frames)
    if pose := topics.get("pose"):
        with suppress(RecordingError):  # poses in several frames, or in one without a name
            base = open_recording(path, blank, topics={"pose": pose}).pose_track().parent or None
    if base is None:
        own = f"{name}_base"
        base = "base" if count == 1 and own not in frames and "base" in frames else own
    tools = (f"{name}_tool", f"{name}_ee", name, "tool")
    tool = next((frame for frame in tools if frame in frames and frame != base), name)
    robots = {profile: shipped_robot(profile) for profile in CHAIN_PROFILES}
    fitting = [profile for profile, robot in robots.items() if not robot.missing_joints(joint_names)]
    longest = max(fitting, key=lambda profile: len(robots[profile].joints), default=None)
    return InstrumentDraft(name, topics, base, tool, longest, joint_names)


def shipped_robot(name: str) -> Robot:
    """The chain of a shipped profile."""
    robot = load_profile(name).robot
    assert robot is not None
    return robot

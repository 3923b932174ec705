"""A first profile of a log: topics, frames, chains and colours as far as they show, the plane by two views."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from svmdist.profile import Profile, Robot, load_profile
from svmdist.profile.profile import Topics
from svmdist.profile.segmentation import ColourRegion, HsvSegmentation
from svmdist.recording.log import Recording, open_recording
from svmdist.recording.summary import RecordingSummary, inspect_recording
from svmdist.samples import Image, Observation, Rejection
from svmdist.vision.colour import DistinctColour, find_distinct_colour
from svmdist.vision.frame_context import as_pinholes
from svmdist.vision.segmentation import AutoSegmenter
from svmdist.vision.stereo import StereoPlane, fit_plane
from svmdist.workflows.capabilities import InstrumentTopics, LogRoles, find_roles

CHAIN_PROFILES = ("dvrk-psm", "psm13")
"""Profiles that ship whose chains a log's joints may be of."""
LOOKED_AT = 12
"""Images that colours and plane are taken from, spread over the log."""
MOST_IMAGES = 0.6
"""An instrument is one that most of the images show."""
MIN_PLANES = 3
LEAST_PLANE_STD_M, LEAST_TILT_STD_RAD, LEAST_SURFACE_STD_M = 3e-3, 0.05, 1e-3
"""Tissue is no plane: what is fitted to all of it is off by this much where the tool works."""


@dataclass(frozen=True)
class InstrumentDraft:
    """An instrument: its topics, frames, and the profile that ships its chain; None where the log's joints fit none."""

    name: str
    joints: str | None
    pose: str | None
    base: str
    tool: str
    chain: str | None
    joint_names: tuple[str, ...] = ()
    entry: str | None = None
    """The side of the picture that it comes in from, where nothing else tells instruments apart."""


@dataclass(frozen=True)
class PlaneDraft:
    """The tissue's plane with standard deviations, as both views show it."""

    normal: tuple[float, float, float]
    distance_m: float
    distance_std_m: float
    tilt_std_rad: float
    surface_std_m: float


@dataclass(frozen=True)
class ProfileDraft:
    """What a first profile is made of."""

    name: str
    log: str
    size_px: tuple[int, int]
    topics: Mapping[str, str]
    other_images: tuple[str, ...]
    camera_frame: str
    instruments: tuple[InstrumentDraft, ...]
    mark: DistinctColour | None
    plane: PlaneDraft | None
    has_camera_to_base: bool
    image_count: int


def draft_profile(path: Path, name: str, topics: Mapping[str, str]) -> ProfileDraft:
    """Look at a log and say what its profile would be; `topics` chooses some by role.

    Raises RecordingError where the log has no images or calibration, or several of which the user must choose one.
    """
    blank = _blank({})
    summary = inspect_recording(path, blank)
    roles = find_roles(summary, topics)
    profile = _blank(roles.topics)
    recording = open_recording(path, profile)
    camera = recording.camera
    images, planes = _look(recording, summary, roles)
    instruments = tuple(
        _instrument(one, summary, path, blank, len(roles.instruments)) for one in roles.instruments
    ) or _by_sides(_entry_sides(images))
    return ProfileDraft(
        name,
        path.name,
        (camera.width_px, camera.height_px),
        roles.topics,
        roles.other_images,
        camera.frame_id or "camera",
        instruments,
        find_distinct_colour(images, len(instruments)),
        _plane(planes),
        {camera.frame_id, instruments[0].base} <= set(summary.frames),
        len(images),
    )


def _blank(topics: Mapping[str, str]) -> Profile:
    """A profile that knows nothing but topics."""
    any_pixel = ColourRegion(hue=(0, 179), min_area_px=1)
    return Profile(
        name="blank",
        topics=Topics(**topics),
        segmentation=HsvSegmentation(tissue=any_pixel, instrument=any_pixel),
    )


def _look(
    recording: Recording, summary: RecordingSummary, roles: LogRoles
) -> tuple[list[Image], list[StereoPlane]]:
    """Some images of the log, and the planes that pairs of them show."""
    count = next(topic.message_count for topic in summary.topics if topic.topic == roles.topics["image"])
    stride = max(1, count // LOOKED_AT)
    images: list[Image] = []
    planes: list[StereoPlane] = []
    for number, encoded in enumerate(recording.encoded_observations(recording.instruments[:1])):
        if number % stride:
            continue
        found = encoded.decode().found
        if isinstance(found, Rejection):
            continue
        seen: Observation = as_pinholes(found[0])
        images.append(seen.image_bgr)
        right = seen.right
        if right is not None and right.T_left_right[0, 3] > 0:
            plane = fit_plane(seen.image_bgr, right.image_bgr, seen.camera.K, float(right.T_left_right[0, 3]))
            planes += [] if plane is None else [plane]
    return images, planes


def _entry_sides(images: Sequence[Image]) -> list[str]:
    """The sides of the picture that instruments come in from in most images, from right to left."""
    segmenter = AutoSegmenter().adapted_to(images)
    sides: Counter[str] = Counter()
    for image in images:
        height_px, width_px = image.shape[:2]
        here = set()
        for one in segmenter.masks(image, None).seen or ():
            x, y = one.entry_px / [width_px, height_px] - 0.5
            here.add(("left" if x < 0 else "right") if abs(x) > abs(y) else ("above" if y < 0 else "below"))
        sides.update(here)
    found = [side for side, count in sides.items() if count >= MOST_IMAGES * len(images)]
    return sorted(found, key=("right", "left", "above", "below").index)


def _by_sides(sides: Sequence[str]) -> tuple[InstrumentDraft, ...]:
    """Instruments of which nothing but images tells; one where no image shows several."""
    entries: list[str | None] = [*sides] if len(sides) > 1 else [None]
    names = [f"PSM{number}" for number in range(1, len(entries) + 1)]
    return tuple(
        InstrumentDraft(name, None, None, f"{name}_base", name, None, entry=entry)
        for name, entry in zip(names, entries, strict=True)
    )


def _plane(planes: Sequence[StereoPlane]) -> PlaneDraft | None:
    """The middle of the planes of several images, and how they scatter."""
    if len(planes) < MIN_PLANES:
        return None
    normals = np.array([plane.normal for plane in planes])
    distances_m = np.array([plane.distance_m for plane in planes])
    normal = np.median(normals, axis=0)
    normal /= np.linalg.norm(normal)
    if normal[2] > -0.3:
        return None
    tilts_rad = np.arccos(np.clip(normals @ normal, -1.0, 1.0))
    distance_m = float(np.median(distances_m))
    surface_std_m = float(np.median([plane.surface_std_m for plane in planes]))
    spread_m = float(1.4826 * np.median(np.abs(distances_m - distance_m)))
    return PlaneDraft(
        (float(normal[0]), float(normal[1]), float(normal[2])),
        distance_m,
        max(spread_m, LEAST_PLANE_STD_M),
        max(float(1.4826 * np.median(tilts_rad)), LEAST_TILT_STD_RAD),
        max(surface_std_m, LEAST_SURFACE_STD_M),
    )


def _instrument(
    topics: InstrumentTopics, summary: RecordingSummary, path: Path, blank: Profile, count: int
) -> InstrumentDraft:
    names = summary.joint_names.get(topics.joints or "", ())
    base = _pose_frame(topics.pose, path, blank) if topics.pose else None
    frames = set(summary.frames)
    if base is None:
        known = (f"{topics.name}_base", "base") if count == 1 else (f"{topics.name}_base",)
        base = next((frame for frame in known if frame in frames), f"{topics.name}_base")
    tools = (f"{topics.name}_tool", f"{topics.name}_ee", topics.name, "tool")
    tool = next((frame for frame in tools if frame in frames and frame != base), topics.name)
    return InstrumentDraft(
        topics.name, topics.joints, topics.pose, base, tool, _chain_of(names), tuple(names)
    )


def _pose_frame(topic: str, path: Path, blank: Profile) -> str | None:
    """The frame that poses are in; None where they are in several, or in one without a name."""
    from svmdist.errors import RecordingError

    try:
        return open_recording(path, blank, topics={"pose": topic}).pose_track().frame_id or None
    except RecordingError:
        return None


def _chain_of(joint_names: Sequence[str]) -> str | None:
    """The profile that ships the longest chain whose joints are all among the log's."""
    there = set(joint_names)
    robots = {name: shipped_robot(name) for name in CHAIN_PROFILES}
    fitting = [
        name
        for name, robot in robots.items()
        if all(there & {joint.name, *joint.aliases} for joint in robot.joints)
    ]
    return max(fitting, key=lambda name: len(robots[name].joints), default=None)


def shipped_robot(name: str) -> Robot:
    """The chain of a profile that ships."""
    robot = load_profile(name).robot
    assert robot is not None
    return robot

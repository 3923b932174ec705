"""The commands and methods that a recording can serve with a profile, and what the others lack."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from svmdist.camera import are_exchanged, stereo_transform
from svmdist.errors import CalibrationError, ProfileError, RecordingError, UsageError
from svmdist.estimation.methods import METHODS, PLANAR_METHODS, REGISTRY, SPATIAL_METHODS
from svmdist.profile import DEFAULT_PROFILE, Profile
from svmdist.recording.log import Recording, open_recording
from svmdist.recording.source import sanitize_list
from svmdist.recording.summary import RecordingSummary, inspect_recording
from svmdist.recording.topics import Role
from svmdist.remote import LogPath
from svmdist.samples import Observation, Rejection
from svmdist.tracks import MAX_GAP_NS, nearest_in_words
from svmdist.vision.colour import to_grey
from svmdist.vision.tags import find_tags
from svmdist.workflows.request import LOG, Setup

IMAGES = ("image", "camera_info")
COMMANDS = {
    "calibrate": (*IMAGES, "ground_truth_tf"),
    "validate": (*IMAGES, "reference"),
    "compare": IMAGES,
    "blur-bench": (*IMAGES, "ground_truth_distance"),
    "fk": ("joints_anywhen",),
}
"""What each command but `estimate` needs: topics by role, and inputs as of a method."""
PARTS = ("fiducial", "instrument", "robot", "tissue")  # tables of a profile that methods need
PREFERRED = ("fused", "stereo", "fiducial", "shaft", "overlay", "centroid", "kinematic")
"""What `auto` is: the first of these that a log can serve. The more that a method takes, the better it is."""
LOOKED_AT = 8  # logs, of many
HEAD_S = 2.0  # of a log
TAG_IMAGES = 8  # that a tag is looked for in, spread over the log


def capabilities(summary: RecordingSummary, no_tag: str = "") -> dict[str, tuple[str, ...]]:
    """What a recording lacks for each command that reads logs, empty for nothing; `no_tag` is of `look_for_tag`."""
    methods = method_capabilities(summary, no_tag)
    found = {"estimate": () if () in methods.values() else methods[METHODS[0]]} | _lacking(summary, COMMANDS)
    if said := misfit(summary):
        found |= dict.fromkeys(("estimate", "compare"), (f"a profile of its own: it is {said}",))
    return found


def best_method(
    paths: Sequence[LogPath], profile: Profile, topics: Mapping[str, str] | None = None, *, has_lag: bool = False
) -> tuple[str, str]:
    """The best method that most of the logs can serve, of many those of some, and why it is that one, in words.

    `has_lag`: one is known or to be found. RecordingError where none can be served, or no log is one of the profile.
    """
    few = list[RecordingSummary]()
    for path in paths[:: -(-len(paths) // LOOKED_AT)]:
        with suppress(RecordingError):  # whoever measures it says so
            few.append(inspect_recording(open_recording(path, profile, topics=topics), HEAD_S))
    few = [one for one in few if set(IMAGES) <= set(one.roles)]  # of the others, too
    summaries = [one.at_any_lag() if has_lag else one for one in few if not misfit(one)]
    if not summaries:
        if few:
            raise RecordingError(f"{few[-1].recording.path}: {misfit(few[-1])}")
        return "kinematic", "no log could be looked at"
    for with_tags in (False, True):  # a tag is looked for in all of a log, and only where it matters
        each = [method_capabilities(one, look_for_tag(one.recording) if with_tags else "") for one in summaries]
        served = Counter(name for lacks in each for name in PREFERRED if not lacks[name])
        best = max(PREFERRED, key=served.__getitem__)  # the first of several
        if best != "fiducial":
            break
    above = PREFERRED[: PREFERRED.index(best)] if served[best] else PREFERRED
    why = [f"{name} lacks {'; '.join(each[0][name])}" for name in above if each[0][name]]
    if not served[best]:
        none = f"no method can measure this log with profile {profile.name}"
        raise RecordingError(f"{paths[0]}: {none}: {'. '.join(why)}")
    return best, f"the best that the log can serve{', as ' if why else ''}{', and '.join(why)}"


def method_capabilities(summary: RecordingSummary, no_tag: str = "") -> dict[str, tuple[str, ...]]:
    """The same for each method of `estimate`."""
    return _lacking(summary, {name: (*IMAGES, *method.inputs) for name, method in REGISTRY.items()}, no_tag)


def served_setups(recording: Recording, setups: Sequence[Setup]) -> tuple[Setup, ...]:
    """Those setups that a log can serve, with a remark on others; RecordingError for none, and for a `misfit`."""
    summary = inspect_recording(recording.origin.open(), HEAD_S)
    lacks = method_capabilities(summary.at_any_lag() if recording.lag is not None else summary)
    left: tuple[Setup, ...] = ()
    without = defaultdict[str, list[str]](list)  # methods by the reason
    for setup in setups:
        if setup.own is None and lacks[setup.method]:
            without[f"the log lacks {'; '.join(lacks[setup.method])}"].append(setup.method)
            continue
        try:
            setup.require_camera(recording)
            left += (setup,)
        except CalibrationError as problem:
            without[str(problem).removeprefix(f"{recording.name}: ")].append(setup.method)
    if without and (said := misfit(summary)):
        raise RecordingError(f"{summary.recording.path}: {said}")
    reasons = [f"{', '.join(methods)}: {reason}" for reason, methods in without.items()]
    if not left:
        name = recording.profile.name
        raise RecordingError(f"no method can measure this log with profile {name}: {'. '.join(reasons)}")
    for reason in reasons:
        LOG.info("note: %s: left out: %s", recording.name, reason)
    return left


def misfit(summary: RecordingSummary) -> str:
    """Why a log is none of the profile that is taken where none is given: neither made by it, nor with its joints."""
    path, profile, metadata = summary.recording.path, summary.recording.profile, summary.recording.metadata
    is_its_own = metadata.get("profile") == profile.name or ("joints" in summary.roles and not _missing_chain(summary))
    if is_its_own or profile.name != DEFAULT_PROFILE:
        return ""
    own = f"{Path(str(path)).stem}.toml"
    remedy = f"write one with `svmdist profile new {path} -o {own}` and give --profile {own}"
    return f"not a log of profile {profile.name}, the simulator's: {remedy}"


def require_clearance(setup: Setup) -> None:
    """Refuse alarms where no clearance is estimated: no alarm would ever be raised, which looks like safety."""
    if setup.method in PLANAR_METHODS:
        planar = f"{setup.method} measures in the plane: the choices are {', '.join(SPATIAL_METHODS)}"
        raise UsageError(f"alarms need a clearance; {planar}")
    if setup.profile.instrument is None:
        needs = "alarms need a clearance, which needs the instrument's sizes"
        raise ProfileError(f"profile {setup.profile.name} has no [instrument]: {needs}")


def look_for_tag(recording: Recording) -> str:
    """Look for the fiducial of the first instrument in some images: that it is in none of them, in words, or ""."""
    fiducial, settings = recording.profile.fiducial, recording.profile.settings.tag
    if fiducial is None:
        return ""
    stride = (recording.image_count() or 0) // TAG_IMAGES
    try:
        grey = (to_grey(one.image_bgr) for one in observations_of(recording, stride, left_alone=True))
        found = [fiducial.id in find_tags(image, fiducial.family, settings) for image in grey]
    except RecordingError:  # whoever measures it, or sums it up, says so
        return ""
    if not found or any(found):
        return ""
    return f"the tag {fiducial.family} {fiducial.id}: it is in none of {len(found)} images looked at"


def observations_of(recording: Recording, stride: int, *, left_alone: bool = False) -> Iterator[Observation]:
    """What the first instrument's method would see, or the left images, at each n-th image that can be decoded."""
    more = not left_alone
    for number, encoded in enumerate(recording.encoded_observations(robot=more, right=more)):
        if number % max(1, stride) == 0 and not isinstance(found := encoded.decode().found, Rejection):
            yield found[0]


def _lacking(
    summary: RecordingSummary, needs: Mapping[str, tuple[str, ...]], no_tag: str = ""
) -> dict[str, tuple[str, ...]]:
    """What of the needs of commands or methods is missing for the log's first instrument, in words."""
    profile, roles = summary.recording.profile, summary.roles
    frames, of_profile = profile.frames, f"in profile {profile.name}"

    def topics(*names: str) -> tuple[str, ...]:
        return tuple(_topic_for(role, summary) for role in names if role not in roles)

    def unless(condition: object, words: str) -> tuple[str, ...]:
        return () if condition else (words,)

    def near(apart_s: float, words: str) -> tuple[str, ...]:
        around = f"on both sides of an image, {MAX_GAP_NS * 1e-6:g} ms apart at most"
        return unless(not apart_s, f"{words} {around} ({nearest_in_words(apart_s)})")

    joints = topics("joints") + _missing_chain(summary)
    tracks = [summary.cameras.get(roles.get(role, "")) for role in ("camera_info", "right_camera_info")]
    left, right = (track.runs[0].camera if track and track.runs else None for track in tracks)
    has_baseline = left is None or right is None or stereo_transform(left, right) is not None  # or not told yet
    is_in_order = left is None or right is None or not are_exchanged(left, right)
    links = summary.transforms.links
    has_base = profile.camera_to_base or links(frames.camera, frames.base)
    has_tool = not joints or "pose" in roles or links(frames.camera, frames.tool)
    to_base = f"transforms from {frames.camera} to {frames.base}"
    lacking = {
        **{role: topics(role) for role in Role},
        **{part: unless(getattr(profile, part), f"[{part}] {of_profile}") for part in PARTS},
        "right_image": topics("right_image", "right_camera_info")
        or unless(roles["right_image"] != roles.get("image"), "a left image: it has the right")
        or unless(is_in_order, "left and right in their order: by their camera infos they are exchanged")
        or unless(has_baseline, "the distance of the cameras (`svmdist import --baseline`)"),
        "joints_anywhen": joints,
        "joints": joints or near(summary.joints_apart_s, "joint states"),
        "reference": unless(
            "ground_truth_distance" in roles or has_tool, "the tool's pose (transforms, a pose topic or joint states)"
        ),
        "calibration": unless(profile.calibration, f"a calibration {of_profile} (--calibration)"),
        "camera_to_base": unless(has_base, to_base) or near(summary.base_apart_s, to_base),
        "shaft": unless(profile.segmentation.shaft, f"[segmentation.shaft] {of_profile}"),
        "tag": unless(not no_tag, no_tag),
    }
    return {name: tuple(words for need in of for words in lacking[need]) for name, of in needs.items()}


def _topic_for(role: str, summary: RecordingSummary) -> str:
    """A topic for a role that has none, and what the log has for it."""
    found = [one for one in summary.topics if one.kind == Role[role.upper()].kind]
    if unread := [one.topic for one in found if 0 < one.message_count == one.undecodable_count]:
        return f"a topic for {role}: nothing on {sanitize_list(unread)} can be decoded"
    return f"a topic for {role}" + (" (of several: choose it with --topic)" if len(found) > 1 else "")


def _missing_chain(summary: RecordingSummary) -> tuple[str, ...]:
    profile, topic = summary.recording.profile, summary.roles.get("joints")
    if profile.robot is None:
        return (f"a [robot] in profile {profile.name}",)
    missing = profile.robot.missing_joints(summary.joint_names.get(topic, ())) if topic else ()
    return (f"the joints {', '.join(missing)} of profile {profile.name}",) if missing else ()

"""A first profile as commented TOML: what was found in the log, and what is left to measure."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator

from svmdist.profile.robot import Joint, Robot
from svmdist.vision.colour import DistinctColour
from svmdist.workflows.new_profile import InstrumentDraft, ProfileDraft, shipped_robot

WRIST = (
    '    { name = "insertion", type = "prismatic", lower = 0.0, upper = 0.24 },',
    '    { name = "roll", type = "revolute", alpha_rad = "-pi/2", theta_rad = "-pi/2" },',
    '    { name = "wrist_pitch", type = "revolute", a_m = 0.0091, alpha_rad = "pi/2", theta_rad = "-pi/2" },',
    '    { name = "wrist_yaw", type = "revolute" },',
)
ROLE_NOTES = {
    "image": "",
    "camera_info": "",
    "right_image": "  # the second camera: stereo, and fused gains",
    "right_camera_info": "",
    "joints": "",
    "pose": "",
    "tf": "",
}


def profile_lines(draft: ProfileDraft) -> Iterator[str]:
    """The profile, line by line."""
    first = draft.instruments[0]
    yield f"# A first profile for {_plain(draft.log)}, by `svmdist profile new`. Lines that end in MEASURE are guesses."
    yield "# Every key: docs/profile.md. Check it by svmdist info LOG --profile THIS and svmdist show LOG --masks"
    yield f"name = {_text(draft.name)}"
    if first.name != "PSM1" or len(draft.instruments) > 1:
        yield f"instrument_name = {_text(first.name)}"
    if first.entry is not None:
        yield f'entry = "{first.entry}"              # the side of the picture that it comes in from; names are guesses'
    yield ""
    yield from _topics(draft, first)
    yield ""
    yield "[frames]"
    yield f"camera = {_text(draft.camera_frame)}"
    yield f"base = {_text(first.base)}"
    yield f"tool = {_text(first.tool)}"
    if not draft.has_camera_to_base:
        yield "# No transform leads from camera to base: svmdist hand-eye finds it from the seen tool."
    yield ""
    yield from _segmentation(draft)
    yield ""
    yield from _instrument()
    yield ""
    yield from _robot(first)
    yield ""
    yield from _deviations()
    yield ""
    yield from _tissue(draft)
    for other in draft.instruments[1:]:
        yield ""
        yield from _other(other, first)


def _topics(draft: ProfileDraft, first: InstrumentDraft) -> Iterator[str]:
    yield "[topics]"
    topics = {
        **draft.topics,
        **{role: topic for role, topic in (("joints", first.joints), ("pose", first.pose)) if topic},
    }
    for role, note in ROLE_NOTES.items():
        if role in topics:
            yield f"{role} = {_text(topics[role])}{note}"
    if draft.other_images:
        yield f"# Other topics with images: {_plain(', '.join(draft.other_images))}"


def _segmentation(draft: ProfileDraft) -> Iterator[str]:
    yield "[segmentation]"
    yield 'method = "auto"              # instruments by their straight edges, whatever their colour'
    if draft.mark is None:
        return
    yield ""
    yield from _mark_note(draft.mark, draft.image_count)
    yield "# By colours, in place of [segmentation] above; look at the masks and correct tissue and shaft:"
    yield from (f"# {line}".rstrip() for line in _by_colour(draft.mark, draft.size_px))


def _by_colour(mark: DistinctColour, size_px: tuple[int, int]) -> Iterator[str]:
    pixels = size_px[0] * size_px[1]
    yield "[segmentation.tissue]        # red and pink; OpenCV's HSV, a hue that wraps around 0"
    yield "hue = [165, 15]"
    yield "saturation = [70, 255]"
    yield "value = [60, 255]"
    yield f"min_area_px = {max(50, pixels // 450)}"
    yield 'occlusion = "outline"'
    yield ""
    yield "[segmentation.instrument]    # the distal marker"
    yield from _box(mark)
    yield ""
    yield "[segmentation.shaft]         # dark, whatever its hue"
    yield "hue = [0, 179]"
    yield "value = [0, 70]"
    yield f"min_area_px = {max(50, pixels // 600)}"


def _mark_note(mark: DistinctColour, image_count: int) -> Iterator[str]:
    low, high = mark.hue
    yield f"# In {image_count} images a part of {mark.area_px:.0f} px has a colour of its own, of hue {low} to {high}."
    yield "# If it is a ring or cap about the jaws' joint, its middle gives the tool's place better than the outline."


def _box(mark: DistinctColour) -> Iterator[str]:
    yield f"hue = [{mark.hue[0]}, {mark.hue[1]}]"
    yield f"saturation = [{mark.saturation[0]}, {mark.saturation[1]}]"
    yield f"value = [{mark.value[0]}, {mark.value[1]}]"
    yield f"min_area_px = {max(5, round(mark.area_px / 8))}"


def _instrument() -> Iterator[str]:
    yield "[instrument]                 # a da Vinci instrument of 8 mm; half of each diameter, by a calliper"
    yield "shaft_radius_m = 0.004       # 1 % of it is 1 % of the depth; 0.0025 for a 5 mm instrument"
    yield "shaft_radius_std_fraction = 0.02"
    yield "shaft_length_m = 0.28"
    yield "shaft_end_m = 0.0063         # from the wrist's hinge back to where the shaft visibly ends"
    yield "wrist_radius_m = 0.0027"
    yield "knuckle_radius_m = 0.00175   # the jaws' joint"
    yield "jaw_length_m = 0.008"
    yield "jaw_radius_m = 0.0009"


def _robot(instrument: InstrumentDraft) -> Iterator[str]:
    yield from _chain("[robot]", instrument)


def _chain(table: str, instrument: InstrumentDraft) -> Iterator[str]:
    if instrument.chain is None:
        if instrument.joint_names:
            there = _plain(", ".join(instrument.joint_names))
            yield f"# No chain that ships has the log's joints ({there}):"
            yield "# put your robot's DH rows here. These are the instrument's last joints, for shaft and stereo."
        else:
            yield "# The log has no joints: the instrument's last ones are enough for shaft and stereo."
        yield table
        yield "joints = ["
        yield from WRIST
        yield "]"
        return
    robot = shipped_robot(instrument.chain)
    yield f"{table}  # the chain of {instrument.chain}"
    yield f'convention = "{robot.convention}"'
    yield "joints = ["
    yield from (f"    {_joint(joint)}," for joint in robot.joints)
    yield "]"
    yield from _tool_rotation(robot)


def _tool_rotation(robot: Robot) -> Iterator[str]:
    if robot.tool_rotation is not None:
        rows = ", ".join("[" + ", ".join(f"{value:g}" for value in row) + "]" for row in robot.tool_rotation)
        yield f"tool_rotation = [{rows}]"


def _joint(joint: Joint) -> str:
    parts = [f"name = {_text(joint.name)}", f'type = "{joint.type}"']
    parts += [f"{key} = {getattr(joint, key):g}" for key in ("a_m", "d_m") if getattr(joint, key)]
    angles = ("alpha_rad", "theta_rad")
    parts += [f"{key} = {_angle(getattr(joint, key))}" for key in angles if getattr(joint, key)]
    limits = ("lower", "upper")
    parts += [f"{key} = {_angle(getattr(joint, key))}" for key in limits if key in joint.model_fields_set]
    if joint.aliases:
        parts.append(f"aliases = [{', '.join(map(_text, joint.aliases))}]")
    return "{ " + ", ".join(parts) + " }"


def _deviations() -> Iterator[str]:
    yield "[kinematic_error]            # how wrong joints and camera-to-base may be: fused and kinematic follow them"
    yield 'joint_std_rad = "pi/180"'
    yield "joint_std_m = 1e-3"
    yield 'camera_base_std_rad = "pi/90"'
    yield "camera_base_std_m = 5e-3     # hand-eye gives what it found"
    yield "time_offset_std_s = 0.05     # of the joints' stamps against those of the images"
    yield ""
    yield "[camera_error]               # how wrong the calibration may be"
    yield "focal_std_fraction = 4e-3"
    yield "centre_std_px = 1.5"
    yield "baseline_std_fraction = 0.01"


def _tissue(draft: ProfileDraft) -> Iterator[str]:
    plane = draft.plane
    if plane is None:
        yield "# The plane that the tissue lies on, in the camera's frame: n . p = -distance, n towards the camera."
        yield "# One camera does not show it: measure it with a chessboard laid there (docs/guide.md)."
        yield "[tissue]"
        yield "plane_normal = [0.0, 0.0, -1.0]"
        yield "plane_distance_m = 0.1       # MEASURE"
        yield "plane_distance_std_m = 0.03  # MEASURE"
        yield "plane_tilt_std_rad = 0.35    # MEASURE"
        yield "surface_std_m = 3e-3         # how far the tissue stands off that plane: MEASURE"
        return
    yield "# The plane that the tissue lies on, n . p = -distance, as both views show most of the scene."
    yield "[tissue]"
    yield f"plane_normal = [{', '.join(f'{value:.4f}' for value in plane.normal)}]"
    yield f"plane_distance_m = {plane.distance_m:.4f}"
    yield f"plane_distance_std_m = {plane.distance_std_m:.2g}"
    yield f"plane_tilt_std_rad = {plane.tilt_std_rad:.2g}"
    yield f"surface_std_m = {plane.surface_std_m:.2g}"


def _other(other: InstrumentDraft, first: InstrumentDraft) -> Iterator[str]:
    yield "[[other_instruments]]"
    yield f"name = {_text(other.name)}"
    if other.entry is not None:
        yield f'entry = "{other.entry}"'
        return
    yield ""
    yield "[other_instruments.topics]"
    for role, topic in (("joints", other.joints), ("pose", other.pose)):
        if topic:
            yield f"{role} = {_text(topic)}"
    yield ""
    yield "[other_instruments.frames]"
    yield f"base = {_text(other.base)}"
    yield f"tool = {_text(other.tool)}"
    if other.chain != first.chain:
        yield ""
        yield from _chain("[other_instruments.robot]", other)


def _angle(value: float) -> str:
    """An angle as a multiple of pi where it is one."""
    for divisor in (1, 2, 3, 4, 6):
        times = value * divisor / math.pi
        if times and abs(times - round(times)) < 1e-9 and abs(round(times)) == 1:
            sign = "-" if times < 0 else ""
            return f'"{sign}pi"' if divisor == 1 else f'"{sign}pi/{divisor}"'
    return f"{value:g}"


def _text(text: str) -> str:
    """A TOML string."""
    return json.dumps(text).replace("\x7f", "\\u007f")


def _plain(text: str) -> str:
    """Text of a log in a comment: no control character may end the line."""
    return "".join(character if character.isprintable() else "?" for character in text)

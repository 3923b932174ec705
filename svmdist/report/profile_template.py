"""A first profile as commented TOML: what was found in the log, and what is left to measure."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator

from svmdist.profile.robot import Joint
from svmdist.vision.colour import DistinctColour
from svmdist.workflows.new_profile import InstrumentDraft, ProfileDraft, shipped_robot

WRIST = """joints = [
    { name = "insertion", type = "prismatic", lower = 0.0, upper = 0.24 },
    { name = "roll", type = "revolute", alpha_rad = "-pi/2", theta_rad = "-pi/2" },
    { name = "wrist_pitch", type = "revolute", a_m = 0.0091, alpha_rad = "pi/2", theta_rad = "-pi/2" },
    { name = "wrist_yaw", type = "revolute" },
]"""
STATED = """
[instrument]                 # a da Vinci instrument of 8 mm; half of each diameter, by a calliper
shaft_radius_m = 0.004       # 1 % of it is 1 % of the depth; 0.0025 for a 5 mm instrument
shaft_radius_std_fraction = 0.02
shaft_length_m = 0.28
shaft_end_m = 0.0063         # from the wrist's hinge back to where the shaft visibly ends
wrist_radius_m = 0.0027
knuckle_radius_m = 0.00175   # the jaws' joint
jaw_length_m = 0.008
jaw_radius_m = 0.0009
"""
DEVIATIONS = """
[kinematic_error]            # how wrong joints and camera-to-base may be: fused and kinematic follow them
joint_std_rad = "pi/180"
joint_std_m = 1e-3
camera_base_std_rad = "pi/90"
camera_base_std_m = 5e-3     # hand-eye gives what it found
time_offset_std_s = 0.05     # of the joints' stamps against those of the images

[camera_error]               # how wrong the calibration may be
focal_std_fraction = 4e-3
centre_std_px = 1.5
baseline_std_fraction = 0.01
"""
UNKNOWN_PLANE = """# The plane that the tissue lies on, in the camera's frame: n . p = -distance, n towards the camera.
# One camera does not show it: measure it with a chessboard laid there (docs/guide.md).
[tissue]
plane_normal = [0.0, 0.0, -1.0]
plane_distance_m = 0.1       # MEASURE
plane_distance_std_m = 0.03  # MEASURE
plane_tilt_std_rad = 0.35    # MEASURE
surface_std_m = 3e-3         # how far the tissue stands off that plane: MEASURE"""
ROLES = ("image", "camera_info", "right_image", "right_camera_info", "joints", "pose", "tf")


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
    yield "\n[topics]"
    topics = {**draft.topics, **_topics(first)}
    for role in ROLES:
        if role in topics:
            note = "  # the second camera: stereo, and fused gains" if role == "right_image" else ""
            yield f"{role} = {_text(topics[role])}{note}"
    if draft.other_images:
        yield f"# Other topics with images: {_plain(', '.join(draft.other_images))}"
    yield "\n[frames]"
    yield f"camera = {_text(draft.camera_frame)}"
    yield f"base = {_text(first.base)}\ntool = {_text(first.tool)}"
    if not draft.has_camera_to_base:
        yield "# No transform leads from camera to base: svmdist hand-eye finds it from the seen tool."
    yield "\n[segmentation]"
    yield 'method = "auto"              # instruments by their straight edges, whatever their colour'
    if draft.mark is not None:
        yield from _by_colour(draft.mark, draft)
    yield STATED
    yield from _chain("[robot]", first)
    yield DEVIATIONS
    plane = draft.plane
    if plane is None:
        yield UNKNOWN_PLANE
    else:
        yield "# The plane that the tissue lies on, n . p = -distance, as both views show most of the scene.\n[tissue]"
        yield f"plane_normal = [{', '.join(f'{value:.4f}' for value in plane.normal)}]"
        yield f"plane_distance_m = {plane.distance_m:.4f}"
        for key in ("distance_std_m", "tilt_std_rad"):
            yield f"plane_{key} = {getattr(plane, key):.2g}"
        yield f"surface_std_m = {plane.surface_std_m:.2g}"
    for other in draft.instruments[1:]:
        yield from _other(other, first)


def _topics(instrument: InstrumentDraft) -> dict[str, str]:
    found = (("joints", instrument.joints), ("pose", instrument.pose))
    return {role: topic for role, topic in found if topic}


def _by_colour(mark: DistinctColour, draft: ProfileDraft) -> Iterator[str]:
    pixels = draft.size_px[0] * draft.size_px[1]
    low, high = mark.hue
    lines = f"""
In {draft.image_count} images a part of {mark.area_px:.0f} px has a colour of its own, of hue {low} to {high}.
If it is a ring or cap about the jaws' joint, its middle gives the tool's place better than the outline.
By colours, in place of [segmentation] above; look at the masks and correct tissue and shaft:
[segmentation.tissue]        # red and pink; OpenCV's HSV, a hue that wraps around 0
hue = [165, 15]
saturation = [70, 255]
value = [60, 255]
min_area_px = {max(50, pixels // 450)}
occlusion = "outline"

[segmentation.instrument]    # the distal marker
hue = {list(mark.hue)}
saturation = {list(mark.saturation)}
value = {list(mark.value)}
min_area_px = {max(5, round(mark.area_px / 8))}

[segmentation.shaft]         # dark, whatever its hue
hue = [0, 179]
value = [0, 70]
min_area_px = {max(50, pixels // 600)}"""
    first, *rest = lines.splitlines()
    yield first
    yield from (f"# {line}".rstrip() for line in rest)


def _chain(table: str, instrument: InstrumentDraft) -> Iterator[str]:
    if instrument.chain is None:
        if instrument.joint_names:
            there = _plain(", ".join(instrument.joint_names))
            yield f"# No chain that ships has the log's joints ({there}):"
            yield "# put your robot's DH rows here. These are the instrument's last joints, for shaft and stereo."
        else:
            yield "# The log has no joints: the instrument's last ones are enough for shaft and stereo."
        yield f"{table}\n{WRIST}"
        return
    robot = shipped_robot(instrument.chain)
    yield f"{table}  # the chain of {instrument.chain}"
    yield f'convention = "{robot.convention}"'
    yield "joints = ["
    yield from (f"    {_joint(joint)}," for joint in robot.joints)
    yield "]"
    if robot.tool_rotation is not None:
        rows = ", ".join("[" + ", ".join(f"{value:g}" for value in row) + "]" for row in robot.tool_rotation)
        yield f"tool_rotation = [{rows}]"


def _joint(joint: Joint) -> str:
    parts = [f"name = {_text(joint.name)}", f'type = "{joint.type}"']
    parts += [f"{key} = {getattr(joint, key):g}" for key in ("a_m", "d_m") if getattr(joint, key)]
    for key in ("alpha_rad", "theta_rad", "lower", "upper"):
        if key in joint.model_fields_set if key in ("lower", "upper") else getattr(joint, key):
            parts.append(f"{key} = {_angle(getattr(joint, key))}")
    if joint.aliases:
        parts.append(f"aliases = [{', '.join(map(_text, joint.aliases))}]")
    return "{ " + ", ".join(parts) + " }"


def _other(other: InstrumentDraft, first: InstrumentDraft) -> Iterator[str]:
    yield f"\n[[other_instruments]]\nname = {_text(other.name)}"
    if other.entry is not None:
        yield f'entry = "{other.entry}"'
        return
    yield "\n[other_instruments.topics]"
    yield from (f"{role} = {_text(topic)}" for role, topic in _topics(other).items())
    yield f"\n[other_instruments.frames]\nbase = {_text(other.base)}\ntool = {_text(other.tool)}"
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
    return json.dumps(text).replace("\x7f", "\\u007f")


def _plain(text: str) -> str:
    """Text of a log in a comment: no control character may end the line."""
    return "".join(character if character.isprintable() else "?" for character in text)

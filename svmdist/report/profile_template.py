"""A first profile as commented TOML: what was found in the log, and what is left to measure."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from importlib.resources import files
from typing import Any

from svmdist.errors import UsageError, did_you_mean
from svmdist.estimation.instrument.shaft import ShaftSizes
from svmdist.profile import Topics
from svmdist.profile.robot import Instrument, Joint
from svmdist.workflows.new_profile import InstrumentDraft, ProfileDraft, shipped_robot

NOTES = {"right_image": "  # the second camera: stereo, and fused gains"}


def instrument_table() -> dict[str, Any]:
    """What is known of common instruments, by name."""
    return tomllib.loads(files("svmdist.report").joinpath("instruments.toml").read_text("utf-8"))


def instrument_sizes(name: str) -> dict[str, Any]:
    """The sizes of an instrument by their keys in the table; raises UsageError for one that is not in it."""
    if name not in (table := instrument_table()):
        raise UsageError(f"no instrument named {name}: {did_you_mean(name, list(table))}")
    return dict(table[name])


def _with_guesses(sizes: dict[str, Any]) -> dict[str, Any]:
    """The sizes of the table and all others of the template.

    What no source gives follows from the shaft's radius, as in a da Vinci instrument of 8 mm: drawings and images put
    the shaft's visible end 1.6 to 2.3 radii behind the hinge.
    """
    radius_m = sizes["shaft_radius_m"]
    found = {
        **sizes,
        # Of real ones the dark part ended 0.5 (thrust) to 2 radii (SuPer Deep) before the hinge.
        "shaft_end_m": 1.25 * radius_m,
        "shaft_end_std_m": 0.75 * radius_m,
        "wrist_radius_m": 0.68 * radius_m,
        "knuckle_radius_m": 0.44 * radius_m,
        "jaw_radius_m": 0.22 * radius_m,
    }
    shaft = ShaftSizes(Instrument.model_construct(**found), 0.0)
    return found | {"outline_end_m": shaft.outline_end_m, "outline_end_std_m": shaft.outline_end_std_m}


def profile_text(draft: ProfileDraft) -> str:
    """The profile."""
    sizes = instrument_sizes(draft.instrument)
    first, *others = draft.instruments
    is_named = first.name != "PSM1" or bool(others)
    identity = _entries({"name": draft.name, **({"instrument_name": first.name} if is_named else {})})
    if first.entry is not None:
        note = "the side of the picture that it comes in from; names are guesses"
        identity.append(f'entry = "{first.entry}"              # {note}')
    by_role = {**draft.topics, **first.topics}
    roles = [role for role in Topics.model_fields if role in by_role]
    topics = [f"{role} = {_text(by_role[role])}{NOTES.get(role, '')}" for role in roles]
    if draft.other_images:
        topics.append(f"# Other topics with images: {_plain(', '.join(draft.other_images))}")
    frames = _entries({"camera": draft.camera_frame, "base": first.base, "tool": first.tool})
    if not draft.has_camera_to_base:
        frames.append("# No transform leads from camera to base: svmdist hand-eye finds it by the seen tool.")
    colour = ""
    if draft.mark is not None:
        pixels = draft.size_px[0] * draft.size_px[1]
        areas_px = {"tissue_px": max(50, pixels // 450), "shaft_px": max(50, pixels // 600)}
        colour = _block("colour", draft=draft, marker_px=max(5, round(draft.mark.area_px / 8)), **areas_px)
    robot = _chain("[robot]", first, sizes)
    of_others = ["", *(line for other in others for line in _other(other, first, sizes)), ""]
    parts = {"identity": identity, "topics": topics, "frames": frames, "robot": robot, "others": of_others}
    texts = {name: "\n".join(lines) for name, lines in parts.items()}
    tissue = _block("surface" if draft.plane else "unknown_plane", draft=draft)
    text = _block("profile", log=_plain(draft.log), colour=colour, sizes=_with_guesses(sizes), tissue=tissue, **texts)
    return re.sub(r'(?m)^(\w+ = (?:-?[\d.e-]+|"-?pi/\d+")) # ', lambda line: f"{line[1]:<28} # ", text)


def _block(name: str, **values: object) -> str:
    text = files("svmdist.report").joinpath("profile_template.toml").read_text("utf-8")
    blocks = dict(block.split("\n", 1) for block in text.split("#: ")[1:])
    return blocks[name].removesuffix("\n").format(**values)


def _entries(values: Mapping[str, str]) -> list[str]:
    return [f"{key} = {_text(value)}" for key, value in values.items()]


def _chain(table: str, instrument: InstrumentDraft, sizes: dict[str, Any]) -> Iterator[str]:
    if instrument.chain is None:
        if instrument.joint_names:
            yield f"# No chain that ships has the log's joints ({_plain(', '.join(instrument.joint_names))}):"
            yield "# put your robot's DH rows here. These are the instrument's last joints, for shaft and stereo."
        else:
            yield "# The log has no joints: the instrument's last ones are enough for shaft and stereo."
        yield f"{table}\n{_block('wrist', sizes=sizes)}"
        return
    robot = shipped_robot(instrument.chain)
    yield f"{table}  # the chain of {instrument.chain}"
    yield f'convention = "{robot.convention}"'
    yield "joints = ["
    insertion = max(place for place, joint in enumerate(robot.joints) if joint.type == "prismatic")
    for place, joint in enumerate(robot.joints):
        own = {"a_m": sizes["wrist_length_m"]} if place > insertion and joint.a_m != 0.0 else {}
        yield f"    {_joint(joint.model_copy(update=own))},"
    yield "]"
    if robot.tool_rotation is not None:
        rows = ", ".join("[" + ", ".join(f"{value:g}" for value in row) + "]" for row in robot.tool_rotation)
        yield f"tool_rotation = [{rows}]"


def _joint(joint: Joint) -> str:
    parts = [f"name = {_text(joint.name)}", f'type = "{joint.type}"']
    parts += [f"{key} = {getattr(joint, key):g}" for key in ("a_m", "d_m") if getattr(joint, key)]
    angles = [key for key in ("alpha_rad", "theta_rad") if getattr(joint, key)]
    limits = [key for key in ("lower", "upper") if key in joint.model_fields_set]
    parts += [f"{key} = {_angle(getattr(joint, key))}" for key in (*angles, *limits)]
    if joint.aliases:
        parts.append(f"aliases = [{', '.join(map(_text, joint.aliases))}]")
    return "{ " + ", ".join(parts) + " }"


def _other(other: InstrumentDraft, first: InstrumentDraft, sizes: dict[str, Any]) -> Iterator[str]:
    yield from ("", "[[other_instruments]]", *_entries({"name": other.name}))
    if other.entry is not None:
        yield f'entry = "{other.entry}"'
        return
    yield from ("", "[other_instruments.topics]", *_entries(other.topics))
    yield from ("", "[other_instruments.frames]", *_entries({"base": other.base, "tool": other.tool}))
    if other.chain != first.chain:
        yield ""
        yield from _chain("[other_instruments.robot]", other, sizes)


def _angle(value: float) -> str:
    """An angle as a multiple of pi where it is one."""
    for divisor in (1, 2, 3, 4, 6):
        if math.isclose(abs(value) * divisor, math.pi):
            return f'"{"-" if value < 0 else ""}pi{f"/{divisor}" if divisor > 1 else ""}"'
    return f"{value:g}"


def _text(text: str) -> str:
    return json.dumps(text).replace("\x7f", "\\u007f")


def _plain(text: str) -> str:
    """Text of a log in a comment: no control character may end the line."""
    return "".join(character if character.isprintable() else "?" for character in text)

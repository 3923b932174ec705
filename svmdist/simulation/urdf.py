"""URDF generated from a DH chain, so that the table in the profile is the one source of truth.

URDF moves a joint at the child's origin; standard DH moves first and then walks along the link. Each row
therefore becomes a moving joint to a link `<name>_axis` and a fixed one to the link `<name>`, whose frame
is the row's DH frame. A fixed link `tool` closes the chain.
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from svmdist.kinematics.dh import DHChain, DHRow, link_transforms
from svmdist.transforms import Array

BASE_LINK = "base_link"


@dataclass(frozen=True)
class LinkVisual:
    """A mesh file to draw in the frame of a DH row's link, with its colour (red, green, blue, alpha; 0–1)."""

    link: str
    mesh_file: str
    colour_rgba: tuple[float, float, float, float]


def urdf_of(chain: DHChain, name: str, visuals: tuple[LinkVisual, ...] = (), tool_link: str = "tool") -> str:
    """Write the chain as URDF; numbers carry 17 digits, so that none is lost on the way."""
    robot = ElementTree.Element("robot", name=name)
    _link(robot, BASE_LINK)
    parent = BASE_LINK
    for row in chain.rows:
        fixed = link_transforms(DHChain((row,), chain.convention), _zero(row))[0]
        moves_first = chain.convention == "standard"
        _link(robot, f"{row.name}_axis")
        _joint(robot, row.name, parent, f"{row.name}_axis", np.eye(4) if moves_first else fixed, row)
        _link(robot, row.name)
        _joint(robot, f"{row.name}_fixed", f"{row.name}_axis", row.name, fixed if moves_first else np.eye(4))
        parent = row.name
    # One visual to a link, so that every part keeps its own colour.
    for index, visual in enumerate(visuals):
        part = part_link(visual.link, index)
        _visual(_link(robot, part), visual, part)
        _joint(robot, f"{part}_fixed", visual.link, part, np.eye(4))
    _link(robot, tool_link)
    _joint(robot, f"{tool_link}_fixed", parent, tool_link, chain.T_last_tool)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode")


def part_link(link: str, index: int) -> str:
    """The name of the link that draws visual number `index`, which is on another link."""
    return f"{link}_part_{index}"


def _zero(row: DHRow) -> Array:
    return np.zeros(0 if row.joint == "fixed" else 1)


def _link(robot: ElementTree.Element, name: str) -> ElementTree.Element:
    link = ElementTree.SubElement(robot, "link", name=name)
    # Bullet wants a mass; the robot is moved by its joint positions, never by forces.
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "mass", value="1")
    ElementTree.SubElement(inertial, "inertia", ixx="1", ixy="0", ixz="0", iyy="1", iyz="0", izz="1")
    return link


def _joint(
    robot: ElementTree.Element, name: str, parent: str, child: str, T: Array, row: DHRow | None = None
) -> None:
    kind = row.joint if row is not None else "fixed"
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=_numbers(T[:3, 3]), rpy=_numbers(_rpy(T[:3, :3])))
    if row is not None and kind != "fixed":
        ElementTree.SubElement(joint, "axis", xyz="0 0 1")
        ElementTree.SubElement(
            joint, "limit", lower=f"{row.lower:.17g}", upper=f"{row.upper:.17g}", effort="1", velocity="1"
        )


def _visual(link: ElementTree.Element, visual: LinkVisual, name: str) -> None:
    element = ElementTree.SubElement(link, "visual")
    geometry = ElementTree.SubElement(element, "geometry")
    ElementTree.SubElement(geometry, "mesh", filename=visual.mesh_file)
    material = ElementTree.SubElement(element, "material", name=name)
    ElementTree.SubElement(material, "color", rgba=_numbers(np.array(visual.colour_rgba)))


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.17g}" for value in values)


def _rpy(R: Array) -> Array:
    """URDF's roll, pitch, yaw in rad: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    pitch = np.arctan2(-R[2, 0], np.hypot(R[2, 1], R[2, 2]))
    if np.hypot(R[2, 1], R[2, 2]) > 1e-12:
        return np.array([np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])
    # Gimbal lock: roll and yaw turn about the same axis, so roll may be zero.
    return np.array([0.0, pitch, np.arctan2(-R[0, 1], R[1, 1])])

"""The constants that a profile states with a deviation, by their names in estimators and hand-eye files."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from svmdist.profile import Profile

FOCAL_LENGTH, PRINCIPAL_POINT, BASELINE = "focal length", "principal point", "baseline"
SHAFT_RADIUS, TAG_SIZE, TIME_OFFSET = "shaft radius", "tag size", "time offset"


def offset_of(joint: str) -> str:
    """The name of a joint's constant offset."""
    return f"offset of {joint}"


def length_of(index: int) -> str:
    """The name of a chain's length, counted from 0 in the order of its rows."""
    return f"length {index + 1}"


def stated_deviations(profile: Profile) -> dict[str, float]:
    """Deviations in m, rad, s, px, or fractions of the constant itself."""
    camera, kinematic = profile.camera_error, profile.kinematic_error
    found = {
        FOCAL_LENGTH: camera.focal_std_fraction,
        PRINCIPAL_POINT: camera.centre_std_px,
        BASELINE: camera.baseline_std_fraction,
        TIME_OFFSET: kinematic.time_offset_std_s,
    }
    if profile.instrument is not None:
        found[SHAFT_RADIUS] = profile.instrument.shaft_radius_std_fraction
    if profile.fiducial is not None:
        found[TAG_SIZE] = profile.fiducial.size_std_fraction
    joints = () if profile.robot is None else profile.robot.joints
    for index, joint in enumerate(joints):
        slides = joint.type == "prismatic"
        found[offset_of(joint.name)] = kinematic.joint_std_m if slides else kinematic.joint_std_rad
        # A row has two lengths at most.
        found |= {length_of(place): kinematic.length_std_m for place in (2 * index, 2 * index + 1)}
    return found

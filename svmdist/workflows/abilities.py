"""Which commands a recording can serve with a profile, and what it lacks for the others."""

from __future__ import annotations

from dataclasses import dataclass

from svmdist.profile import Profile
from svmdist.recording.inspect import RecordingSummary


@dataclass(frozen=True, slots=True)
class Ability:
    """One command, and what is missing for it; nothing missing means that it can be served."""

    command: str
    missing: tuple[str, ...]

    @property
    def served(self) -> bool:
        """Whether the command can be served."""
        return not self.missing


def abilities(summary: RecordingSummary, profile: Profile) -> tuple[Ability, ...]:
    """Tell for each command that reads recordings what this one lacks."""
    images = _lacking(summary, "image", "camera_info")
    return (
        Ability("estimate", images),
        Ability("calibrate", images + _lacking(summary, "ground_truth_tf")),
        Ability("validate", images + _reference_lacking(summary, profile)),
        Ability("compare", images + _lacking(summary, "ground_truth_distance")),
        Ability("blur-bench", images + _lacking(summary, "ground_truth_distance")),
        Ability("fk", _lacking(summary, "joints") + _chain_lacking(summary, profile)),
    )


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

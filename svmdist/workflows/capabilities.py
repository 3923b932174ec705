"""The commands and methods that a recording can serve with a profile, and what the others lack."""

from __future__ import annotations

from dataclasses import dataclass

from svmdist.estimation.methods import METHODS
from svmdist.profile import Profile
from svmdist.recording.inspect import RecordingSummary


@dataclass(frozen=True, slots=True)
class Capability:
    """A command or method, and what is missing for it. Where nothing is missing, it can be served."""

    name: str
    missing: tuple[str, ...]

    @property
    def served(self) -> bool:
        """Whether it can be served."""
        return not self.missing


def capabilities(summary: RecordingSummary, profile: Profile) -> tuple[Capability, ...]:
    """Tell for each command that reads recordings what this one lacks."""
    images = _lacking(summary, "image", "camera_info")
    return (
        Capability("estimate", images),
        Capability("calibrate", images + _lacking(summary, "ground_truth_tf")),
        Capability("validate", images + _reference_lacking(summary, profile)),
        Capability("compare", images + _lacking(summary, "ground_truth_distance")),
        Capability("blur-bench", images + _lacking(summary, "ground_truth_distance")),
        Capability("fk", _lacking(summary, "joints") + _chain_lacking(summary, profile)),
    )


def method_capabilities(summary: RecordingSummary, profile: Profile) -> tuple[Capability, ...]:
    """Tell for each method of `estimate` what log and profile lack."""
    images = _lacking(summary, "image", "camera_info")
    joints = _lacking(summary, "joints") + _chain_lacking(summary, profile)
    kinematics = joints + _camera_transform_lacking(summary, profile)
    in_3d = _parts_lacking(profile, "robot", "tissue")
    shaft = () if profile.segmentation.shaft else (f"[segmentation.shaft] in profile {profile.name}",)
    calibration = () if profile.calibration else (f"a calibration in profile {profile.name} (--calibration)",)
    needs = {
        "overlay": calibration,
        "centroid": calibration,
        "fiducial": joints + _parts_lacking(profile, "fiducial", "tissue"),
        "shaft": shaft + _parts_lacking(profile, "instrument") + in_3d,
        "stereo": _lacking(summary, "right_image", "right_camera_info") + in_3d,
        "kinematic": kinematics + _parts_lacking(profile, "tissue"),
        "fused": kinematics + _parts_lacking(profile, "tissue"),
    }
    return tuple(Capability(method, images + needs.get(method, ())) for method in METHODS)


def _parts_lacking(profile: Profile, *tables: str) -> tuple[str, ...]:
    return tuple(
        f"[{table}] in profile {profile.name}" for table in tables if getattr(profile, table) is None
    )


def _camera_transform_lacking(summary: RecordingSummary, profile: Profile) -> tuple[str, ...]:
    frames = profile.frames
    if {frames.camera, frames.base} <= set(summary.frames):
        return ()
    return (f"transforms from {frames.camera} to {frames.base}",)


def instruments_in(summary: RecordingSummary, profile: Profile) -> tuple[str, ...]:
    """Names of the instruments that the log has: the profile's own, and the others whose joints or pose it has."""
    topics = {topic.topic for topic in summary.topics}
    return (
        profile.instrument_name,
        *(other.name for other in profile.other_instruments if other.is_in(topics)),
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

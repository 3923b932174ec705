"""What a recording can serve: the more it and the profile have, the more, and what lacks is named."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from svmdist.errors import RecordingError
from svmdist.estimation.methods import METHODS
from svmdist.profile import Profile, load_profile
from svmdist.recording.contents import Contents, TransformTree
from svmdist.recording.log import Recording
from svmdist.recording.summary import RecordingSummary, TopicSummary
from svmdist.recording.topics import Role
from svmdist.workflows.capabilities import best_method, capabilities, method_capabilities
from tests.shipped import PROFILE

JOINTS = tuple(joint.name for joint in PROFILE.robot.joints)
FRAMES = PROFILE.frames


def topic(name: str) -> TopicSummary:
    """A topic of which only the name matters."""
    return TopicSummary(name, "", "", None, 1, None, None, None, 0.0, 0, 0, 0)


def read_by(profile: Profile) -> Recording:
    """A recording of which only the name and the profile matter."""
    return cast(Recording, SimpleNamespace(path=Path("a.mcap"), metadata={}, profile=profile))


def linking(*frames: str) -> TransformTree:
    """Transforms from the camera to each of the frames."""
    contents = Contents()
    for frame in frames:
        contents["/tf"][FRAMES.camera, frame].add(0, [0.0] * 6 + [1.0])
    return TransformTree(contents, {"/tf": False})


FULL = RecordingSummary(
    recording=read_by(PROFILE),
    duration_s=1.0,
    topics=(topic("/PSM1/measured_js"), topic("/image")),
    roles={str(role): f"/{role}" for role in Role},
    cameras={},
    frames=(FRAMES.base, FRAMES.camera, FRAMES.tissue, FRAMES.tool),
    joint_names={f"/{Role.JOINTS}": JOINTS},
    transforms=linking(FRAMES.base, FRAMES.tissue, FRAMES.tool),
)
"""A recording that has everything."""


def without(*roles: str, transforms: TransformTree = FULL.transforms) -> RecordingSummary:
    """The recording without the topics of some roles."""
    kept = {role: name for role, name in FULL.roles.items() if role not in roles}
    return replace(FULL, roles=kept, transforms=transforms)


def lacking(found: dict[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """What each lacks that cannot be served."""
    return {name: missing for name, missing in found.items() if missing}


def test_a_recording_that_has_everything_serves_everything():
    """Every method is listed, in order; those that need a calibration of the profile find it."""
    assert lacking(capabilities(FULL)) == {}
    assert tuple(method_capabilities(FULL)) == tuple(METHODS)
    assert lacking(method_capabilities(FULL)) == {}
    late = replace(FULL, joints_apart_s=30.0, base_apart_s=30.0)
    assert lacking(method_capabilities(late.at_any_lag())) == {}


def poorer(table: str) -> Profile:
    return PROFILE.model_copy(update={table: None})


IN_3D = {"fiducial", "shaft", "stereo", "kinematic", "fused"}
BY_KINEMATICS = {"fiducial", "kinematic", "fused"}
ONE_JOINT_LESS = replace(FULL, joint_names={f"/{Role.JOINTS}": JOINTS[1:]})


@pytest.mark.parametrize(
    ("summary", "profile", "methods", "words"),
    [
        (without("image", "camera_info"), PROFILE, set(METHODS), "a topic for image"),
        (without("joints"), PROFILE, BY_KINEMATICS, "a topic for joints"),
        (without("right_image"), PROFILE, {"stereo"}, "a topic for right_image"),
        (without("ground_truth_tf", "ground_truth_distance"), PROFILE, set(), ""),
        (
            without(transforms=linking(FRAMES.tool)),  # `frames` has the base all the same
            PROFILE,
            {"kinematic", "fused"},
            f"{FRAMES.camera} to {FRAMES.base}",
        ),
        (replace(FULL, base_apart_s=0.43), PROFILE, {"kinematic", "fused"}, "(nearest 430 ms)"),
        (replace(FULL, joints_apart_s=30.0), PROFILE, BY_KINEMATICS, "(nearest 30.0 s)"),
        (ONE_JOINT_LESS, PROFILE, BY_KINEMATICS, f"the joints {JOINTS[0]} of profile {PROFILE.name}"),
        (FULL, poorer("fiducial"), {"fiducial"}, f"[fiducial] in profile {PROFILE.name}"),
        (FULL, poorer("tissue"), IN_3D, f"[tissue] in profile {PROFILE.name}"),
        (FULL, poorer("instrument"), {"shaft"}, f"[instrument] in profile {PROFILE.name}"),
        (FULL, poorer("calibration"), {"overlay", "centroid"}, f"a calibration in profile {PROFILE.name}"),
        (FULL, poorer("robot"), IN_3D, f"[robot] in profile {PROFILE.name}"),
    ],
)
def test_each_part_of_log_and_profile_is_needed_by_its_own_methods(summary, profile, methods, words):
    """Without images, of the commands only `fk` remains."""
    summary = replace(summary, recording=read_by(profile))
    found = lacking(method_capabilities(summary))
    assert set(found) == methods
    assert all(any(words in one for one in each) for each in found.values())
    if methods == set(METHODS):
        commands = {"estimate", "calibrate", "validate", "compare", "blur-bench"}
        assert set(lacking(capabilities(summary))) == commands


@pytest.mark.parametrize(
    ("log", "changes", "best"),
    [
        ("3d/contact.mcap", {}, "fused"),
        ("3d/contact.mcap", {"robot": None}, "overlay"),
        ("3d/contact.mcap", {"hand_eye": None, "frames": {"camera": "elsewhere"}}, "stereo"),
        ("sweep.mcap", {"tissue": None}, "overlay"),
        ("sweep.mcap", {"tissue": None, "calibration": None}, ""),
    ],
)
def test_auto_is_the_best_method_that_log_and_profile_serve(golden, log, changes, best):
    """It says what better ones lack; where no method can measure, the lacks of all are told."""
    profile = PROFILE.model_copy(
        update={
            name: PROFILE.frames.model_copy(update=value) if name == "frames" else value
            for name, value in changes.items()
        }
    )
    if not best:
        with pytest.raises(RecordingError, match=r"no method can measure .* fused lacks \[tissue\]"):
            best_method([golden / log], profile)
        return
    found, why = best_method([golden / log], profile)
    assert found == best
    assert ("fused lacks" in why) == (best != "fused")


def test_a_log_that_is_none_of_the_default_profile_s_names_what_makes_one(golden, tmp_path):
    """Neither made with it nor with its joints: its colours and sizes are another scene's."""
    foreign = replace(FULL, joint_names={})
    assert "svmdist profile new a.mcap -o a.toml" in capabilities(foreign)["estimate"][0]
    mine = replace(foreign, recording=read_by(PROFILE.model_copy(update={"name": "mine"})))
    assert lacking(capabilities(mine)).keys() <= {"fk"}


def test_the_reference_of_validation_is_truth_or_the_tool_s_poses():
    """Any of the tool's sources will do; where there is none, that is said."""
    truthless = ("ground_truth_distance", "ground_truth_tf", "pose", "joints")
    (missing,) = lacking(capabilities(without(*truthless, transforms=linking())))["validate"]
    assert missing.startswith("the tool's pose")
    for source in ("pose", "joints"):
        roles = set(truthless) - {source}
        assert "validate" not in lacking(capabilities(without(*roles, transforms=linking())))
    served = without(*truthless, transforms=linking(FRAMES.tool))
    assert "validate" not in lacking(capabilities(served))


def test_a_log_of_another_arm_is_that_arms():
    """A profile of three arms serves a log of the second one: neither joints nor frames of the first are needed."""
    dvrk = load_profile("dvrk-psm")
    names = tuple(joint.name for joint in dvrk.robot.joints)
    contents = Contents()
    contents["/tf"]["ECM", "PSM2_base"].add(0, [0.0] * 6 + [1.0])
    log = replace(
        FULL,
        topics=(topic("/PSM2/measured_js"), topic("/image")),
        roles={**FULL.roles, "joints": "/PSM2/measured_js"},
        transforms=TransformTree(contents, {"/tf": False}),
        joint_names={"/PSM2/measured_js": names},
        recording=read_by(dvrk.for_instrument("PSM2")),
    )
    assert "fk" not in lacking(capabilities(log))
    assert lacking(method_capabilities(log))["kinematic"] == ("[tissue] in profile dvrk-psm",)

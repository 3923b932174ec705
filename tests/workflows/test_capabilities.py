"""What a recording can serve: the more it and the profile have, the more, and what lacks is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from svmdist.estimation.methods import METHODS
from svmdist.profile import Profile, load_profile
from svmdist.profile.robot import ArmFrames, ArmTopics, OtherInstrument
from svmdist.recording.log import open_recording
from svmdist.recording.source import Health
from svmdist.recording.summary import RecordingSummary, TopicSummary
from svmdist.recording.topics import Role
from svmdist.workflows.capabilities import (
    Capability,
    TagCheck,
    capabilities,
    instruments_in,
    look_for_tag,
    method_capabilities,
)
from tests.conftest import REPOSITORY

PROFILE = load_profile()
assert PROFILE.robot is not None
JOINTS = tuple(joint.name for joint in PROFILE.robot.joints)
FRAMES = PROFILE.frames


def topic(name: str) -> TopicSummary:
    """A topic of which only the name matters."""
    return TopicSummary(name, "", "", None, 1, None, None, None, 0.0, 0, 0, 0)


FULL = RecordingSummary(
    path=Path("a.mcap"),
    size_bytes=1,
    metadata={},
    duration_s=1.0,
    topics=(topic("/PSM1/measured_js"), topic("/image")),
    roles={str(role): f"/{role}" for role in Role},
    cameras={},
    frames=(FRAMES.base, FRAMES.camera, FRAMES.tissue, FRAMES.tool),
    joint_names={f"/{Role.JOINTS}": JOINTS},
    health=Health(),
)
"""A recording that has everything."""


def without(*roles: str, frames: tuple[str, ...] = FULL.frames) -> RecordingSummary:
    """The recording without the topics of some roles."""
    kept = {role: name for role, name in FULL.roles.items() if role not in roles}
    return replace(FULL, roles=kept, frames=frames)


def lacking(found: tuple[Capability, ...]) -> dict[str, tuple[str, ...]]:
    """What each lacks that cannot be served."""
    return {one.name: one.missing for one in found if not one.served}


def test_a_recording_that_has_everything_serves_everything() -> None:
    """Every method is told of, in their order; those that need a calibration of the profile find it."""
    assert lacking(capabilities(FULL, PROFILE)) == {}
    assert tuple(one.name for one in method_capabilities(FULL, PROFILE)) == tuple(METHODS)
    assert lacking(method_capabilities(FULL, PROFILE)) == {}


@pytest.mark.parametrize("role", sorted(Role))
def test_what_is_lacking_can_only_take_away(role: Role) -> None:
    """And what a topic was needed for names its role."""
    for tell in (capabilities, method_capabilities):
        for full, less in zip(tell(FULL, PROFILE), tell(without(role), PROFILE), strict=True):
            assert set(less.missing) >= set(full.missing)
            assert less.served == (less.missing == ())


def test_without_images_nothing_is_measured() -> None:
    """Kinematics alone remain."""
    missing = ("a topic for image", "a topic for camera_info")
    found = lacking(capabilities(without("image", "camera_info"), PROFILE))
    assert set(found) == {"estimate", "calibrate", "validate", "compare", "blur-bench"}
    assert all(each[:2] == missing for each in found.values())
    methods = method_capabilities(without("image", "camera_info"), PROFILE)
    assert all(one.missing[:2] == missing for one in methods)


def test_each_topic_is_needed_by_its_own_methods() -> None:
    """Joints by those that use kinematics, the right image by stereo, the truth by none."""
    by_joints = lacking(method_capabilities(without("joints"), PROFILE))
    assert set(by_joints) == {"fiducial", "kinematic", "fused"}
    assert set(lacking(method_capabilities(without("right_image"), PROFILE))) == {"stereo"}
    assert lacking(method_capabilities(without("ground_truth_tf", "ground_truth_distance"), PROFILE)) == {}


def test_the_reference_of_validation_is_truth_or_a_pose_and_the_tissues_place() -> None:
    """Any of the tool's sources will do; each side that lacks is named."""
    truthless = ("ground_truth_distance", "ground_truth_tf", "pose", "joints")
    both = lacking(capabilities(without(*truthless, frames=()), PROFILE))["validate"]
    assert [each.split(" (")[0] for each in both] == ["the tool's pose", "the tissue's place"]
    for source in ("pose", "joints"):
        roles = set(truthless) - {source}
        (place,) = lacking(capabilities(without(*roles, frames=()), PROFILE))["validate"]
        assert place.startswith("the tissue's place")
    served = without(*truthless, frames=(FRAMES.tool, FRAMES.tissue))
    assert "validate" not in lacking(capabilities(served, PROFILE))


def test_nominal_transforms_are_needed_by_the_methods_that_begin_with_them() -> None:
    found = lacking(method_capabilities(without(frames=(FRAMES.camera,)), PROFILE))
    words = (f"transforms from {FRAMES.camera} to {FRAMES.base}",)
    assert found == {"kinematic": words, "fused": words}


def test_joints_that_the_chain_needs_are_named() -> None:
    """A name of another recorder counts where the profile knows it as an alias."""
    fewer = replace(FULL, joint_names={f"/{Role.JOINTS}": JOINTS[1:]})
    (words,) = lacking(capabilities(fewer, PROFILE))["fk"]
    assert words == f"the joints {JOINTS[0]} of profile {PROFILE.name}"
    none = PROFILE.model_copy(update={"robot": None})
    assert lacking(capabilities(FULL, none))["fk"] == (f"a [robot] in profile {PROFILE.name}",)


@pytest.mark.parametrize(
    ("table", "methods"),
    [
        ("fiducial", {"fiducial"}),
        ("tissue", {"fiducial", "shaft", "stereo", "kinematic", "fused"}),
        ("instrument", {"shaft"}),
        ("calibration", {"overlay", "centroid"}),
    ],
)
def test_what_the_profile_lacks_is_named(table: str, methods: set[str]) -> None:
    poorer = PROFILE.model_copy(update={table: None})
    found = lacking(method_capabilities(FULL, poorer))
    assert set(found) == methods
    assert all(table in words and PROFILE.name in words for each in found.values() for words in each)


@pytest.fixture
def two_arms() -> Profile:
    """The profile with one other instrument."""
    second = OtherInstrument(
        name="PSM9", topics=ArmTopics(joints="/PSM9/measured_js"), frames=ArmFrames(base="b2", tool="t2")
    )
    return PROFILE.model_copy(update={"other_instruments": (second,)})


def test_an_instrument_is_known_by_its_topics(two_arms: Profile) -> None:
    """The profile's own is always there."""
    assert instruments_in(FULL, two_arms) == (PROFILE.instrument_name,)
    both = replace(FULL, topics=(*FULL.topics, topic("/PSM9/measured_js")))
    assert instruments_in(both, two_arms) == (PROFILE.instrument_name, "PSM9")
    assert instruments_in(both, PROFILE) == (PROFILE.instrument_name,)


def test_estimate_names_the_methods_that_run() -> None:
    """Where the default method lacks a calibration, the others that run are named; where none runs, it is said."""
    uncalibrated = PROFILE.model_copy(update={"calibration": None})
    (found,) = [one for one in capabilities(FULL, uncalibrated) if one.name == "estimate"]
    assert found.served
    assert found.note.startswith(
        "with --method fiducial or shaft or stereo or kinematic or fused; the default method"
    )
    bare = uncalibrated.model_copy(update={"robot": None, "tissue": None, "fiducial": None})
    assert "a method that log and profile serve" in lacking(capabilities(FULL, bare))["estimate"][0]


def test_a_tag_that_no_image_shows_is_told() -> None:
    """`fiducial` needs the tag in an image; where no image was looked at, nothing is said."""
    unseen, seen, unknown = (TagCheck("36h11 0", *counts) for counts in ((8, 0), (8, 1), (0, 0)))
    assert "none of 8 images" in lacking(method_capabilities(FULL, PROFILE, unseen))["fiducial"][0]
    assert lacking(method_capabilities(FULL, PROFILE, seen)) == {}
    assert lacking(method_capabilities(FULL, PROFILE, unknown)) == {}


@pytest.mark.parametrize(("log", "found"), [("3d/contact.mcap", True), ("sweep.mcap", False)])
def test_tags_are_looked_for_in_images(log: str, found: bool) -> None:
    """A log with a tag and one without."""
    check = look_for_tag(open_recording(REPOSITORY / "recordings" / log, PROFILE), PROFILE)
    assert check is not None
    assert check.image_count >= 8
    assert (check.found_count > 0) == found


def test_a_log_of_another_arm_is_that_arms() -> None:
    """A profile of three arms serves a log of the second one: neither joints nor frames of the first are asked for."""
    dvrk = load_profile("dvrk-psm")
    assert dvrk.instrument_names == ("PSM1", "PSM2", "PSM3")
    names = tuple(joint.name for joint in dvrk.robot.joints)
    log = replace(
        FULL,
        topics=(topic("/PSM2/measured_js"), topic("/image")),
        roles={**FULL.roles, "joints": "/PSM2/measured_js"},
        frames=("ECM", "PSM2_base", "tissue"),
        joint_names={"/PSM2/measured_js": names},
    )
    assert instruments_in(log, dvrk) == ("PSM2",)
    assert "fk" not in lacking(capabilities(log, dvrk))
    assert lacking(method_capabilities(log, dvrk))["kinematic"] == ("[tissue] in profile dvrk-psm",)

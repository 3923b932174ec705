"""Which instruments a recording has, and what each of them sees."""

from __future__ import annotations

from pathlib import Path

import pytest

from svmdist.profile import Limits, Profile
from svmdist.profile.robot import ArmFrames, ArmTopics, OtherInstrument
from svmdist.recording.mcap import McapSource
from svmdist.recording.topics import Role, find_arms

from .builders import write_messages

JOINTS, POSE, IMAGE = "foxglove.JointStates", "foxglove.PoseInFrame", "foxglove.CompressedImage"
SECOND = OtherInstrument(
    name="PSM2",
    topics=ArmTopics(joints="/PSM2/measured_js"),
    frames=ArmFrames(base="PSM2_base", tool="PSM2_tool"),
)


@pytest.fixture(scope="module")
def two_arms(profile: Profile) -> Profile:
    """The profile with a second instrument."""
    return profile.model_copy(update={"other_instruments": (SECOND,), "fiducial": None})


def source(folder: Path, *topics: tuple[str, str]) -> McapSource:
    """A log with one empty message on each topic, given with its schema."""
    rows = [(topic, schema, "protobuf", b"", 1) for topic, schema in topics]
    path = write_messages(folder / "a.mcap", rows)
    return McapSource(path, Limits())


def test_the_profiles_own_instrument_is_always_there(tmp_path: Path, two_arms: Profile) -> None:
    """Even in a log without any of its topics; the other one only where the log has its joints or pose."""
    arms = find_arms(source(tmp_path, ("/image", IMAGE)), two_arms, {})
    assert [arm.name for arm in arms] == [two_arms.instrument_name]
    assert arms[0].choice.find(Role.JOINTS) is None
    assert arms[0].choice.find(Role.IMAGE) == "/image"


def test_each_arm_has_its_own_joints_and_frames_and_the_scenes_images(
    tmp_path: Path, two_arms: Profile
) -> None:
    log = source(
        tmp_path, ("/PSM1/measured_js", JOINTS), ("/PSM2/measured_js", JOINTS), ("/ECM/left/image", IMAGE)
    )
    first, second = find_arms(log, two_arms, {})
    assert (first.name, second.name) == (two_arms.instrument_name, "PSM2")
    assert first.choice.require(Role.JOINTS) == "/PSM1/measured_js"
    assert second.choice.require(Role.JOINTS) == "/PSM2/measured_js"
    assert first.choice.require(Role.IMAGE) == second.choice.require(Role.IMAGE) == "/ECM/left/image"
    assert (first.frames.base, first.frames.tool) == (two_arms.frames.base, two_arms.frames.tool)
    assert (second.frames.base, second.frames.tool) == ("PSM2_base", "PSM2_tool")
    assert first.frames.camera == second.frames.camera


def test_joints_of_one_arm_stand_in_for_no_others(tmp_path: Path, two_arms: Profile) -> None:
    """The only joint states are the second arm's: the first one, whose topics the profile names, is not in the log."""
    (only,) = find_arms(source(tmp_path, ("/PSM2/measured_js", JOINTS)), two_arms, {})
    assert only.name == "PSM2"
    assert only.choice.find(Role.JOINTS) == "/PSM2/measured_js"


def test_the_callers_joints_are_the_first_arms(tmp_path: Path, two_arms: Profile) -> None:
    """A topic that the caller gives to the first instrument is no sign of another one; an image is for all."""
    log = source(tmp_path, ("/PSM2/measured_js", JOINTS), ("/a", IMAGE), ("/b", IMAGE))
    (only,) = find_arms(log, two_arms, {"joints": "/PSM2/measured_js"})
    assert only.choice.require(Role.JOINTS) == "/PSM2/measured_js"
    for arm in find_arms(log, two_arms, {"image": "/b"}):
        assert arm.choice.require(Role.IMAGE) == "/b"

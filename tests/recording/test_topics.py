"""Opening: which reader serves a file, which topic plays a role, and which instruments a recording has."""

from __future__ import annotations

import gzip
import os
from collections.abc import Mapping
from pathlib import Path

import pytest
import zstandard
from rosbags.rosbag2 import StoragePlugin

from svmdist.errors import RecordingError, UsageError
from svmdist.profile import Limits, Profile, Topics, load_profile
from svmdist.profile.robot import ArmFrames, ArmTopics, OtherInstrument
from svmdist.recording.log import open_recording
from svmdist.recording.mcap import McapSource
from svmdist.recording.rosbag import BagSource, FolderSource
from svmdist.recording.source import TopicInfo
from svmdist.recording.topics import NAMED, Role, TopicChoice, find_arms

from .builders import Entry, write_messages
from .other_recorders import ros_messages, write_rosbag1, write_rosbag2

PROFILE = load_profile()


def test_each_format_has_its_reader_whatever_its_name(
    tmp_path: Path, native: Path, entries: list[Entry]
) -> None:
    """A bag, a folder, the database in it, and MCAP, under names that say nothing."""
    messages = ros_messages(entries[:10])
    bag = write_rosbag1(tmp_path / "a.dat", messages)
    folder = write_rosbag2(tmp_path / "folder", messages, StoragePlugin.SQLITE3)
    database = next(folder.glob("*.db3")).rename(tmp_path / "b.dat")
    mcap = tmp_path / "c.dat"
    mcap.write_bytes(native.read_bytes())
    assert isinstance(open_recording(mcap, PROFILE).file.source, McapSource)
    assert isinstance(open_recording(bag, PROFILE).file.source, BagSource)
    assert isinstance(open_recording(database, PROFILE).file.source, BagSource)
    database.rename(folder / "folder.db3")
    assert isinstance(open_recording(folder, PROFILE).file.source, FolderSource)


NO_RECORDING: dict[str, tuple[bytes | None, str]] = {
    "none.mcap": (None, "no such file"),
    "a\0b": (None, "a"),
    "pipe": (None, "no regular file"),
    "folder": (None, "a directory without metadata.yaml"),
    "empty": (b"", "is empty"),
    "text": (b"hello, this is text", "is not a recording; expected an MCAP file"),
    "begun.mcap": (b"\x89MCAP", "truncated at byte 5"),
    "gzip": (gzip.compress(b"x"), "gzip-compressed"),
    "old.bag": (b"#ROSBAG V1.2\n", "version 1"),
    "pointer.mcap": (b"version https://git-lfs.github.com/spec/v1\n", "Git LFS pointer"),
    "bare.db3": (b"SQLite format 3\x00" + bytes(100), "no usable rosbag2 database"),
}


@pytest.mark.parametrize("name", NO_RECORDING)
def test_what_is_no_recording_is_one_clear_line(tmp_path: Path, name: str) -> None:
    path, (content, reason) = tmp_path / name, NO_RECORDING[name]
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(RecordingError, match=reason) as caught:
        open_recording(path, PROFILE)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_file_out_of_a_compressed_bag_asks_for_its_folder(tmp_path: Path) -> None:
    """CDR begins with a zero byte, so that the magic of zstd cannot be a message."""
    compressed = zstandard.compress(bytes(100))
    path = write_messages(tmp_path / "a.mcap", [("/js", "sensor_msgs/msg/JointState", "cdr", compressed, 1)])
    with pytest.raises(RecordingError, match="compressed one by one; open the folder"):
        open_recording(path, PROFILE)


IMAGE, RAW = "foxglove.CompressedImage", "sensor_msgs/msg/Image"
JOINTS, TRANSFORMS = "foxglove.JointStates", "foxglove.FrameTransforms"


def info(topic: str, schema: str, message_encoding: str = "protobuf") -> TopicInfo:
    """A topic of a log."""
    return TopicInfo(topic, schema, message_encoding)


def choice(
    *infos: TopicInfo,
    wanted: Topics | None = None,
    overrides: Mapping[str, str] | None = None,
    claimed: frozenset[str] = frozenset(),
) -> TopicChoice:
    """A choice among some topics of a log called a.mcap."""
    return TopicChoice(infos, wanted or Topics(), overrides or {}, "a.mcap", claimed)


def test_the_only_topic_that_fits_is_taken_whatever_its_encoding() -> None:
    """By its schema, in Foxglove's encoding and in those of ROS."""
    assert choice(info("/a", IMAGE), info("/j", JOINTS)).require(Role.IMAGE) == "/a"
    assert (
        choice(info("/a", RAW, "cdr"), info("/x", "std_msgs/msg/String", "cdr")).require(Role.IMAGE) == "/a"
    )
    assert choice(info("/a", "sensor_msgs/Image", "ros1")).require(Role.IMAGE) == "/a"
    with pytest.raises(RecordingError, match="choose one of /a, /b"):
        choice(info("/a", IMAGE), info("/b", IMAGE)).require(Role.IMAGE)


def test_the_callers_topic_comes_before_the_profiles_and_that_before_any_other() -> None:
    infos = [info(topic, IMAGE) for topic in ("/a", "/b", "/c")]
    wanted = Topics(image="/b")
    assert choice(*infos, wanted=wanted, overrides={"image": "/c"}).require(Role.IMAGE) == "/c"
    assert choice(*infos, wanted=wanted).require(Role.IMAGE) == "/b"
    assert choice(infos[0], wanted=wanted).require(Role.IMAGE) == "/a"


def test_where_none_fits_the_topics_are_listed() -> None:
    """Names are sanitized, for they come from the file."""
    with pytest.raises(
        RecordingError, match=r"no topic with images for image; the topics are /j\\n \(no schema\)"
    ):
        choice(info("/j\n", "")).require(Role.IMAGE)
    with pytest.raises(RecordingError, match="the recording has no topics"):
        choice().require(Role.JOINTS)


def test_an_override_that_does_not_fit_is_an_error_even_where_a_topic_is_optional() -> None:
    topics = choice(info("/j", JOINTS), overrides={"image": "/j"})
    for ask in (topics.require, topics.find):
        with pytest.raises(RecordingError, match="topic /j carries no images"):
            ask(Role.IMAGE)
    with pytest.raises(UsageError, match="no role imag for a topic: did you mean image"):
        choice(overrides={"imag": "/a"})


@pytest.mark.parametrize("role", sorted(NAMED))
def test_a_role_that_must_be_named_takes_no_topic_by_its_schema(role: Role) -> None:
    schema = {
        Role.GROUND_TRUTH_TF: TRANSFORMS,
        Role.RIGHT_IMAGE: IMAGE,
        Role.RIGHT_CAMERA_INFO: "foxglove.CameraCalibration",
    }[role]
    assert choice(info("/x", schema)).find(role) is None
    assert choice(info("/x", schema), wanted=Topics(**{role: "/x"})).find(role) == "/x"


def test_a_topic_of_another_role_or_of_another_arm_stands_in_for_none() -> None:
    wanted = Topics(ground_truth_tf="/truth")
    assert choice(info("/truth", TRANSFORMS), wanted=wanted).find(Role.TF) is None
    assert choice(info("/truth", TRANSFORMS), info("/tf", TRANSFORMS), wanted=wanted).find(Role.TF) == "/tf"
    arms = (info("/PSM1/js", JOINTS), info("/PSM2/js", JOINTS))
    assert choice(*arms, claimed=frozenset({"/PSM2/js"})).find(Role.JOINTS) == "/PSM1/js"
    assert choice(arms[1], claimed=frozenset({"/PSM2/js"})).find(Role.JOINTS) is None


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

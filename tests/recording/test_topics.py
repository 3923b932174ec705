"""Opening: which reader serves a file, which topic plays a role, and which instruments a recording has."""

import gzip
import os
import re
from collections.abc import Mapping
from pathlib import Path

import pytest

from svmdist.errors import RecordingError, UsageError
from svmdist.profile import Limits, Profile, Topics, load_profile
from svmdist.profile.robot import ArmFrames, ArmTopics, OtherInstrument
from svmdist.recording.log import open_recording
from svmdist.recording.mcap import McapSource
from svmdist.recording.source import TopicInfo
from svmdist.recording.summary import inspect_recording
from svmdist.recording.topics import LoggedArm, Role, find_arms
from svmdist.workflows.new_profile import find_roles

from .builders import write_messages

PROFILE = load_profile()


NO_RECORDING: dict[str, tuple[bytes | None, str]] = {
    "none.mcap": (None, "no such file"),
    "a\0b": (None, "a"),
    "pipe": (None, "no regular file"),
    "folder": (None, "a directory without metadata.yaml, so no rosbag2 folder"),
    "empty": (b"", "is empty"),
    "text": (b"hello, this is text", "is not a recording; expected an MCAP file"),
    "begun.mcap": (b"\x89MCAP", "truncated at byte 5"),
    "frame.png": (b"\x89PNG\r\n", "svmdist import"),
    "film.mp4": (b"\0\0\0\x20ftypisom", "svmdist import"),
    "gzip": (gzip.compress(b"x"), "gzip-compressed"),
    "old.bag": (b"#ROSBAG V1.2\n", "version 1"),
    "pointer.mcap": (b"version https://git-lfs.github.com/spec/v1\n", "Git LFS pointer"),
    "bare.db3": (b"SQLite format 3\x00" + bytes(100), "no usable rosbag2 database"),
}


@pytest.mark.parametrize("name", NO_RECORDING)
def test_what_is_no_recording_is_one_clear_line(tmp_path, name):
    path, (content, reason) = tmp_path / name, NO_RECORDING[name]
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(RecordingError, match=reason) as caught:
        open_recording(path, PROFILE)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


IMAGE, RAW = "foxglove.CompressedImage", "sensor_msgs/msg/Image"
JOINTS, TRANSFORMS, CAMERA = "foxglove.JointStates", "foxglove.FrameTransforms", "foxglove.CameraCalibration"
Rows = tuple[tuple[str, str], ...]


@pytest.mark.parametrize("encoding", ["json", "cbor"])
def test_schemas_in_an_encoding_that_is_not_read_are_said_to_be(tmp_path, encoding):
    """The topic is there by its schema, and yet is none."""
    rows = [("/camera_info", "foxglove.CameraCalibration", encoding, b"{}", 1)]
    log = open_recording(write_messages(tmp_path / "a.mcap", rows), PROFILE)
    said = f"messages in {encoding} are not read, those in protobuf, cdr, ros1 are$"
    with pytest.raises(RecordingError, match=said):
        _ = log.camera
    with pytest.raises(RecordingError, match=said):
        find_roles(inspect_recording(log), {"image": "/camera_info"})


def choice(
    *rows: tuple[str, str],
    wanted: dict[str, str] | None = None,
    overrides: Mapping[str, str] | None = None,
    claimed: frozenset[str] = frozenset(),
) -> LoggedArm:
    """An instrument of a log called a.mcap, whose topics are given with their schemas."""
    encodings = {RAW: "cdr", "std_msgs/msg/String": "cdr", "sensor_msgs/Image": "ros1"}
    infos = [TopicInfo(topic, schema, encodings.get(schema, "protobuf")) for topic, schema in rows]
    topics = Topics(**(wanted or {}))
    return LoggedArm("PSM1", PROFILE.frames, infos, topics, overrides or {}, "a.mcap", claimed)


CAMERAS = (("/a", IMAGE), ("/b", IMAGE), ("/c", IMAGE))
ARMS = (("/PSM1/js", JOINTS), ("/PSM2/js", JOINTS))
TRUTH = {"ground_truth_tf": "/truth"}
RIGHT_INFO = {"wanted": {"camera_info": "/y", "right_image": "/r", "right_camera_info": "/x"}}
PSM2 = {"claimed": frozenset({"/PSM2/js"})}


@pytest.mark.parametrize(
    ("role", "rows", "given", "found"),
    [
        # The only one that fits, by its schema, in Foxglove's encoding and in those of ROS.
        ("image", (("/a", IMAGE), ("/j", JOINTS)), {}, "/a"),
        ("image", (("/a", RAW), ("/x", "std_msgs/msg/String")), {}, "/a"),
        ("image", (("/a", "sensor_msgs/Image"),), {}, "/a"),
        # The caller's before the profile's, and that before any other.
        ("image", CAMERAS, {"wanted": {"image": "/b"}, "overrides": {"image": "/c"}}, "/c"),
        ("image", CAMERAS, {"wanted": {"image": "/b"}}, "/b"),
        ("image", CAMERAS[:1], {"wanted": {"image": "/b"}}, "/a"),
        # Some roles take no topic by its schema: it must be named.
        ("ground_truth_tf", (("/x", TRANSFORMS),), {}, None),
        ("ground_truth_tf", (("/x", TRANSFORMS),), {"wanted": {"ground_truth_tf": "/x"}}, "/x"),
        ("right_image", (("/x", IMAGE),), {}, None),
        ("right_image", (("/x", IMAGE),), {"wanted": {"right_image": "/x"}}, "/x"),
        ("right_camera_info", (("/x", CAMERA),), {}, None),
        ("right_camera_info", (("/x", CAMERA),), {"wanted": {"right_camera_info": "/x"}}, "/x"),
        # The right view's calibration is no left image's, and a right image is not the left calibration's.
        ("camera_info", (("/l", IMAGE), ("/x", CAMERA)), RIGHT_INFO, None),
        ("camera_info", (("/left/image", IMAGE), ("/right/camera_info", CAMERA)), {}, None),
        ("camera_info", (("/r", IMAGE), ("/x", CAMERA)), RIGHT_INFO, "/x"),
        ("image", (("/r", IMAGE), ("/x", CAMERA)), RIGHT_INFO, "/r"),
        ("image", (("/r", IMAGE), ("/y", CAMERA)), RIGHT_INFO, None),
        # None of another role or of another arm.
        ("tf", (("/truth", TRANSFORMS),), {"wanted": TRUTH}, None),
        ("tf", (("/truth", TRANSFORMS), ("/tf", TRANSFORMS)), {"wanted": TRUTH}, "/tf"),
        ("joints", ARMS, PSM2, "/PSM1/js"),
        ("joints", ARMS[1:], PSM2, None),
    ],
)
def test_a_role_has_the_topic_that_fits(role, rows, given, found):
    assert choice(*rows, **given).find(Role(role)) == found


def test_roles_without_a_topic_or_with_a_wrong_one_are_errors():
    """The topics are listed, sanitized, for they come from the file; an override counts even where none is needed."""
    given = {"overrides": {"image": "/j"}}
    for rows, options, message in (
        (CAMERAS[:2], {}, "choose one with --topic image=TOPIC: /a, /b"),
        ((("/j\n", ""),), {}, r"no topic with images for image; the topics are /j\\n \(no schema\)"),
        ((), {}, "the recording has no topics"),
        ((("/j", JOINTS),), given, "topic /j carries no images"),
    ):
        with pytest.raises(RecordingError, match=message):
            choice(*rows, **options).require(Role.IMAGE)
    with pytest.raises(RecordingError, match="topic /j carries no images"):
        choice(("/j", JOINTS), **given).find(Role.IMAGE)
    with pytest.raises(UsageError, match="no role imag for a topic: did you mean image"):
        choice(overrides={"imag": "/a"})


@pytest.mark.parametrize(
    ("rows", "wanted", "said"),
    [
        ((("/l", IMAGE), ("/right", IMAGE)), {"image": "/l", "right_image": "/rihgt"}, "did you mean /right"),
        ((("/js", JOINTS),), {"joints": "/jss"}, "joints: the log has no /jss, .*: /js stands in for it"),
        ((("/l", IMAGE),), {"image": "/l", "right_image": "/r", "joints": "/js"}, None),
        (
            (("/cam", IMAGE),),
            {"image": "/l", "right_image": "/r"},
            "image: the log has no /l, .*: /cam stands",
        ),
        ((("/tf_static", TRANSFORMS),), {"tf": "/tf", **TRUTH}, None),
    ],
)
def test_a_topic_that_the_log_has_by_another_name_is_said(rows, wanted, said):
    """What it does not have at all is not."""
    found = choice(*rows, wanted=wanted).missing_topics()
    assert len(found) == (said is not None)
    assert said is None or re.search(said, found[0])


SECOND = OtherInstrument(
    name="PSM2",
    topics=ArmTopics(joints="/PSM2/measured_js"),
    frames=ArmFrames(base="PSM2_base", tool="PSM2_tool"),
)


@pytest.fixture(scope="module")
def two_arms(profile: Profile) -> Profile:
    """The profile with a second instrument."""
    return profile.model_copy(update={"other_instruments": (SECOND,), "fiducial": None})


def arms_of(folder: Path, profile: Profile, *topics: tuple[str, str], **overrides: str) -> tuple[LoggedArm, ...]:
    """The arms in a log with one empty message on each topic, given with its schema."""
    rows = [(topic, schema, "protobuf", b"", 1) for topic, schema in topics]
    return find_arms(McapSource(write_messages(folder / "a.mcap", rows), Limits()), profile, overrides)


def test_each_arm_has_its_own_joints_and_frames_and_the_scenes_images(tmp_path, two_arms):
    topics = (("/PSM1/measured_js", JOINTS), ("/PSM2/measured_js", JOINTS), ("/ECM/left/image", IMAGE))
    first, second = arms_of(tmp_path, two_arms, *topics)
    assert (first.name, second.name) == (two_arms.instrument_name, "PSM2")
    for arm, (joints, _) in zip((first, second), topics, strict=False):
        assert arm.require(Role.JOINTS) == joints
        assert arm.require(Role.IMAGE) == "/ECM/left/image"
        assert arm.frames.camera == two_arms.frames.camera
    assert (first.frames.base, first.frames.tool) == (two_arms.frames.base, two_arms.frames.tool)
    assert (second.frames.base, second.frames.tool) == ("PSM2_base", "PSM2_tool")


def test_arms_are_known_by_their_joints(tmp_path, two_arms):
    """The first one stands for a log without any; only the second one's joints, or the caller's, make it another."""
    (only,) = arms_of(tmp_path, two_arms, ("/image", IMAGE))
    assert only.name == two_arms.instrument_name
    assert (only.find(Role.JOINTS), only.find(Role.IMAGE)) == (None, "/image")
    second = ("/PSM2/measured_js", JOINTS)
    (only,) = arms_of(tmp_path, two_arms, second)
    assert (only.name, only.find(Role.JOINTS)) == ("PSM2", second[0])
    (only,) = arms_of(tmp_path, two_arms, second, *CAMERAS[:2], joints=second[0])
    assert (only.name, only.require(Role.JOINTS)) == (two_arms.instrument_name, second[0])
    for arm in arms_of(tmp_path, two_arms, second, *CAMERAS[:2], image="/b"):
        assert arm.require(Role.IMAGE) == "/b"

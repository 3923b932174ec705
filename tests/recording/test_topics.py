"""Which topic plays a role: the caller's, else the profile's, else the only one whose schema fits."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from svmdist.errors import RecordingError, UsageError
from svmdist.profile import Topics
from svmdist.recording.source import TopicInfo
from svmdist.recording.topics import NAMED, Role, TopicChoice

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

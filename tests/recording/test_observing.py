"""Observing: every image once and in file order, with what its arm reported and nothing that it did not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.profile import Limits, Profile
from svmdist.recording.encode import encode
from svmdist.recording.mcap_file.source import McapSource
from svmdist.recording.observations import (
    EVERYTHING,
    LEFT_IMAGES,
    EncodedObservation,
    LoggedImage,
    LoggedJoints,
    LoggedTransforms,
    Needs,
)
from svmdist.recording.observing import OTHER_JOINTS, DecodedMessages, Observer
from svmdist.recording.source import LossKind
from svmdist.recording.topics import LoggedArm, find_arms
from svmdist.samples import (
    ImageSample,
    JointSample,
    Observation,
    Rejection,
    Sample,
    TransformSample,
    TransformsSample,
)

from .builders import CAMERA, PERIOD_NS, Entry, pose, scene, write_messages, write_scene

IMAGE = "/ECM/left/image"
ROUNDING = 1e-12
"""Poses travel as quaternions of 64 bits."""


def no_right_camera() -> Camera | None:
    """Fails when it is asked for: no test here has right images."""
    pytest.fail("the right camera was asked for, which takes a pass over the log")


def with_camera_pose(entries: list[Entry]) -> list[Entry]:
    """The scene whose nominal transforms lead from the camera to the base."""
    changed = []
    for entry in entries:
        sample: Sample = entry.sample
        if entry.topic == "/tf" and isinstance(sample, TransformsSample):
            (one,) = sample.transforms
            there = TransformSample(one.stamp_ns, "camera", "base", one.T_parent_child)
            sample = TransformsSample(sample.stamp_ns, (there,))
        changed.append(Entry(entry.topic, sample))
    return changed


def observer_of(path: Path, profile: Profile) -> tuple[Observer, tuple[LoggedArm, ...], DecodedMessages]:
    """An observer of a log, its arms, and the messages that it reads."""
    source = McapSource(path, Limits())
    arms = find_arms(source, profile, {})
    messages = DecodedMessages(source, Limits())
    return Observer(messages, arms[0].choice), arms, messages


def observe(path: Path, profile: Profile, needs: Needs = EVERYTHING) -> list[Observation]:
    """All observations of the first arm."""
    observer, arms, _ = observer_of(path, profile)
    encoded = list(observer.observations(IMAGE, CAMERA, no_right_camera, arms, needs))
    assert all(isinstance(one, EncodedObservation) for one in encoded)
    found = []
    for one in encoded:
        decoded = one.decode().found
        assert not isinstance(decoded, Rejection)
        found.append(decoded[0])
    return found


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scene of five images with nominal transforms of the camera."""
    return write_scene(tmp_path_factory.mktemp("observing") / "a.mcap", with_camera_pose(scene()))


def test_an_image_comes_with_the_joints_and_the_pose_at_its_stamp(log: Path, profile: Profile) -> None:
    """Both are published at the images' stamps here, so that nothing is interpolated."""
    observations = observe(log, profile)
    for frame, observation in enumerate(observations):
        assert observation.joints is not None
        assert observation.joints.positions.tolist() == [0.5 * frame, -1.0]
        assert observation.T_camera_base is not None
        np.testing.assert_allclose(observation.T_camera_base, pose(frame), atol=ROUNDING)
        assert observation.right is None
    assert len(observations) == 5


def test_what_is_not_needed_is_not_given(log: Path, profile: Profile) -> None:
    """The images are the same ones."""
    everything = observe(log, profile)
    for needs in (LEFT_IMAGES, Needs(transforms=False), Needs(joints=False)):
        observations = observe(log, profile, needs)
        assert [one.stamp_ns for one in observations] == [one.stamp_ns for one in everything]
        assert all((one.joints is not None) == needs.joints for one in observations)
        assert all((one.T_camera_base is not None) == needs.transforms for one in observations)
        for one, full in zip(observations, everything, strict=True):
            np.testing.assert_array_equal(one.image_bgr, full.image_bgr)


def test_items_are_in_file_order_and_of_the_topics_that_were_asked_for(log: Path, profile: Profile) -> None:
    observer, _, _ = observer_of(log, profile)
    alone = list(observer.items(IMAGE))
    assert len(alone) == 5
    assert all(isinstance(item, LoggedImage) for item in alone)
    items = list(observer.items(IMAGE, ["/PSM1/measured_js"], with_tf=True))
    assert sum(isinstance(item, LoggedJoints) for item in items) == 4 * 5
    assert sum(isinstance(item, LoggedTransforms) for item in items) == 5
    offsets = [item.offset for item in items if isinstance(item, LoggedImage)]
    assert offsets == sorted(offset for offset in offsets if offset is not None)


def test_a_message_of_other_joints_is_a_loss(tmp_path: Path, profile: Profile, entries: list[Entry]) -> None:
    """The first message says which joints the topic has."""
    other = JointSample(1_000_000_000 + PERIOD_NS // 2, ("roll",), np.zeros(1))
    path = write_scene(tmp_path / "a.mcap", [*entries, Entry("/PSM1/measured_js", other)])
    observer, _, messages = observer_of(path, profile)
    joints = [item for item in observer.items(IMAGE, ["/PSM1/measured_js"]) if isinstance(item, LoggedJoints)]
    assert {item.sample.names for item in joints} == {("yaw", "pitch")}
    (loss,) = messages.health.losses
    assert (loss.kind, loss.detail) == (LossKind.MESSAGE, OTHER_JOINTS)


def test_an_image_that_does_not_decode_keeps_its_place(
    tmp_path: Path, profile: Profile, entries: list[Entry]
) -> None:
    """A Rejection stands for it, and a loss tells the reason."""
    images = [entry.sample for entry in entries if isinstance(entry.sample, ImageSample)][:3]
    bodies = [encode(image) for image in images]
    bodies[1] = b"\xff"
    rows = [
        (IMAGE, "foxglove.CompressedImage", "protobuf", body, image.stamp_ns)
        for body, image in zip(bodies, images, strict=True)
    ]
    observer, _, messages = observer_of(write_messages(tmp_path / "a.mcap", rows), profile)
    found = list(observer.images(IMAGE))
    assert [type(one) for one in found] == [ImageSample, Rejection, ImageSample]
    assert [one.stamp_ns for one in found] == [image.stamp_ns for image in images]
    (loss,) = messages.health.losses
    assert (loss.kind, loss.topic) == (LossKind.IMAGE, IMAGE)

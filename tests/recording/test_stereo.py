"""Observations with the right image of a pair and with where the robot believes its base to be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.errors import RecordingError
from svmdist.profile import Profile
from svmdist.recording.log import open_recording
from svmdist.samples import CameraSample, ImageSample, Observation, TransformSample, TransformsSample
from svmdist.transforms import Array, inverse

from .builders import CAMERA, PERIOD_NS, Entry, pose, scene, write_scene

BASELINE_M = 0.005
RIGHT_IMAGE, RIGHT_INFO = "/ECM/right/image", "/ECM/right/camera_info"


def right_camera() -> Camera:
    P = np.hstack([CAMERA.K, np.zeros((3, 1))])
    P[0, 3] = -CAMERA.K[0, 0] * BASELINE_M
    return replace(CAMERA, P=P, frame_id="camera_right")


def with_right(entries: list[Entry], shift_ns: int = 0, late: int = 0) -> list[Entry]:
    """Add a negative of every image as the right one, `late` entries behind it, and the right camera."""
    woven: list[Entry] = [Entry(RIGHT_INFO, CameraSample(entries[0].sample.stamp_ns, right_camera()))]
    waiting: list[tuple[int, Entry]] = []
    for index, entry in enumerate(entries):
        woven.append(entry)
        if isinstance(entry.sample, ImageSample):
            negative = np.asarray(255 - entry.sample.image_bgr, np.uint8)
            sample = ImageSample(entry.sample.stamp_ns + shift_ns, "camera_right", negative)
            waiting.append((index + late, Entry(RIGHT_IMAGE, sample)))
        while waiting and waiting[0][0] <= index:
            woven.append(waiting.pop(0)[1])
    return woven + [entry for _, entry in waiting]


def observations(path: Path, profile: Profile, **topics: str) -> list[Observation]:
    found = list(open_recording(path, profile, topics=topics).observations())
    assert all(isinstance(item, Observation) for item in found)
    return [item for item in found if isinstance(item, Observation)]


@pytest.mark.parametrize(("shift_ns", "late"), [(0, 0), (400_000, 1), (-500_000, 23)])
def test_right_images_find_their_left_ones(
    tmp_path: Path, profile: Profile, shift_ns: int, late: int
) -> None:
    """Within half a millisecond, and up to seconds later in the file."""
    path = write_scene(tmp_path / "pair.mcap", with_right(scene(), shift_ns, late))
    for item in observations(path, profile):
        assert item.right is not None
        np.testing.assert_array_equal(item.right.image_bgr, 255 - item.image_bgr)
        np.testing.assert_allclose(item.right.T_left_right[:3, 3], [BASELINE_M, 0.0, 0.0], atol=1e-15)
        np.testing.assert_array_equal(item.right.T_left_right[:3, :3], np.eye(3))
        assert item.right.camera.frame_id == "camera_right"


def test_a_right_image_off_by_more_is_none(tmp_path: Path, profile: Profile) -> None:
    path = write_scene(tmp_path / "off.mcap", with_right(scene(), 600_000))
    assert [item.right for item in observations(path, profile)] == [None] * 5


def test_a_pair_without_baseline_is_no_pair(tmp_path: Path, profile: Profile) -> None:
    """Without a right calibration, or one whose P tells no baseline, there is no right view."""
    entries = with_right(scene())
    no_info = write_scene(tmp_path / "a.mcap", [item for item in entries if item.topic != RIGHT_INFO])
    mono = replace(right_camera(), P=CAMERA.P)
    entries[0] = Entry(RIGHT_INFO, CameraSample(entries[0].sample.stamp_ns, mono))
    no_baseline = write_scene(tmp_path / "b.mcap", entries)
    for path in (no_info, no_baseline):
        assert [item.right for item in observations(path, profile)] == [None] * 5


def test_the_right_topics_leave_the_left_ones_to_be_found(tmp_path: Path, profile: Profile) -> None:
    """By schema: what is named as right is no candidate, unless it is all there is."""
    other = profile.model_copy(update={"topics": profile.topics.model_copy(update={"image": "/elsewhere"})})
    path = write_scene(tmp_path / "pair.mcap", with_right(scene()))
    recording = open_recording(path, other)
    assert recording.topic_of("image") == "/ECM/left/image"
    assert recording.topic_of("right_image") == RIGHT_IMAGE
    unnamed = profile.model_copy(update={"topics": type(profile.topics)()})
    with pytest.raises(RecordingError, match="several topics"):
        open_recording(path, unnamed).observations()
    topics = {"right_image": RIGHT_IMAGE, "right_camera_info": RIGHT_INFO}
    assert open_recording(path, unnamed, topics=topics).topic_of("image") == "/ECM/left/image"
    assert observations(path, unnamed, **topics)[0].right is not None
    lonely = [
        entry
        for entry in with_right(scene())
        if entry.topic not in ("/ECM/left/image", "/ECM/left/camera_info")
    ]
    path = write_scene(tmp_path / "lonely.mcap", lonely)
    assert open_recording(path, profile).topic_of("image") == RIGHT_IMAGE
    assert [item.right for item in observations(path, profile)] == [None] * 5


def tf_entry(topic: str, stamp_ns: int, parent: str, child: str, T: Array) -> Entry:
    return Entry(topic, TransformsSample(stamp_ns, (TransformSample(stamp_ns, parent, child, T),)))


def test_the_believed_base_is_interpolated_along_the_tree(tmp_path: Path, profile: Profile) -> None:
    """Camera to mount stands still, the base moves in the mount's frame; one edge is published backwards."""
    entries = [entry for entry in scene() if entry.topic != "/tf"]
    start_ns = entries[0].sample.stamp_ns
    entries.insert(0, tf_entry("/tf_static", start_ns, "/mount", "camera", inverse(pose(3))))
    moving = []
    for step in range(-1, 12):
        moved = np.eye(4)
        moved[0, 3] = 0.001 * step
        moving.append(tf_entry("/tf", start_ns + step * PERIOD_NS // 2 + 1_000_000, "mount", "base", moved))
    entries = sorted(entries[1:] + moving, key=lambda entry: entry.sample.stamp_ns)
    path = write_scene(
        tmp_path / "tree.mcap",
        [tf_entry("/tf_static", start_ns, "/mount", "camera", inverse(pose(3))), *entries],
    )
    for frame, item in enumerate(observations(path, profile)):
        expected = np.eye(4)
        expected[0, 3] = 0.001 * (2 * frame - 0.05)
        assert item.T_camera_base is not None
        np.testing.assert_allclose(item.T_camera_base, pose(3) @ expected, atol=1e-12)

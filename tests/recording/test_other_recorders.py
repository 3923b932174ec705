"""Logs of other recorders hold the same scene; broken ones end in a result, a counted loss or a clear error."""

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from svmdist.errors import RecordingError
from svmdist.recording.log import open_recording
from tests.reading import read_observations

from .builders import Entry, pose, scene
from .other_recorders import (
    MCAP,
    SQLITE,
    WRITERS,
    header,
    rigid,
    ros_messages,
    write_ros2_mcap,
    write_rosbag1,
    write_rosbag2,
)


@pytest.fixture
def folder(tmp_path: Path, entries: list[Entry]) -> Path:
    """A rosbag2 folder with SQLite storage."""
    return write_rosbag2(tmp_path / "a", ros_messages(entries), SQLITE)


@pytest.mark.parametrize("recorder", WRITERS)
def test_the_same_scene_comes_out(tmp_path, native, entries, profile, recorder):
    """Also of files whose names say nothing of their format."""
    ours = open_recording(native, profile)
    theirs = open_recording(WRITERS[recorder](tmp_path, ros_messages(entries)), profile)
    for mine, other in zip(read_observations(ours), read_observations(theirs), strict=True):
        assert mine.stamp_ns == other.stamp_ns
        np.testing.assert_array_equal(mine.image_bgr, other.image_bgr)
        np.testing.assert_array_equal(mine.joints.positions, other.joints.positions)
    for name in ("K", "D", "P"):
        np.testing.assert_array_equal(getattr(ours.camera, name), getattr(theirs.camera, name))
    assert ours.camera.frame_id == theirs.camera.frame_id
    for ground_truth in (False, True):
        mine_track = ours.transform_track("camera", "tool", ground_truth=ground_truth)
        other_track = theirs.transform_track("camera", "tool", ground_truth=ground_truth)
        np.testing.assert_array_equal(mine_track.stamps_ns, other_track.stamps_ns)
        np.testing.assert_allclose(mine_track.T_parent_child, other_track.T_parent_child, atol=1e-15)
    np.testing.assert_allclose(
        ours.pose_track().T_parent_child, theirs.pose_track().T_parent_child, atol=1e-15
    )
    np.testing.assert_array_equal(ours.joint_track().positions, theirs.joint_track().positions)
    assert theirs.health.losses == ()
    assert len(theirs.sha256()) == 64


def test_a_stamped_transform_is_a_pose(tmp_path, profile):
    fields = {
        "header": header(7, "base"),
        "child_frame_id": "tool",
        "transform": rigid(pose(3), "translation", "rotation"),
    }
    messages = [("/PSM1/measured_cp", "geometry_msgs/msg/TransformStamped", fields, 7)]
    track = open_recording(write_ros2_mcap(tmp_path / "a.mcap", messages), profile).pose_track()
    assert (track.parent, track.stamps_ns.tolist()) == ("base", [7])
    np.testing.assert_allclose(track.T_parent_child[0], pose(3), atol=1e-15)


def test_a_bare_file_with_compressed_messages_says_to_open_the_folder(tmp_path, entries, profile):
    for storage, suffix in ((MCAP, "mcap"), (SQLITE, "db3")):
        folder = write_rosbag2(tmp_path / suffix, ros_messages(entries), storage, compressed=True)
        (bare,) = folder.glob(f"*.{suffix}")
        with pytest.raises(RecordingError, match="open the folder"):
            open_recording(bare, profile)


def test_a_cut_ros1_bag_names_the_command_that_repairs_it(tmp_path, profile):
    path = write_rosbag1(tmp_path / "a.bag", ros_messages(scene(20)))
    data = path.read_bytes()
    for size_bytes in (20, 4200, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:size_bytes])
        with pytest.raises(RecordingError, match=r"a ROS 1 bag that is .*rosbag reindex a\.bag$"):
            open_recording(path, profile)


def test_a_missing_part_of_a_folder_is_a_loss(folder, profile):
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("- a.db3", "- a.db3\n  - a_1.db3"))
    recording = open_recording(folder, profile)
    assert "a_1.db3" in recording.health.describe()[0]


def test_a_file_that_lacks_messages_is_a_loss(folder, profile):
    """SQLite delivers what is left without a word: the folder's counts show it."""
    with closing(sqlite3.connect(next(folder.glob("*.db3")))) as database:
        database.execute("DELETE FROM messages WHERE id > 20")
        database.commit()
    recording = open_recording(folder, profile)
    recording.joint_track()
    assert "declares" in recording.health.describe()[0]


def test_a_cut_database_is_refused_and_an_unmerged_one_is_a_loss(folder, profile):
    (file,) = folder.glob("*.db3")
    data = file.read_bytes()
    for size_bytes in (50, 5000, len(data) // 2, len(data) - 4000, len(data) - 1):
        file.write_bytes(data[:size_bytes])
        with pytest.raises(RecordingError, match=f"truncated at byte {size_bytes}"):
            open_recording(folder, profile)
    file.write_bytes(data)
    Path(f"{file}-wal").write_bytes(b"left")
    assert "a.db3-wal" in open_recording(folder, profile).health.describe()[0]


def test_an_unsupported_rosbag2_says_what_it_is(folder, profile):
    metadata = folder / "metadata.yaml"
    text = metadata.read_text()
    for changed, reason in (
        (text.replace("a.db3", "a.db3.zstd"), r"zstd -d a\.db3\.zstd"),
        (text.replace("a.db3", "a.other"), r"names, as a\.other; found a\.db3, metadata\.yaml"),
        ("a: [", "metadata.yaml is not usable"),
    ):
        metadata.write_text(changed)
        with pytest.raises(RecordingError, match=reason):
            open_recording(folder, profile)

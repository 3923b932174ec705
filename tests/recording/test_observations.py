"""Observations: right images, the believed base, any order in the file, and decoding in threads."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from svmdist.camera import Camera
from svmdist.errors import RecordingError
from svmdist.profile import Profile
from svmdist.recording.log import Recording, open_recording
from svmdist.recording.observations import EVERYTHING, LEFT_IMAGES, Needs
from svmdist.recording.source import LossKind
from svmdist.recording.writer import RecordingWriter, encode
from svmdist.samples import (
    CameraSample,
    ImageSample,
    Observation,
    Rejection,
    TransformSample,
    TransformsSample,
)
from svmdist.transforms import Array, inverse

from .builders import CAMERA, PERIOD_NS, Entry, pose, scene, write_messages, write_scene
from .faults import CHUNK_OPCODE, MAGIC_BYTES, join, split
from .test_video import KEY_INTERVAL, frame_image, packets  # noqa: F401  (a fixture)

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


CALIBRATION, IMAGE = "foxglove.CameraCalibration", "foxglove.CompressedImage"


def observed_in(
    recording: Recording, needs: Needs = EVERYTHING
) -> Iterator[tuple[Observation, ...] | Rejection]:
    """Decode one after another."""
    for one in recording.encoded_observations(recording.instruments, needs):
        yield recording.record_losses(one.decode())


def decoded_backwards(recording: Recording) -> Iterator[tuple[Observation, ...] | Rejection]:
    """Decode everything in threads, hand in the losses in reverse, and give the rest in order."""
    with ThreadPoolExecutor(3) as pool:
        decoded = list(
            pool.map(lambda one: one.decode(), recording.encoded_observations(recording.instruments))
        )
    found = [recording.record_losses(one) for one in reversed(decoded)]
    return reversed(found)


def assert_same(
    mine: tuple[Observation, ...] | Rejection, other: tuple[Observation, ...] | Rejection
) -> None:
    if isinstance(mine, Rejection) or isinstance(other, Rejection):
        assert mine == other
        return
    for one, two in zip(mine, other, strict=True):
        assert one.stamp_ns == two.stamp_ns
        np.testing.assert_array_equal(one.image_bgr, two.image_bgr)
        assert (one.joints is None) == (two.joints is None)
        if one.joints is not None and two.joints is not None:
            np.testing.assert_array_equal(one.joints.positions, two.joints.positions)
        assert (one.right is None) == (two.right is None)
        if one.right is not None and two.right is not None:
            np.testing.assert_array_equal(one.right.image_bgr, two.right.image_bgr)


def damaged(path: Path) -> Path:
    """A log of 60 images, every third of them broken in a way of its own, among joints that are broken too."""
    rows = [("/ECM/left/camera_info", CALIBRATION, "protobuf", encode(CameraSample(1, CAMERA)).data, 1)]
    rng = np.random.default_rng(3)
    for frame in range(60):
        good = encode(
            ImageSample(frame + 1, "camera", np.asarray(rng.integers(0, 256, (24, 32, 3)), np.uint8))
        ).data
        data = good
        if frame % 3 == 0:
            short = CompressedImage.FromString(good)
            short.data = short.data[: -20 - frame]
            data = short.SerializeToString()
        rows.append(("/ECM/left/image", IMAGE, "protobuf", data, frame + 1))
        joints = JointStates(joints=[{"name": "a", "position": float("nan") if frame % 4 == 0 else 1.0}])
        joints.timestamp.nanos = frame + 1
        message = joints.SerializeToString()
        rows.append(("/PSM1/measured_js", "foxglove.JointStates", "protobuf", message, frame + 1))
    return write_messages(path, rows)


@pytest.mark.parametrize("kind", ["pairs", "damaged"])
def test_threads_change_nothing(tmp_path: Path, profile: Profile, kind: str) -> None:
    """Losses are listed in file order whenever they are found."""
    path = tmp_path / "a.mcap"
    path = damaged(path) if kind == "damaged" else write_scene(path, with_right(scene(12)))
    one_by_one, ahead = open_recording(path, profile), open_recording(path, profile)
    pairs = zip(observed_in(one_by_one), decoded_backwards(ahead), strict=True)
    for mine, other in pairs:
        assert_same(mine, other)
    losses = one_by_one.health.losses
    assert {loss.kind for loss in losses} == (
        {LossKind.IMAGE, LossKind.MESSAGE} if kind == "damaged" else set()
    )
    assert ahead.health.losses == losses


def test_what_is_not_needed_is_checked_and_left_out(tmp_path: Path, profile: Profile) -> None:
    """A planar method gets images alone; a broken joint state is a loss all the same."""
    recording = open_recording(damaged(tmp_path / "a.mcap"), profile)
    found = list(observed_in(recording, LEFT_IMAGES))
    assert len(found) == 60
    assert all(item[0].joints is None for item in found if not isinstance(item, Rejection))
    assert {loss.topic for loss in recording.health.losses} == {"/ECM/left/image", "/PSM1/measured_js"}


def observed(path: Path, profile: Profile) -> tuple[list[int], int, bool]:
    """The stamps of the observations, how many have joints, and whether nothing was lost."""
    recording = open_recording(path, profile)
    found = [one for one in recording.observations() if isinstance(one, Observation)]
    return (
        [one.stamp_ns for one in found],
        sum(one.joints is not None for one in found),
        recording.health.is_clean,
    )


def test_a_log_that_was_appended_to_itself(tmp_path: Path, profile: Profile) -> None:
    """Every message stands there twice: the rows are those of the log, and the second images are told as lost."""
    entries = scene(20)
    once = observed(write_scene(tmp_path / "once.mcap", entries), profile)
    stamps_ns, with_joints, is_clean = observed(
        write_scene(tmp_path / "twice.mcap", entries + entries), profile
    )
    assert (stamps_ns, with_joints) == once[:2]
    assert once[2]
    assert not is_clean


def test_files_joined_byte_by_byte(tmp_path: Path, profile: Profile) -> None:
    """`cat a.mcap b.mcap`: what can be read of it comes once and in order, and the loss is told."""
    log = write_scene(tmp_path / "a.mcap", scene(20))
    both = tmp_path / "both.mcap"
    both.write_bytes(log.read_bytes() * 2)
    stamps_ns, _, is_clean = observed(both, profile)
    assert stamps_ns == observed(log, profile)[0]
    assert not is_clean


@pytest.mark.parametrize("first", range(3))
def test_chunks_that_changed_places(tmp_path: Path, profile: Profile, first: int) -> None:
    """Two neighbours of a log in chunks of a few frames: all rows are there, by stamp, with their joints."""
    log = tmp_path / "log.mcap"
    with RecordingWriter(log, {}) as writer:
        for number, entry in enumerate(scene(24)):
            if number and number % 30 == 0:  # three frames
                writer._writer.flush()
            writer.write(entry.topic, entry.sample)
    data = log.read_bytes()
    records = [(part.opcode, part.body) for part in split(data[:-MAGIC_BYTES])]
    chunks = [at for at, (opcode, _) in enumerate(records) if opcode == CHUNK_OPCODE]
    # The definitions stand in the first chunk: the others can be anywhere behind it.
    a, b = chunks[first + 1], chunks[first + 2]
    records[a], records[b] = records[b], records[a]
    swapped = tmp_path / "swapped.mcap"
    swapped.write_bytes(data[:MAGIC_BYTES] + join(records) + data[-MAGIC_BYTES:])
    assert observed(swapped, profile)[:2] == observed(log, profile)[:2]


def test_images_far_out_of_place_are_left_out(tmp_path: Path, profile: Profile) -> None:
    """One that comes seconds too late is a loss; those around it stay in order."""
    entries = scene(50)
    late = next(at for at, entry in enumerate(entries) if entry.topic == "/ECM/left/image")
    moved: list[Entry] = [*entries[:late], *entries[late + 1 :], entries[late]]
    stamps_ns, _, is_clean = observed(write_scene(tmp_path / "late.mcap", moved), profile)
    expected = observed(write_scene(tmp_path / "log.mcap", entries), profile)[0]
    assert stamps_ns == expected[1:]
    assert not is_clean

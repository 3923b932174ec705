"""Observations: right images, the believed base, any order in the file, and decoding in threads."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from svmdist import samples
from svmdist.errors import RecordingError
from svmdist.profile import Profile
from svmdist.recording.log import Recording, open_recording
from svmdist.recording.observations import ALL_IMAGES, Window
from svmdist.recording.source import LossKind
from svmdist.recording.summary import inspect_recording
from svmdist.recording.writer import RecordingWriter, encode
from svmdist.transforms import Array, inverse, make_transform
from tests.reading import read_observations
from tests.synthetic import right_of

from .builders import CAMERA, PERIOD_NS, Entry, pose, scene, write_messages, write_scene
from .faults import CHUNK_OPCODE, MAGIC_BYTES, join, split
from .test_video import KEY_INTERVAL, frame_image, packets  # noqa: F401  (a fixture)

BASELINE_M = 0.005
RIGHT_CAMERA = right_of(CAMERA, BASELINE_M)
RIGHT_IMAGE, RIGHT_INFO = "/ECM/right/image", "/ECM/right/camera_info"


def with_right(entries: list[Entry], shift_ns: int = 0, late: int = 0) -> list[Entry]:
    """Add a negative of every image as the right one, `late` entries behind it, and the right camera."""
    woven: list[Entry] = [Entry(RIGHT_INFO, samples.CameraSample(entries[0].sample.stamp_ns, RIGHT_CAMERA))]
    waiting: list[tuple[int, Entry]] = []
    for index, entry in enumerate(entries):
        woven.append(entry)
        if isinstance(entry.sample, samples.ImageSample):
            negative = np.asarray(255 - entry.sample.image_bgr, np.uint8)
            sample = samples.ImageSample(entry.sample.stamp_ns + shift_ns, "camera_right", negative)
            waiting.append((index + late, Entry(RIGHT_IMAGE, sample)))
        while waiting and waiting[0][0] <= index:
            woven.append(waiting.pop(0)[1])
    return woven + [entry for _, entry in waiting]


def observations(path: Path, profile: Profile, **topics: str) -> list[samples.Observation]:
    found = list(read_observations(open_recording(path, profile, topics=topics)))
    assert all(isinstance(item, samples.Observation) for item in found)
    return [item for item in found if isinstance(item, samples.Observation)]


@pytest.mark.parametrize(
    ("shift_ns", "late", "camera"),
    [
        (0, 0, RIGHT_CAMERA),
        (400_000, 1, RIGHT_CAMERA),
        (-500_000, 23, RIGHT_CAMERA),
        (600_000, 0, RIGHT_CAMERA),
        (0, 0, None),
        (0, 0, replace(RIGHT_CAMERA, P=CAMERA.P)),
    ],
    ids=["together", "later", "much later", "apart", "no camera", "no baseline"],
)
def test_right_images_find_their_left_ones(tmp_path, profile, shift_ns, late, camera):
    """Within half a millisecond, and up to seconds later in the file, of a calibration that has a baseline."""
    first, *entries = with_right(scene(), shift_ns, late)
    info = [] if camera is None else [Entry(RIGHT_INFO, samples.CameraSample(first.sample.stamp_ns, camera))]
    path = write_scene(tmp_path / "pair.mcap", info + entries)
    is_pair = shift_ns < 500_000 and camera is not None and camera.P is not CAMERA.P
    for item in observations(path, profile):
        assert (item.right is not None) == is_pair
        if item.right is None:
            continue
        np.testing.assert_array_equal(item.right.image_bgr, 255 - item.image_bgr)
        np.testing.assert_allclose(item.right.T_left_right[:3, 3], [BASELINE_M, 0.0, 0.0], atol=1e-15)
        np.testing.assert_array_equal(item.right.T_left_right[:3, :3], np.eye(3))
        assert item.right.camera.frame_id == "camera_right"
    unused = [line for line in open_recording(path, profile).remarks if "is not used: the log " in line]
    assert len(unused) == (camera is not RIGHT_CAMERA)


def test_what_images_lack_near_them_is_counted(tmp_path, profile):
    """Only of the images that are asked for; the nearest right image may come before or after."""
    lacking = [one for one in with_right(scene(), 600_000, 1) if one.sample.stamp_ns < 1_120_000_000]
    recording = open_recording(write_scene(tmp_path / "apart.mcap", lacking), profile)
    assert recording.remarks == []
    decoded(recording)
    near = "within 0.5 ms of the left (nearest 0.6 ms): measured with one camera"
    assert recording.remarks == [f"right image never {near}"]
    some = with_right(scene())
    del some[next(at for at, one in enumerate(some) if one.topic == RIGHT_IMAGE)]
    kept = [one for one in some if not ("_js" in one.topic and one.sample.stamp_ns > 1_060_000_000)]
    partly = open_recording(write_scene(tmp_path / "partly.mcap", kept), profile)
    decoded(partly)
    right, joints = partly.remarks
    assert (
        right == "in 1 of 5 frames no right image within 0.5 ms of the left (nearest 40 ms): measured with one camera"
    )
    assert joints == "in 3 of 5 frames no joint states on both sides of the image, 100 ms apart at most (nearest 60 ms)"
    decoded(partly, robot=False, right=False)
    assert partly.remarks == []


@pytest.mark.parametrize("is_planar", [False, True])
def test_an_image_has_the_calibration_that_holds_at_its_stamp(tmp_path, profile, is_planar):
    """A zoom between the third and the fifth image: of the fourth, whose message is missing, it is not known."""
    zoomed = replace(CAMERA, K=CAMERA.K * np.array([[1.25, 1, 1], [1, 1.25, 1], [1, 1, 1]]))
    entries = [one for one in scene() if one.topic != "/ECM/left/camera_info"]
    for frame, camera in ((0, CAMERA), (2, CAMERA), (4, zoomed)):
        info = samples.CameraSample(1_000_000_000 + frame * PERIOD_NS, camera)
        entries.append(Entry("/ECM/left/camera_info", info))
    entries.sort(key=lambda one: one.sample.stamp_ns)  # with each image, but after it in the file
    recording = open_recording(write_scene(tmp_path / "zoom.mcap", entries), profile)
    items = decoded(recording, **dict.fromkeys(("robot", "right", "rest"), not is_planar))
    unknown = items.pop(3)
    assert unknown.status is samples.Status.INCONSISTENT
    said = "focal length 29.3 px -> 36.6 px"
    assert unknown.detail == f"the camera changes about here: {said}"
    focal_px = [item[0].camera.K[0, 0] for item in items if not isinstance(item, samples.Rejection)]
    np.testing.assert_allclose(focal_px, CAMERA.K[0, 0] * np.array([1.0, 1.0, 1.0, 1.25]))
    assert recording.camera.K[0, 0] == CAMERA.K[0, 0]
    (change,) = recording.camera_changes
    assert recording.remarks == [f"the camera changes: {change}"]
    assert str(change) == f"{said} between 0.08 and 0.16 s (/ECM/left/camera_info)"
    (track,) = inspect_recording(recording).cameras.values()
    assert [str(one) for one in track.changes(change.topic)] == [str(change)]


def test_the_right_topics_leave_the_left_ones_to_be_found(tmp_path, profile):
    """By schema: what is named as right is no candidate, unless it is the only camera."""
    other = profile.model_copy(update={"topics": profile.topics.model_copy(update={"image": "/elsewhere"})})
    path = write_scene(tmp_path / "pair.mcap", with_right(scene()))
    recording = open_recording(path, other)
    assert recording.topic_of("image") == "/ECM/left/image"
    assert recording.topic_of("right_image") == RIGHT_IMAGE
    unnamed = profile.model_copy(update={"topics": type(profile.topics)()})
    with pytest.raises(RecordingError, match="several topics"):
        read_observations(open_recording(path, unnamed))
    topics = {"right_image": RIGHT_IMAGE, "right_camera_info": RIGHT_INFO}
    assert open_recording(path, unnamed, topics=topics).topic_of("image") == "/ECM/left/image"
    assert observations(path, unnamed, **topics)[0].right is not None
    lonely = [entry for entry in with_right(scene()) if not entry.topic.startswith("/ECM/left/")]
    path = write_scene(tmp_path / "lonely.mcap", lonely)
    assert open_recording(path, profile).topic_of("image") == RIGHT_IMAGE
    assert [item.right for item in observations(path, profile)] == [None] * 5


def test_the_believed_base_is_interpolated_along_the_tree(tmp_path, profile):
    """Camera to mount stands still, the base moves in the mount's frame; one edge is published backwards."""

    def along_x(x_m: float) -> Array:
        return make_transform(np.eye(3), [x_m, 0.0, 0.0])

    def edge(topic: str, stamp_ns: int, parent: str, child: str, T: Array) -> Entry:
        return Entry(topic, samples.TransformsSample(stamp_ns, (samples.TransformSample(stamp_ns, parent, child, T),)))

    entries = [entry for entry in scene() if entry.topic != "/tf"]
    start_ns = entries[0].sample.stamp_ns
    for step in range(-1, 12):
        stamp_ns = start_ns + step * PERIOD_NS // 2 + 1_000_000
        entries.append(edge("/tf", stamp_ns, "mount", "base", along_x(0.001 * step)))
    entries.sort(key=lambda entry: entry.sample.stamp_ns)
    static = edge("/tf_static", start_ns, "/mount", "camera", inverse(pose(3)))
    for frame, item in enumerate(observations(write_scene(tmp_path / "a.mcap", [static, *entries]), profile)):
        expected = pose(3) @ along_x(0.001 * (2 * frame - 0.05))
        np.testing.assert_allclose(item.T_camera_base, expected, atol=1e-12)


def damaged(path: Path) -> Path:
    """A log of 60 images, every third of them broken in one of three ways, among joints that are broken too."""
    entries = [Entry("/ECM/left/camera_info", samples.CameraSample(1, CAMERA))]
    rng = np.random.default_rng(3)
    for stamp_ns in range(1, 61):
        size = (10, 10, 3) if stamp_ns % 9 == 4 else (24, 32, 3)
        image = samples.ImageSample(stamp_ns, "camera", rng.integers(0, 256, size, np.uint8))
        position = float("nan") if stamp_ns % 4 == 1 else 1.0
        joints = samples.JointSample(stamp_ns, ("a",), np.array([position]))
        entries += [Entry("/ECM/left/image", image), Entry("/PSM1/measured_js", joints)]
    rows = []
    for topic, sample in entries:
        schema, data = encode(sample).schema, encode(sample).data
        if isinstance(sample, samples.ImageSample) and sample.stamp_ns % 9 == 1:
            short = CompressedImage.FromString(data)
            short.data = short.data[: -19 - sample.stamp_ns]
            data = short.SerializeToString()
        elif isinstance(sample, samples.ImageSample) and sample.stamp_ns % 9 == 7:
            data = b"\xff\xff"
        rows.append((topic, schema, "protobuf", data, sample.stamp_ns))
    return write_messages(path, rows)


def decoded(recording: Recording, **read: bool) -> list[tuple[samples.Observation, ...] | samples.Rejection]:
    """One after another."""
    encoded = recording.encoded_observations(**read)
    return [recording.record_losses(one.decode()) for one in encoded]


def test_losses_are_in_file_order_whenever_they_are_found(tmp_path, profile):
    """Images decoded in threads and handed in in reverse are those of one thread, and so are their losses."""
    path = damaged(tmp_path / "a.mcap")
    one_by_one, ahead = open_recording(path, profile), open_recording(path, profile)
    mine = decoded(one_by_one)
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(lambda one: one.decode(), ahead.encoded_observations()))
    others = [ahead.record_losses(one) for one in reversed(found)][::-1]
    for number, (one, other) in enumerate(zip(mine, others, strict=True)):
        assert isinstance(one, samples.Rejection) == (number % 3 == 0)
        if isinstance(one, samples.Rejection):
            assert one == other
            assert one.status is samples.Status.CORRUPT_IMAGE
        else:
            assert (one[0].stamp_ns, one[0].joints is None) == (other[0].stamp_ns, other[0].joints is None)
            np.testing.assert_array_equal(one[0].image_bgr, other[0].image_bgr)
    kinds = {(loss.kind, loss.topic) for loss in one_by_one.health.losses}
    assert kinds == {(LossKind.IMAGE, "/ECM/left/image"), (LossKind.MESSAGE, "/PSM1/measured_js")}
    assert ahead.health.losses == one_by_one.health.losses
    # A planar method gets images alone; a broken joint state is a loss all the same.
    planar = open_recording(path, profile)
    found = decoded(planar, robot=False, right=False)
    assert len(found) == 60
    assert all(item[0].joints is None for item in found if not isinstance(item, samples.Rejection))
    assert {loss.topic for loss in planar.health.losses} == {"/ECM/left/image", "/PSM1/measured_js"}


def raw(entry: Entry) -> tuple[str, str, str, bytes, int]:
    """A message; of an image a raw one."""
    stamp_ns, image = entry.sample.stamp_ns, getattr(entry.sample, "image_bgr", None)
    schema, data = encode(entry.sample).schema, encode(entry.sample).data
    if image is not None:
        whole = RawImage(width=32, height=24, encoding="bgr8", step=96, data=image.tobytes())
        schema, data = "foxglove.RawImage", whole.SerializeToString()
    return entry.topic, schema, "protobuf", data, stamp_ns


@pytest.mark.parametrize("is_raw", [False, True])
@pytest.mark.parametrize("frozen", ["/ECM/left/image", RIGHT_IMAGE])
def test_a_video_that_froze_shows_nothing_where_the_robot_has_moved(tmp_path, profile, frozen, is_raw):
    """Whichever images are wanted, with the robot or without; a still robot's, or that of none, is as good as any.

    So is an image that is late by a frame.
    """
    again = with_right(scene(8))
    images = [at for at, one in enumerate(again) if one.topic == frozen]
    held = again[images[2]].sample.image_bgr
    for at in (images[3], images[4], images[6]):  # the last one does not follow on what it repeats
        again[at] = Entry(frozen, replace(again[at].sample, image_bgr=held))

    def written(name: str, entries: list[Entry]) -> Recording:
        path = tmp_path / f"{name}.mcap"
        rows = [raw(one) for one in entries]
        whole = write_messages(path, rows) if is_raw else write_scene(path, entries)
        return open_recording(whole, profile)

    said = "the image repeats that of 0.08 s before to the last byte, and the robot has moved"
    recording = written("moves", again)
    whole, part = (0, 1, 2, 3, 4, 5, 6, 7), Window(1.5 * PERIOD_NS * 1e-9, every=2)
    for window, robot, numbers in (
        (ALL_IMAGES, True, whole),
        (ALL_IMAGES, False, whole),
        (part, True, (2, 4, 6)),
    ):
        seen = list(replace(recording, window=window).encoded_observations(robot=robot, stale=True))
        assert [one.number for one in seen] == list(numbers)
        refused = [one.decode().losses for one in seen] if frozen == RIGHT_IMAGE else [one.repeats for one in seen]
        assert [at for at, one in zip(numbers, refused, strict=True) if one] == [4]
    decoded(recording, stale=True)
    assert [one.detail for one in recording.health.losses] == [said] * (frozen == RIGHT_IMAGE)
    assert recording.remarks == []
    still = [
        one._replace(sample=replace(one.sample, positions=np.zeros(2))) if "_js" in one.topic else one for one in again
    ]
    none = [one for one in again if "_js" not in one.topic]
    remark = "images that repeat the one before them to the last byte: 2; the video stands still there"
    for name, others, remarks in (("still", still, []), ("none", none, [remark] * (frozen != RIGHT_IMAGE))):
        other = written(name, others)
        assert not any(one.repeats for one in other.encoded_observations(stale=True))
        assert (other.remarks, other.health.is_clean) == (remarks, True)


def observed(path: Path, profile: Profile) -> tuple[list[int], int, bool]:
    """The stamps of the observations, how many have joints, and whether nothing was lost."""
    recording = open_recording(path, profile)
    found = [one for one in read_observations(recording) if isinstance(one, samples.Observation)]
    return (
        [one.stamp_ns for one in found],
        sum(one.joints is not None for one in found),
        recording.health.is_clean,
    )


def test_files_joined_byte_by_byte(tmp_path, profile):
    """`cat a.mcap b.mcap`: what can be read of it comes once and in order, and the loss is told."""
    log = write_scene(tmp_path / "a.mcap", scene(20))
    both = tmp_path / "both.mcap"
    both.write_bytes(log.read_bytes() * 2)
    stamps_ns, _, is_clean = observed(both, profile)
    assert stamps_ns == observed(log, profile)[0]
    assert not is_clean


def test_a_log_that_was_appended_to_itself_and_an_image_far_out_of_place(tmp_path, profile):
    """Rows are those of the log, and second images are lost; so is one that comes seconds too late."""
    entries = scene(50)
    expected = observed(write_scene(tmp_path / "once.mcap", entries), profile)
    twice = observed(write_scene(tmp_path / "twice.mcap", entries + entries), profile)
    assert (twice, expected[2]) == ((*expected[:2], False), True)
    late = next(at for at, entry in enumerate(entries) if entry.topic == "/ECM/left/image")
    moved = [*entries[:late], *entries[late + 1 :], entries[late]]
    stamps_ns, _, is_clean = observed(write_scene(tmp_path / "late.mcap", moved), profile)
    assert (stamps_ns, is_clean) == (expected[0][1:], False)


@pytest.mark.parametrize("first", range(3))
def test_chunks_that_changed_places(tmp_path, profile, first):
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

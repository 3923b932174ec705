"""Import: what is in the files is in the log, byte by byte where that is possible."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from svmdist.camera import stereo_transform
from svmdist.errors import SourceError, UsageError
from svmdist.importing.calibration import CalibrationOptions
from svmdist.profile import load_profile
from svmdist.recording.log import Recording, open_recording
from svmdist.recording.messages import message_class
from svmdist.samples import Image, ImageSample, Observation
from svmdist.workflows.check import ViewsCompared
from svmdist.workflows.import_log import ImportOptions, import_log
from tests.reading import read_images, read_observations

CAMERA = (60.0, 61.0, 31.0, 23.0)
PAIR = CalibrationOptions(intrinsics=(CAMERA, None), baseline_m=0.005)
ONE = CalibrationOptions(intrinsics=(CAMERA, None))


def _picture(seed: int, width: int = 64) -> Image:
    return np.random.default_rng(seed).integers(0, 256, (48, width, 3), np.uint8)


def _open(path: Path) -> Recording:
    return open_recording(path, load_profile())


def _images(recording: Recording) -> list[ImageSample]:
    return [image for image in read_images(recording) if isinstance(image, ImageSample)]


def _messages(path: Path, topic: str) -> list[bytes]:
    raws = [raw for raw in _open(path).file.source.messages() if raw.topic == topic]
    return [message_class(raw.schema).FromString(raw.data).data for raw in raws]


@pytest.mark.parametrize("ends", [("_L.jpg", "_R.png"), ("_cam0.jpg", "_cam1.png")])
def test_two_views_pass_through(tmp_path, ends):
    """Files of both views are in the log as they are, paired by number, with stamps and a baseline."""
    for number in (1, 2, 10):
        for side, end in enumerate(ends):
            cv2.imwrite(str(tmp_path / f"{number}{end}"), _picture(100 * side + number))
    patterns = [f"*{end}" for end in ends]
    options = ImportOptions(tmp_path, PAIR, None, *patterns, rate_hz=4.0, start_ns=10**9)
    result = import_log(options, tmp_path / "out.mcap")
    assert result.counts["/ECM/left/image"] == result.counts["/ECM/right/image"] == 3
    assert result.has_baseline is True
    for side, end in zip(("left", "right"), ends, strict=True):
        expected = [(tmp_path / f"{number}{end}").read_bytes() for number in (1, 2, 10)]
        assert _messages(result.path, f"/ECM/{side}/image") == expected
    recording = _open(result.path)
    observations = [one for one in read_observations(recording) if isinstance(one, Observation)]
    assert [one.stamp_ns for one in observations] == [10**9, 10**9 + 250_000_000, 10**9 + 500_000_000]
    assert all(one.right is not None for one in observations)
    T_left_right = stereo_transform(recording.camera, recording.right_camera)
    assert T_left_right[0, 3] == pytest.approx(0.005, abs=1e-12)
    assert recording.health.is_clean


@pytest.mark.parametrize("crop", [None, (10, 5, 40, 30)])
def test_side_by_side(tmp_path, crop):
    """Each half is a view, or a part of it with its camera, without loss."""
    both = [_picture(number, 128) for number in range(2)]
    for number, image in enumerate(both):
        cv2.imwrite(str(tmp_path / f"img{number}.png"), image)
    options = ImportOptions(tmp_path, ONE, side_by_side=True, rate_hz=1.0, crop=crop)
    result = import_log(options, tmp_path / "out.mcap")
    assert result.has_baseline is False
    recording = _open(result.path)
    rights = _messages(result.path, "/ECM/right/image")
    x, y, width, height = crop or (0, 0, 64, 48)
    for left, data, image in zip(_images(recording), rights, both, strict=True):
        right = cv2.imdecode(np.frombuffer(data, np.uint8), 1)
        for found, half in ((left.image_bgr, image[:, :64]), (right, image[:, 64:])):
            np.testing.assert_array_equal(found, half[y : y + height, x : x + width])
    assert (recording.camera.width_px, recording.camera.height_px) == (width, height)
    np.testing.assert_allclose(recording.camera.K[:2, 2], [CAMERA[2] - x, CAMERA[3] - y])


def test_other_formats_are_decoded(tmp_path):
    """BMP, TIFF and grey images become PNG with the same pixels; one of 16 bits is left out."""
    pixels = [_picture(1), _picture(2), np.repeat(_picture(3)[..., :1], 3, axis=2)]
    for name, image in zip(("a1.bmp", "a2.tiff", "b1.pgm"), pixels, strict=True):
        cv2.imwrite(str(tmp_path / name), image[..., 0] if name.endswith("pgm") else image)
    cv2.imwrite(str(tmp_path / "b2.tiff"), _picture(4).astype(np.uint16))
    result = import_log(ImportOptions(tmp_path, ONE, rate_hz=1.0), tmp_path / "out.mcap")
    assert result.losses == [f"{tmp_path / 'b2.tiff'}: an image of 16 bits; 8 are expected"]
    for found, expected in zip(_images(_open(result.path)), pixels, strict=True):
        np.testing.assert_array_equal(found.image_bgr, expected)


def test_stamps_of_names_poses_and_joints(tmp_path):
    """Stamps come from names; tables of poses and joints meet the images, each instrument under its name."""
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{1_700_000_000 + number}.500000000.png"), _picture(number))
    poses = "".join(f"0.0{n},0,0.1,0,0,0,1\n" for n in range(3))
    (tmp_path / "poses.csv").write_text(f"x,y,z,qx,qy,qz,qw\n{poses}")
    (tmp_path / "joints.csv").write_text("".join(f"0.{n} 0.2\n" for n in range(3)))
    options = ImportOptions(
        tmp_path,
        ONE,
        poses={"PSM2": tmp_path / "poses.csv"},
        joints={"PSM1": tmp_path / "joints.csv"},
        joint_names=("yaw", "pitch"),
    )
    recording = _open(import_log(options, tmp_path / "out.mcap").path)
    stamps = [(1_700_000_000 + number) * 10**9 + 500_000_000 for number in range(3)]
    observations = [one for one in read_observations(recording) if isinstance(one, Observation)]
    assert [one.stamp_ns for one in observations] == stamps
    joints = [one.joints.positions.tolist() for one in observations if one.joints]
    assert joints == [[0.0, 0.2], [0.1, 0.2], [0.2, 0.2]]
    poses = recording.for_instrument("PSM2").pose_track()
    assert poses.parent == "PSM2_base"
    assert poses.stamps_ns.tolist() == stamps
    np.testing.assert_allclose(poses.T_parent_child[:, 0, 3], [0.0, 0.01, 0.02])


def test_times_that_may_be_wrong_are_said(tmp_path):
    """Numbers that are missing among images of one rate, and rows near few of them; hidden files are no images."""
    for number in (1, 2, 4):
        cv2.imwrite(str(tmp_path / f"{number}.png"), _picture(number))
    (tmp_path / "._1.png").write_bytes(b"of macOS")
    (tmp_path / "joints.csv").write_text("timestamp,yaw\n0,0.1\n1000,0.2\n2000,0.3\n")
    options = ImportOptions(tmp_path, ONE, rate_hz=1.0, joints={"PSM1": tmp_path / "joints.csv"})
    rows, numbers = import_log(options, tmp_path / "out.mcap").warnings
    assert "rows are within 0.1 s of only 1 of 3 images: its times are 0.000 s to 2000.000 s" in rows
    assert "numbers are missing, as between 2.png and 4.png" in numbers


def test_own_stamps_of_both_views(tmp_path):
    """Where the names of both views tell times, each image keeps its own."""
    for side, offset in (("left", 0), ("right", 200_000)):
        (tmp_path / side).mkdir()
        for number in range(2):
            stamp = 1_700_000_000_000_000_000 + number * 40_000_000 + offset
            cv2.imwrite(str(tmp_path / side / f"{stamp}.png"), _picture(number))
    options = ImportOptions(tmp_path / "left", PAIR, tmp_path / "right")
    recording = _open(import_log(options, tmp_path / "out.mcap").path)
    stamps = {
        topic: [raw.log_time_ns for raw in recording.file.source.messages() if raw.topic == topic]
        for topic in ("/ECM/left/image", "/ECM/right/image")
    }
    assert stamps["/ECM/right/image"] == [stamp + 200_000 for stamp in stamps["/ECM/left/image"]]


def _write_video(
    path: Path, codec: str, pixels: str, images: Sequence[Image], dropped: int | None = None
) -> list[bytes]:
    """Write images but a dropped one with a key frame every four, and give their packets."""
    av, packets = pytest.importorskip("av"), []
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt, stream.codec_context.gop_size = 64, 48, pixels, 4
        stream.options = {"sc_threshold": "1000000000"}  # none where the scene changes
        for place, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(image, format="bgr24").reformat(format=pixels)
            frame.pts = place
            encoded = [] if place == dropped else stream.encode(frame)
            packets += map(bytes, encoded)
            container.mux(encoded)
        container.mux(stream.encode())
    return packets


def test_video(tmp_path):
    """A video's images and times are in the log; lossless video without a bit of difference."""
    images = [_picture(number) for number in range(5)]
    path = tmp_path / "endoscope.mkv"
    _write_video(path, "ffv1", "bgr0", images)
    result = import_log(ImportOptions(path, ONE, start_ns=7 * 10**9, every=2), tmp_path / "out.mcap")
    found = _images(_open(result.path))
    assert [image.stamp_ns for image in found] == [7 * 10**9, 7_080_000_000, 7_160_000_000]
    for image, place in zip(found, (0, 2, 4), strict=True):
        np.testing.assert_array_equal(image.image_bgr, images[place])


@pytest.mark.parametrize(
    ("damage", "places", "said"),
    [
        ("none", range(12), []),
        ("dropped", (0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11), []),  # by the recorder: AVI counts it
        ("cut", range(6), ["damaged or cut at image 7 of 12; 6 left out"]),
        ("damaged", (0, 1, 2, 3, 4, 8, 9, 10, 11), ["damaged or cut at image 6 of 12; 3 left out"]),
    ],
)
def test_what_is_damaged_of_a_video_is_left_out(tmp_path, damage, places, said):
    """All that is whole is in the log at its time, and nothing up to the next key frame; the loss is told."""
    path = tmp_path / "a.avi"
    images = [np.full((48, 64, 3), 20 * n, np.uint8) for n in range(12)]
    packets = _write_video(path, "mpeg4", "yuv420p", images, 5 if damage == "dropped" else None)
    data = path.read_bytes()
    if damage == "cut":
        data = data[: data.index(packets[6]) + len(packets[6]) // 2]
    if damage == "damaged":
        data = data.replace(packets[5], bytes(len(packets[5])))
    path.write_bytes(data)
    result = import_log(ImportOptions(path, ONE), tmp_path / "out.mcap")
    assert result.losses == [f"{path}: {one}" for one in said]
    found = _images(_open(result.path))
    assert [image.stamp_ns for image in found] == [40_000_000 * place for place in places]
    for image, place in zip(found, places, strict=True):
        assert abs(image.image_bgr.mean() - 20 * place) < 10
    for packet in packets:
        data = data.replace(packet, bytes(len(packet)))
    path.write_bytes(data)
    with pytest.raises(SourceError, match=r"damaged or cut at image 1 of 1[12]; 1[12] left out"):
        import_log(ImportOptions(path, ONE), tmp_path / "none.mcap")
    assert not (tmp_path / "none.mcap").exists()


@pytest.mark.parametrize(
    ("kind", "crop", "said"),
    [
        ("cut", None, "a PNG that ends early"),
        ("text", None, "not an image that can be decoded"),
        ("16", None, "a PNG of 16 bits"),
        ("grey", None, None),  # a file is stored as it is
        ("grey", (0, 0, 32, 32), "premature end of data"),
    ],
)
@pytest.mark.parametrize("damaged", ["1_L.png", "2_R.png"])
def test_a_damaged_image_is_left_out(tmp_path, monkeypatch, damaged, kind, crop, said):
    """The others keep their stamps and their partners."""
    for name in (f"{number}_{side}.png" for number in (1, 2, 3) for side in "LR"):
        cv2.imwrite(str(tmp_path / name), _picture(int(name[0])))
    _write(tmp_path / damaged, kind)
    pairs: list[Observation] = []
    seen = ViewsCompared()
    monkeypatch.setattr("svmdist.workflows.import_log.compare_views", lambda few, _: pairs.extend(few) or seen)
    result = import_log(ImportOptions(tmp_path, **PAIRED, crop=crop), tmp_path / "out.mcap")
    assert len(result.losses) == (said is not None)
    assert all(loss.startswith(f"{tmp_path / damaged}: ") and said in loss for loss in result.losses)
    places = [place for place in range(3) if place != int(damaged[0]) - 1]
    assert [one.stamp_ns for one in pairs] == [10**9 * place for place in places]
    for pair in pairs:
        np.testing.assert_array_equal(pair.image_bgr, pair.right.image_bgr)
    for side in ("left", "right"):
        is_lost = said is not None and side[0].upper() in damaged
        assert result.counts[f"/ECM/{side}/image"] == (2 if is_lost else 3)


PAIRED = {"pattern": "*_L.png", "right_pattern": "*_R.png", "rate_hz": 1.0, "calibration": PAIR}
ALL = {"pattern": "*.png"}
WRONG: dict[str, tuple[object, ...]] = {
    "empty": ("", "no images"),
    "parent": ("left/1.png,right/1.png", "found the folders left, right: give one, or one for each view"),
    "no times": ("1_L.png,2_L.png", "has no time", {"rate_hz": None}),
    "no camera": ("1.png", "a camera needs a calibration", {"calibration": CalibrationOptions()}),
    "lonely": ("1_L.png,2_L.png,1_R.png", "2_L.png: there is no right image", PAIRED),
    "size": ("1_L.png,2_L.png,1_R.png,2_R.png 60", "60x48 px; 1_R.png has 64x48 px", PAIRED),
    "two sizes": (
        "1_L.png,2_L.png,1_R.png 60,2_R.png 60",
        "views of 64x48 and 60x48 px, and one camera for both",
        PAIRED,
    ),
    "start": ("1700000000.500.png", "--start goes with --rate or a video", {"rate_hz": None, "start_ns": 1}),
    "all damaged": ("1.png 16,2.png cut", "images/1.png: a PNG of 16 bits"),
    "same": ("1_L.png,2_L.png", "the same images", {"right_pattern": "*_L.png"}),
    "both views": ("1_L.png,2_L.png,1_R.png", "1_L.png and 1_R.png are of two views", ALL),
    **{
        f"both views by {a}": (
            f"01_{a}.png,01_{b}.png,02_{a}.png,02_{b}.png",
            f"01_{a}.png and 01_{b}.png are of two views",
        )
        for a, b in (("cam0", "cam1"), ("cam1", "cam2"), ("0", "1"))
    },
    "one number": ("1_L.png,2_L.png,a2_L.png,1_R.png", "2_L.png and a2_L.png have one last number", PAIRED),
    "masks": (
        "1.png,1_mask.png",
        "1.png and 1_mask.png have the same number: choose images of one kind by --pattern",
    ),
    "broken link": ("1.png link", "1.png: cannot read: No such file or directory: it is a"),
    "both times": (
        "1700000000.500_left.png,1700000000.503_right.png",
        "are of two views: choose those of one by --pattern",
        {"rate_hz": None},
    ),
    "pattern": ("1.png", "expected a pattern of names, as *_L.png, found '.'", {"pattern": "."}),
    "odd": ("1.png 65", "65 px wide", {"side_by_side": True}),
    "no folder": ("1.png", "no such folder", {"source": "nowhere"}),
    "glob": ("1.png", "no such folder or video: give the folder, and --pattern", {"source": "*.png"}),
    "no video": ("a.mp4 text", "a.mp4: neither an image nor a video that can be read", {"source": "a.mp4"}),
}
"""Files, each with what is wrong of it, the error, and other options than 1 Hz and one camera."""


def _write(path: Path, kind: str) -> None:
    path.parent.mkdir(exist_ok=True)
    if kind == "link":
        path.symlink_to("nowhere.png")
        return
    image = _picture(1, int(kind) if kind in ("60", "65") else 64)
    data = cv2.imencode(".png", image.astype(np.uint16) if kind == "16" else image)[1].tobytes()
    if kind == "grey":  # whole by its marks, and half of it is not there
        data = cv2.imencode(".jpg", image)[1].tobytes()
        data = data[: len(data) // 2] + data[-2:]
    path.write_bytes(b"no image" * 50 if kind == "text" else data[:-30] if kind == "cut" else data)


@pytest.mark.parametrize("kind", WRONG)
def test_wrong_files(tmp_path, kind):
    """What does not fit is one line that names it, and leaves no log behind."""
    files, said, *views = WRONG[kind]
    folder, output = tmp_path / "images", tmp_path / "out.mcap"
    folder.mkdir()
    for name, _, wrong in (one.partition(" ") for one in files.split(",") if one):
        _write(folder / name, wrong)
    options = {"rate_hz": 1.0, "calibration": ONE, "source": ".", **(views[0] if views else {})}
    options = ImportOptions(**options | {"source": folder / options["source"]})
    with pytest.raises((SourceError, UsageError)) as caught:
        import_log(options, output)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == [folder]

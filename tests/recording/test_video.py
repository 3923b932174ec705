"""Video: every frame in order, and after a loss nothing until the next key frame."""

from fractions import Fraction

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo

from svmdist.recording.images import ImageError, VideoDecoder
from svmdist.recording.log import open_recording
from svmdist.samples import ImageSample
from tests.reading import read_images

from .builders import write_messages

av = pytest.importorskip("av")
FRAME_COUNT, KEY_INTERVAL = 24, 8


def frame_image(number: int) -> np.ndarray:
    """A bright square that moves over a grey ground."""
    image = np.full((96, 128, 3), 60, np.uint8)
    image[30:60, 4 * number : 4 * number + 30] = (40, 200, 90)
    return image


def encoded(frame_count: int = FRAME_COUNT, pixels: str = "yuv420p", **options: str) -> list[bytes]:
    """The square in H.264, one packet a frame, a key frame every eight."""
    try:
        codec = av.CodecContext.create("libx264", "w")
    except ValueError:
        pytest.skip("this build of FFmpeg has no H.264 encoder")
    codec.width, codec.height, codec.pix_fmt, codec.time_base = 128, 96, pixels, Fraction(1, 25)
    codec.gop_size = KEY_INTERVAL
    basic = {"preset": "veryfast", "tune": "zerolatency", "crf": "12", "bf": "0", "sc_threshold": "0"}
    codec.options = basic | options
    found = []
    for number in range(frame_count):
        frame = av.VideoFrame.from_ndarray(frame_image(number), format="bgr24").reformat(format=pixels)
        frame.pts = number
        found += [bytes(packet) for packet in codec.encode(frame)]
    found += [bytes(packet) for packet in codec.encode(None)]
    assert len(found) == frame_count
    return found


@pytest.fixture(scope="module")
def packets() -> list[bytes]:
    return encoded()


@pytest.mark.parametrize("damage", ["none", "cut", "no message", "garbage", "begins late", "missing"])
def test_after_a_broken_frame_nothing_until_the_next_key_frame(tmp_path, profile, packets, damage):
    """Nor of a stream that begins between key frames; every other frame comes out in order."""
    messages = [CompressedVideo(data=data, format="h264").SerializeToString() for data in packets]
    garbage = CompressedVideo(data=b"\0\0\1\x41" + bytes(range(50)), format="h264")
    cut = CompressedVideo(data=packets[11][:9], format="h264")
    broken = {"cut": cut.SerializeToString(), "no message": b"\xff", "garbage": garbage.SerializeToString()}
    messages[11] = broken.get(damage, messages[11])
    first = 3 if damage == "begins late" else 0
    rows = [
        ("/video", "foxglove.CompressedVideo", "protobuf", data, number)
        for number, data in enumerate(messages[first:], first + 1)
        if damage != "missing" or number != 12
    ]
    path = write_messages(tmp_path / "a.mcap", rows)
    images = list(read_images(open_recording(path, profile, topics={"image": "/video"})))
    lost = range(3, 8) if first else range(0) if damage == "none" else range(11, 16)
    assert len(images) == len(rows)
    for (*_, log_time_ns), image in zip(rows, images, strict=True):
        number = log_time_ns - 1
        assert isinstance(image, ImageSample) == (number not in lost)
        if isinstance(image, ImageSample):
            assert image.stamp_ns == number + 1
            assert np.abs(image.image_bgr.astype(int) - frame_image(number)).mean() < 4


@pytest.mark.parametrize(
    "options",
    [
        {"profile": "baseline"},
        {"profile": "main", "refs": "4", "x264-params": "slices=4:aud=1"},
        {"profile": "high", "x264-params": "cqm=jvt:nal-hrd=vbr:vbv-maxrate=2000:vbv-bufsize=2000"},
        {"x264-params": "cqm=jvt", "pixels": "yuv444p"},
        {"x264-params": "interlaced=1"},
    ],
    ids=["baseline", "slices", "high", "4:4:4", "interlaced"],
)
def test_a_missing_frame_shows_in_streams_of_any_kind_and_none_is_missing_in_a_whole_one(capfd, profile, options):
    """FFmpeg makes up for it without a word, and its pictures are wrong up to the next key frame."""
    whole = encoded(40, **options, g="25")
    for lost in (range(0), range(3, 4), range(10, 14), range(4, 19)):
        video, refused = VideoDecoder(profile.limits), []
        for number, data in enumerate(whole):
            if number in lost:
                continue
            try:
                video.decode("h264", data, 0)
            except ImageError:
                refused.append(number)
        assert refused == (list(range(lost.stop, 25)) if lost else [])
    assert capfd.readouterr() == ("", "")


def test_a_key_frame_that_comes_again_is_known_for_one(tmp_path, profile):
    """Each image says since when its data have been the same."""
    whole = encoded(5, g="1")
    rows = [
        (
            "/video",
            "foxglove.CompressedVideo",
            "protobuf",
            CompressedVideo(data=whole[at], format="h264"),
            number,
        )
        for number, at in enumerate([0, 1, 1, 1, 4], 1)
    ]
    path = write_messages(tmp_path / "a.mcap", [(*row[:3], row[3].SerializeToString(), row[4]) for row in rows])
    images = open_recording(path, profile, topics={"image": "/video"}).file.images({"/video"})
    assert [(one.since_ns, one.decode().shape) for one in images] == [
        (since, (96, 128, 3)) for since in (1, 2, 2, 2, 5)
    ]

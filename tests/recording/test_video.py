"""Video: every frame in order, and after a loss nothing until the next key frame."""

from fractions import Fraction

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo

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


@pytest.fixture(scope="module")
def packets() -> list[bytes]:
    """The square in H.264, one packet a frame, a key frame every eight."""
    try:
        codec = av.CodecContext.create("libx264", "w")
    except ValueError:
        pytest.skip("this build of FFmpeg has no H.264 encoder")
    codec.width, codec.height, codec.pix_fmt, codec.time_base = 128, 96, "yuv420p", Fraction(1, 25)
    codec.gop_size = KEY_INTERVAL
    codec.options = {"preset": "veryfast", "tune": "zerolatency", "crf": "12", "bf": "0", "sc_threshold": "0"}
    found = []
    for number in range(FRAME_COUNT):
        frame = av.VideoFrame.from_ndarray(frame_image(number), format="bgr24")
        frame.pts = number
        found += [bytes(packet) for packet in codec.encode(frame)]
    found += [bytes(packet) for packet in codec.encode(None)]
    assert len(found) == FRAME_COUNT
    return found


@pytest.mark.parametrize("damage", ["none", "cut", "no message", "garbage", "begins late"])
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
    ]
    path = write_messages(tmp_path / "a.mcap", rows)
    images = list(read_images(open_recording(path, profile, topics={"image": "/video"})))
    lost = range(3, 8) if first else range(11, 16) if damage in broken else range(0)
    assert len(images) == FRAME_COUNT - first
    for number, image in enumerate(images, first):
        assert isinstance(image, ImageSample) == (number not in lost)
        if isinstance(image, ImageSample):
            assert image.stamp_ns == number + 1
            assert np.abs(image.image_bgr.astype(int) - frame_image(number)).mean() < 4

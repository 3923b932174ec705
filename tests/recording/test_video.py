"""Video: every frame in order, and after a loss nothing until the next key frame."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo

from svmdist.profile import Profile
from svmdist.recording.log import open_recording
from svmdist.samples import ImageSample, Rejection

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


def read_back(path: Path, profile: Profile, packets: list[bytes]) -> list[ImageSample | Rejection]:
    """Write packets as a recording and read the images."""
    rows = [
        ("/video", "foxglove.CompressedVideo", "protobuf", video(data), number + 1)
        for number, data in enumerate(packets)
    ]
    return list(open_recording(write_messages(path, rows), profile, topics={"image": "/video"}).images())


def video(data: bytes) -> bytes:
    """Make a message."""
    return data if data == b"\xff" else CompressedVideo(data=data, format="h264").SerializeToString()


def test_every_frame_comes_out_in_order(tmp_path: Path, profile: Profile, packets: list[bytes]) -> None:
    images = read_back(tmp_path / "a.mcap", profile, packets)
    for number, image in enumerate(images):
        assert isinstance(image, ImageSample)
        assert image.stamp_ns == number + 1
        assert np.abs(image.image_bgr.astype(int) - frame_image(number)).mean() < 4


@pytest.mark.parametrize("damage", ["cut", "no message", "garbage"])
def test_after_a_broken_frame_nothing_until_the_next_key_frame(
    tmp_path: Path, profile: Profile, packets: list[bytes], damage: str
) -> None:
    broken = {"cut": packets[11][:9], "no message": b"\xff", "garbage": b"\0\0\1\x41" + bytes(range(50))}[
        damage
    ]
    images = read_back(tmp_path / "a.mcap", profile, [*packets[:11], broken, *packets[12:]])
    kinds = [isinstance(image, ImageSample) for image in images]
    assert kinds == [True] * 11 + [False] * 5 + [True] * 8
    for number in (*range(11), *range(16, 24)):
        assert np.abs(images[number].image_bgr.astype(int) - frame_image(number)).mean() < 4  # type: ignore[union-attr]


def test_a_stream_that_begins_between_key_frames_waits(
    tmp_path: Path, profile: Profile, packets: list[bytes]
) -> None:
    images = read_back(tmp_path / "a.mcap", profile, packets[3:])
    assert [isinstance(image, ImageSample) for image in images] == [False] * 5 + [True] * 16

"""The decoder of one video stream: nothing is shown before a key frame, and nothing after a loss."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from svmdist.errors import RecordingError
from svmdist.profile import Limits
from svmdist.recording.images import IDR_SLICE, NAL_UNIT, ImageError, VideoDecoder
from tests.recording.test_video import FRAME_COUNT, KEY_INTERVAL, frame_image, packets

__all__ = ["packets"]
NOISE = 4
"""Mean error that is still H.264's own, of 255; another frame's square differs by more."""


def is_frame(image: np.ndarray, number: int) -> bool:
    """Whether an image is the frame of a number."""
    return bool(np.abs(image.astype(int) - frame_image(number)).mean() < NOISE)


def is_key(packet: bytes) -> bool:
    """Whether a packet holds a slice of a key frame."""
    return any(match[1][0] & 0x1F == IDR_SLICE for match in NAL_UNIT.finditer(packet))


def test_key_frames_are_found_in_the_bytes(packets: list[bytes]) -> None:
    """Every eighth packet, as the encoder was told."""
    keys = [number for number, packet in enumerate(packets) if is_key(packet)]
    assert keys == list(range(0, FRAME_COUNT, KEY_INTERVAL))


def test_frames_come_out_in_order(packets: list[bytes]) -> None:
    decoder = VideoDecoder(Limits())
    for number, packet in enumerate(packets):
        image = decoder.decode("h264", packet, 0)
        assert image.dtype == np.uint8
        assert is_frame(image, number)


def test_when_losses_have_grown_the_next_key_frame_is_waited_for(packets: list[bytes]) -> None:
    """The count is that of the moment: one that stays the same is no new loss."""
    decoder = VideoDecoder(Limits())
    for number, packet in enumerate(packets):
        loss_count = 1 if number >= 3 else 0
        if 3 <= number < KEY_INTERVAL:
            with pytest.raises(ImageError, match="no key frame yet"):
                decoder.decode("h264", packet, loss_count)
        else:
            assert is_frame(decoder.decode("h264", packet, loss_count), number)


@pytest.mark.parametrize("failure", ["format", "size", "garbage"])
def test_after_a_frame_that_fails_a_key_frame_is_waited_for(packets: list[bytes], failure: str) -> None:
    """The next frames refer to the one that is missing, whatever the reason for which it was refused."""
    limits = Limits(image_bytes=len(packets[0]) + 1024)
    video_format, data, reason = {
        "format": ("h265", packets[1], "'h265' is not known; h264 is expected"),
        "size": ("h264", packets[1] + bytes(limits.image_bytes), "the limit is"),
        "garbage": ("h264", b"\0\0\1\x41" + bytes(50), "does not decode|one is expected"),
    }[failure]
    decoder = VideoDecoder(limits)
    assert is_frame(decoder.decode("h264", packets[0], 0), 0)
    with pytest.raises(ImageError, match=reason):
        decoder.decode(video_format, data, 0)
    for number in range(2, KEY_INTERVAL):
        with pytest.raises(ImageError, match="no key frame yet"):
            decoder.decode("h264", packets[number], 0)
    for number in range(KEY_INTERVAL, KEY_INTERVAL + 3):
        assert is_frame(decoder.decode("h264", packets[number], 0), number)


def test_a_picture_above_the_limit_is_refused(packets: list[bytes]) -> None:
    """By its dimensions, 128 x 96 px."""
    with pytest.raises(ImageError):
        VideoDecoder(Limits(image_pixels=128 * 96 - 1)).decode("h264", packets[0], 0)
    assert is_frame(VideoDecoder(Limits(image_pixels=128 * 96)).decode("h264", packets[0], 0), 0)


@pytest.mark.parametrize("data", [b"", b"\0\0\1", b"\0\0\1\x65", b"\0\0\1\x65" + bytes(100)], ids=range(4))
def test_bytes_that_are_no_video_give_no_picture(data: bytes) -> None:
    with pytest.raises(ImageError):
        VideoDecoder(Limits()).decode("h264", data, 0)


def test_without_the_package_the_extra_is_named(
    packets: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(RecordingError, match=r"svmdist\[video\]"):
        VideoDecoder(Limits()).decode("h264", packets[0], 0)

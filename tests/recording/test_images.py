"""Compressed stills: whole and true, or refused; never a wrong pixel."""

from __future__ import annotations

import random

import cv2
import numpy as np
import pytest

from svmdist.profile import Limits
from svmdist.recording.images import ImageError, decode_still

from .faults import flip_bit

IMAGE = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 256, (48, 64, 3), np.uint8), (0, 0), 2)


def encode(suffix: str, image: np.ndarray) -> bytes:
    """Compress an image."""
    return cv2.imencode(suffix, image)[1].tobytes()


PNG = encode(".png", IMAGE)
JPEG = encode(".jpg", IMAGE)


def test_png_is_lossless_and_jpeg_near() -> None:
    np.testing.assert_array_equal(decode_still(PNG, Limits()), IMAGE)
    assert np.abs(decode_still(JPEG, Limits()).astype(int) - IMAGE).mean() < 3
    padded = JPEG + bytes(10)
    np.testing.assert_array_equal(decode_still(padded, Limits()), decode_still(JPEG, Limits()))


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "found nothing"),
        (b"GIF89a" + bytes(20), "expected a PNG or JPEG"),
        (encode(".bmp", IMAGE), "expected a PNG or JPEG"),
        (encode(".png", IMAGE.astype(np.uint16) * 257), "16 bits"),
        (PNG[:-1], "ends early"),
        (PNG[: len(PNG) // 2], "ends early"),
        (JPEG[: len(JPEG) // 2], "ends early"),
        (PNG[:8] + PNG[33:], "without a header"),
    ],
    ids=[
        "empty",
        "GIF",
        "BMP",
        "PNG of 16 bits",
        "PNG but for a byte",
        "half a PNG",
        "half a JPEG",
        "no IHDR",
    ],
)
def test_what_is_no_whole_still_is_refused(data: bytes, reason: str) -> None:
    with pytest.raises(ImageError, match=reason):
        decode_still(data, Limits())


def test_a_flipped_bit_in_a_png_never_gives_another_picture() -> None:
    rng = random.Random(5)
    for _ in range(500):
        try:
            image = decode_still(flip_bit(PNG, rng), Limits())
        except ImageError:
            continue
        np.testing.assert_array_equal(image, IMAGE)


LARGE = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 256, (240, 320, 3), np.uint8), (0, 0), 2)


def jpeg(subsampling: int, progressive: int, restart_interval: int) -> bytes:
    """Compress the image in one of the ways that cameras do."""
    options = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, subsampling, cv2.IMWRITE_JPEG_PROGRESSIVE, progressive]
    options += [cv2.IMWRITE_JPEG_RST_INTERVAL, restart_interval]
    return cv2.imencode(".jpg", LARGE, options)[1].tobytes()


WAYS = [(0x411111, 0, 0), (0x221111, 0, 0), (0x221111, 0, 4), (0x211111, 1, 0)]


@pytest.mark.parametrize("way", WAYS, ids=["4:4:4", "4:2:0", "restarts", "progressive"])
def test_a_jpeg_has_the_pixels_that_opencv_gives(way: tuple[int, int, int]) -> None:
    data = jpeg(*way)
    expected = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(decode_still(data, Limits()), expected)


@pytest.mark.parametrize("way", WAYS, ids=["4:4:4", "4:2:0", "restarts", "progressive"])
def test_damage_that_the_decoder_notices_is_no_image(way: tuple[int, int, int]) -> None:
    """A JPEG's data that end early, before an end marker all the same, or lack blocks, are refused.

    OpenCV gives grey below the damage, or shifted blocks. The format has no checksum: damage inside one block, behind
    which the decoder finds its place again, cannot be found.
    """
    data = jpeg(*way)
    begin = data.index(b"\xff\xda") + 14
    for share in (0.1, 0.5, 0.9):
        place = begin + int(share * (len(data) - begin))
        damaged = {
            "its end is missing": data[:place] + data[-2:],
            "400 bytes are missing": data[: place - 400] + data[place:],
        }
        for what, broken in damaged.items():
            assert cv2.imdecode(np.frombuffer(broken, np.uint8), cv2.IMREAD_COLOR) is not None, what
            with pytest.raises(ImageError):
                decode_still(broken, Limits())

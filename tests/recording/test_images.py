"""Images: whole and true to the pixel in every layout, or refused."""

from __future__ import annotations

import random
from pathlib import Path

import cv2
import numpy as np
import pytest

from svmdist.errors import SourceError
from svmdist.profile import Limits
from svmdist.recording.images import (
    RAW_ENCODINGS,
    ImageError,
    decode_file,
    decode_raw,
    decode_still,
    read_file,
)

from .faults import flip_bit

IMAGE = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 256, (48, 64, 3), np.uint8), (0, 0), 2)


def compress(suffix: str, image: np.ndarray) -> bytes:
    """Encode an image."""
    return cv2.imencode(suffix, image)[1].tobytes()


PNG = compress(".png", IMAGE)
JPEG = compress(".jpg", IMAGE)


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
        (compress(".bmp", IMAGE), "expected a PNG or JPEG"),
        (compress(".png", IMAGE.astype(np.uint16) * 257), "16 bits"),
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


LIMITS = Limits()
WIDTH_PX, HEIGHT_PX = 6, 4
SIZE_PX = (WIDTH_PX, HEIGHT_PX)
BGR = np.random.default_rng(8).integers(0, 256, (HEIGHT_PX, WIDTH_PX, 3), np.uint8)
ALPHA = np.random.default_rng(9).integers(0, 256, (HEIGHT_PX, WIDTH_PX, 1), np.uint8)
GREY = BGR[:, :, :1]
LAYOUTS = {
    "bgr8": BGR,
    "8UC3": BGR,
    "rgb8": BGR[:, :, ::-1],
    "bgra8": np.concatenate([BGR, ALPHA], 2),
    "8UC4": np.concatenate([BGR, ALPHA], 2),
    "rgba8": np.concatenate([BGR[:, :, ::-1], ALPHA], 2),
    "mono8": GREY,
    "8UC1": GREY,
}
"""Pixels as each layout stores them, shape (height, width, channels)."""
BAYER = {"bayer_rggb8": "rggb", "bayer_bggr8": "bggr", "bayer_gbrg8": "gbrg", "bayer_grbg8": "grbg"}
YUV = {"yuv422": "uyvy", "uyvy": "uyvy", "yuv422_yuy2": "yuyv", "yuyv": "yuyv"}


def decode(encoding: str, pixels: np.ndarray, padding_bytes: int = 0) -> np.ndarray:
    """Decode pixels whose rows are followed by bytes that mean nothing."""
    rows = pixels.reshape(pixels.shape[0], -1)
    padded = np.pad(rows, ((0, 0), (0, padding_bytes)), constant_values=0xAA)
    size_px = (pixels.shape[1], pixels.shape[0])
    return decode_raw(encoding, size_px, padded.shape[1], padded.tobytes(), LIMITS)


@pytest.mark.parametrize("padding_bytes", [0, 1, 5])
@pytest.mark.parametrize("encoding", LAYOUTS)
def test_pixels_come_out_in_bgr(encoding: str, padding_bytes: int) -> None:
    """To the bit: channels are put in order, grey is repeated, alpha and the padding of rows are dropped."""
    image = decode(encoding, LAYOUTS[encoding], padding_bytes)
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image, np.repeat(GREY, 3, 2) if RAW_ENCODINGS[encoding][0] == 1 else BGR)


@pytest.mark.parametrize("encoding", BAYER)
def test_a_bayer_pattern_of_one_colour_is_that_colour(encoding: str) -> None:
    """Between pixels of one colour every interpolation gives that colour: to the bit, for they are whole numbers."""
    colour = {"b": 30, "g": 120, "r": 210}
    two_rows = np.array([colour[letter] for letter in BAYER[encoding]], np.uint8).reshape(2, 2)
    image = decode(encoding, np.tile(two_rows, (4, 4))[:, :, None])
    np.testing.assert_array_equal(image, np.full((8, 8, 3), [30, 120, 210]))


@pytest.mark.parametrize("encoding", YUV)
@pytest.mark.parametrize(
    ("bgr", "yuv"),
    [((255, 255, 255), (235, 128, 128)), ((0, 0, 0), (16, 128, 128)), ((0, 0, 255), (81, 90, 240))],
    ids=["white", "black", "red"],
)
def test_yuv_is_that_of_bt601(encoding: str, bgr: tuple[int, ...], yuv: tuple[int, ...]) -> None:
    """ITU-R BT.601 with the range of studios; whole numbers of YUV hold a colour to about 2 of 255."""
    values = dict(zip("yuv", yuv, strict=True))
    pair = np.array([values[letter] for letter in YUV[encoding]], np.uint8).reshape(1, 2, 2)
    image = decode(encoding, np.tile(pair, (HEIGHT_PX, WIDTH_PX // 2, 1)))
    assert image.shape == (HEIGHT_PX, WIDTH_PX, 3)
    np.testing.assert_allclose(image, np.broadcast_to(bgr, image.shape), atol=2)


@pytest.mark.parametrize("encoding", RAW_ENCODINGS)
def test_sizes_that_contradict_each_other_are_refused(encoding: str) -> None:
    """A byte too few or too many, rows shorter than their pixels, or longer than the data."""
    step_bytes = WIDTH_PX * RAW_ENCODINGS[encoding][0]
    size_bytes = step_bytes * HEIGHT_PX
    for step, length in (
        (step_bytes, size_bytes - 1),
        (step_bytes, size_bytes + 1),
        (step_bytes - 1, (step_bytes - 1) * HEIGHT_PX),
        (0, 0),
        ((1 << 32) - 1, size_bytes),
    ):
        with pytest.raises(ImageError, match="do not hold 6x4 px"):
            decode_raw(encoding, SIZE_PX, step, bytes(length), LIMITS)


PICTURE = np.random.default_rng(4).integers(0, 255, (24, 32, 3), np.uint8)


def test_png_passes_through_and_bmp_is_decoded(tmp_path: Path) -> None:
    for name in ("a.png", "a.bmp"):
        cv2.imwrite(str(tmp_path / name), PICTURE)
    data = read_file(tmp_path / "a.png", Limits())
    assert data == (tmp_path / "a.png").read_bytes()
    assert isinstance(data, bytes)
    np.testing.assert_array_equal(decode_file(data, "a.png", Limits()), PICTURE)
    np.testing.assert_array_equal(read_file(tmp_path / "a.bmp", Limits()), PICTURE)


def test_sixteen_bits_and_no_image_are_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "deep.tiff"), PICTURE.astype(np.uint16))
    with pytest.raises(SourceError, match="16 bits; 8 are expected"):
        read_file(tmp_path / "deep.tiff", Limits())
    (tmp_path / "no.bmp").write_bytes(b"BMno")
    with pytest.raises(SourceError, match=r"no.bmp: not an image that can be decoded"):
        read_file(tmp_path / "no.bmp", Limits())
    with pytest.raises(SourceError, match="cannot read"):
        read_file(tmp_path, Limits())

"""Images: whole and true to the pixel in every layout, or refused."""

import random

import cv2
import numpy as np
import pytest

from svmdist.profile import Limits
from svmdist.recording import images

from .faults import flip_bit

LIMITS = Limits()
LARGE = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 256, (240, 320, 3), np.uint8), (0, 0), 2)
IMAGE = LARGE[:48, :64]


def compress(suffix: str, image: np.ndarray, *options: int) -> bytes:
    return cv2.imencode(suffix, image, options)[1].tobytes()


PNG = compress(".png", IMAGE)
JPEG = compress(".jpg", IMAGE)


def test_png_is_lossless_and_jpeg_near():
    np.testing.assert_array_equal(images.decode_still(PNG, LIMITS), IMAGE)
    assert np.abs(images.decode_still(JPEG, LIMITS).astype(int) - IMAGE).mean() < 3
    for count in (10, 100_000):  # buffers of a fixed size are filled with zeros
        padded = images.decode_still(JPEG + bytes(count), LIMITS)
        np.testing.assert_array_equal(padded, images.decode_still(JPEG, LIMITS))


NO_STILLS = {
    "empty": (b"", "found nothing"),
    "GIF": (b"GIF89a" + bytes(20), "expected a PNG or JPEG, found b'GIF89a"),
    "BMP": (compress(".bmp", IMAGE), "expected a PNG or JPEG"),
    "PNG of 16 bits": (compress(".png", IMAGE.astype(np.uint16) * 257), "16 bits"),
    "PNG but for a byte": (PNG[:-1], "ends early"),
    "half a PNG": (PNG[: len(PNG) // 2], "ends early"),
    "half a JPEG": (JPEG[: len(JPEG) // 2], "ends early"),
    "half a JPEG, padded": (JPEG[: len(JPEG) // 2] + bytes(1000), "ends early"),
    "no IHDR": (PNG[:8] + PNG[33:], "without a header"),
}


@pytest.mark.parametrize("name", NO_STILLS)
def test_what_is_no_whole_still_is_refused(name):
    data, reason = NO_STILLS[name]
    with pytest.raises(images.ImageError, match=reason):
        images.decode_still(data, LIMITS)


def test_a_flipped_bit_in_a_png_never_gives_another_picture():
    rng = random.Random(5)
    for _ in range(500):
        try:
            image = images.decode_still(flip_bit(PNG, rng), LIMITS)
        except images.ImageError:
            continue
        np.testing.assert_array_equal(image, IMAGE)


@pytest.mark.parametrize(
    "way",
    [(0x411111, 0, 0), (0x221111, 0, 0), (0x221111, 0, 4), (0x211111, 1, 0)],
    ids=["4:4:4", "4:2:0", "restarts", "progressive"],
)
def test_a_jpeg_is_decoded_as_opencv_does_but_for_damage(way):
    """Data that end early, before an end marker all the same, or lack blocks, are refused.

    OpenCV gives grey below the damage, or shifted blocks. The format has no checksum: damage inside one block, behind
    which the decoder finds its place again, cannot be found.
    """
    kinds = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_PROGRESSIVE, cv2.IMWRITE_JPEG_RST_INTERVAL)
    data = compress(".jpg", LARGE, *(value for pair in zip(kinds, way, strict=True) for value in pair))
    expected = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(images.decode_still(data, LIMITS), expected)
    begin = data.index(b"\xff\xda") + 14
    for share in (0.1, 0.5, 0.9):
        place = begin + int(share * (len(data) - begin))
        for broken in (data[:place] + data[-2:], data[: place - 400] + data[place:]):
            assert cv2.imdecode(np.frombuffer(broken, np.uint8), cv2.IMREAD_COLOR) is not None
            with pytest.raises(images.ImageError):
                images.decode_still(broken, LIMITS)


WIDTH_PX, HEIGHT_PX = 6, 4


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
    return images.decode_raw(encoding, size_px, padded.shape[1], padded.tobytes(), LIMITS)


@pytest.mark.parametrize("padding_bytes", [0, 1, 5])
@pytest.mark.parametrize("encoding", LAYOUTS)
def test_pixels_come_out_in_bgr(encoding, padding_bytes):
    """To the bit: channels are put in order, grey is repeated, alpha and the padding of rows are dropped."""
    image = decode(encoding, LAYOUTS[encoding], padding_bytes)
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image, np.repeat(GREY, 3, 2) if images.RAW_ENCODINGS[encoding][0] == 1 else BGR)


@pytest.mark.parametrize("encoding", BAYER)
def test_a_bayer_pattern_of_one_colour_is_that_colour(encoding):
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
def test_yuv_is_that_of_bt601(encoding, bgr, yuv):
    """ITU-R BT.601 with the range of studios; whole numbers of YUV hold a colour to about 2 of 255."""
    values = dict(zip("yuv", yuv, strict=True))
    pair = np.array([values[letter] for letter in YUV[encoding]], np.uint8).reshape(1, 2, 2)
    image = decode(encoding, np.tile(pair, (HEIGHT_PX, WIDTH_PX // 2, 1)))
    assert image.shape == (HEIGHT_PX, WIDTH_PX, 3)
    np.testing.assert_allclose(image, np.broadcast_to(bgr, image.shape), atol=2)


@pytest.mark.parametrize("encoding", images.RAW_ENCODINGS)
def test_sizes_that_contradict_each_other_are_refused(encoding):
    """A byte too few or too many, rows shorter than their pixels, or longer than the data."""
    step_bytes = WIDTH_PX * images.RAW_ENCODINGS[encoding][0]
    size_bytes = step_bytes * HEIGHT_PX
    for step, length in (
        (step_bytes, size_bytes - 1),
        (step_bytes, size_bytes + 1),
        (step_bytes - 1, (step_bytes - 1) * HEIGHT_PX),
        (0, 0),
        ((1 << 32) - 1, size_bytes),
    ):
        with pytest.raises(images.ImageError, match="do not hold 6x4 px"):
            images.decode_raw(encoding, (WIDTH_PX, HEIGHT_PX), step, bytes(length), LIMITS)

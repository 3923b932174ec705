"""Uncompressed images: every layout against the pixels that it was made of."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.profile import Limits
from svmdist.recording.images import RAW_ENCODINGS, ImageError, decode_raw

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

"""Images that callers hand over: each wrong kind is told by what was found, each right one is brought to BGR."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.errors import SvmdistError, UsageError
from svmdist.samples import WrongImageError, bgr_image, require_bgr

K = np.array([[50.0, 0.0, 31.5], [0.0, 50.0, 23.5], [0.0, 0.0, 1.0]])
CAMERA = Camera(64, 48, K)
BGR = np.arange(48 * 64 * 3, dtype=np.uint32).astype(np.uint8).reshape(48, 64, 3)
ALPHA = np.full((48, 64, 1), 255, np.uint8)


@pytest.mark.parametrize(
    ("encoding", "image"),
    [
        ("bgr8", BGR),
        ("rgb8", BGR[..., ::-1]),
        ("bgra8", np.concatenate([BGR, ALPHA], 2)),
        ("rgba8", np.concatenate([BGR[..., ::-1], ALPHA], 2)),
    ],
)
def test_colours_are_brought_to_bgr_in_an_array_of_their_own(encoding, image):
    found = bgr_image(image, encoding, CAMERA)
    np.testing.assert_array_equal(found, BGR)
    assert found.flags.c_contiguous
    assert not np.shares_memory(found, image)


@pytest.mark.parametrize("shape", [(48, 64), (48, 64, 1)])
def test_grey_is_all_three(shape):
    grey = BGR[..., 0].reshape(shape)
    found = bgr_image(grey, "mono8", CAMERA)
    np.testing.assert_array_equal(found, np.repeat(BGR[..., :1], 3, axis=2))


def pillow() -> object:
    kind = type("Image", (SimpleNamespace,), {})
    kind.__module__ = "PIL.Image"
    return kind()


@pytest.mark.parametrize(
    ("image", "encoding", "said"),
    [
        (pillow(), "rgb8", "shape (48, 64, 3); found Image: numpy.asarray makes an array of it"),
        ([[0]], "bgr8", "found list"),
        (BGR / 255.0, "bgr8", "found float64, from 0 to 1: levels are from 0 to 255"),
        (BGR.astype(np.uint16) * 257, "bgr8", "found uint16, from 0 to 65535: levels"),
        (BGR > 3, "bgr8", "found bool: levels"),
        (np.moveaxis(BGR, -1, 0), "bgr8", "found (3, 48, 64): its channels stand first"),
        (np.swapaxes(BGR, 0, 1), "bgr8", "found (64, 48, 3): rows and columns are exchanged"),
        (BGR[::2], "bgr8", "found (24, 64, 3) of another size than its camera's"),
        (BGR[..., 0], "bgr8", "in bgr8, shape (48, 64, 3); found (48, 64)"),
        (BGR, "mono8", "in mono8, shape (48, 64); found (48, 64, 3)"),
        (BGR, "rgba8", "in rgba8, shape (48, 64, 4); found (48, 64, 3)"),
        (BGR[:0], "bgr8", "found (0, 64, 3)"),
        (BGR[None], "bgr8", "found (1, 48, 64, 3)"),
    ],
)
def test_a_wrong_image_is_told(image, encoding, said):
    with pytest.raises(WrongImageError, match=re.escape(said)) as caught:
        bgr_image(image, encoding, CAMERA)
    assert isinstance(caught.value, SvmdistError)
    assert isinstance(caught.value, ValueError)
    assert "\n" not in str(caught.value)


def test_without_a_camera_any_size_will_do():
    """The covered lens of a black image, too, shows nothing, which is measured as such."""
    require_bgr(np.zeros_like(BGR[:7, :9]))
    with pytest.raises(UsageError, match=r"no encoding rgb: .*rgb8"):
        bgr_image(BGR, "rgb")
    assert bgr_image(BGR[:7, :9], "bgr8").shape == (7, 9, 3)
    with pytest.raises(WrongImageError, match=r"^image: expected .* shape \(height, width, 3\); found \(48, 64\)"):
        require_bgr(BGR[..., 0])

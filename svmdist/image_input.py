"""Images that a caller of the Python interface hands over: type, layout, range and size are checked at the door."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.errors import SvmdistError, UsageError, did_you_mean

BGR, RGB = [0, 1, 2], [2, 1, 0]
ORDERS = {"bgr8": (3, BGR), "rgb8": (3, RGB), "bgra8": (4, BGR), "rgba8": (4, RGB), "mono8": (1, [0, 0, 0])}
"""Encodings by the names of ROS and Foxglove: how many channels, and those that are blue, green and red."""


class WrongImageError(SvmdistError, ValueError):
    """An image of another type, layout, range or size than expected; says what was found."""


def bgr_image(image: object, encoding: str, camera: Camera | None = None) -> NDArray[np.uint8]:
    """An image as svmdist's methods take it: BGR, uint8, shape (height, width, 3), in an array of its own.

    `encoding` says what `image` holds: `bgr8`, as OpenCV reads files; `rgb8`, as Pillow, imageio and matplotlib do;
    `bgra8`, `rgba8` or `mono8`. It must fit the shape, (height, width, channels), or (height, width) of `mono8`. With
    a camera, the image must have its size. Raises UsageError for an unknown encoding, WrongImageError for an array of
    another kind.
    """
    if encoding not in ORDERS:
        raise UsageError(f"no encoding {encoding}: {did_you_mean(encoding, ORDERS)}")
    channels, order = ORDERS[encoding]
    if channels == 1 and isinstance(image, np.ndarray) and image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    pixels = _checked(image, channels, camera, f"expected an image of uint8 in {encoding}")
    return np.ascontiguousarray((pixels[..., None] if channels == 1 else pixels)[..., order])


def require_bgr(image: object, camera: Camera | None = None, name: str = "image") -> None:
    """Check that an image is what `bgr_image` gives; raises WrongImageError."""
    _checked(image, 3, camera, f"{name}: expected a BGR image of uint8")


def _checked(image: object, channels: int, camera: Camera | None, expected: str) -> NDArray[np.uint8]:
    """An array of levels from 0 to 255, of the right layout and size; raises WrongImageError."""
    size = "height, width" if camera is None else f"{camera.height_px}, {camera.width_px}"
    expected = f"{expected}, shape ({size}{f', {channels}' if channels > 1 else ''})"
    if not isinstance(image, np.ndarray):
        kind = type(image)
        hint = "" if kind.__module__ == "builtins" else ": numpy.asarray makes an array of it"
        raise WrongImageError(f"{expected}; found {kind.__name__}{hint}")
    if image.dtype != np.uint8:
        is_number = image.size > 0 and image.dtype.kind in "fiu"
        span = f", from {np.nanmin(image):g} to {np.nanmax(image):g}" if is_number else ""
        raise WrongImageError(f"{expected}; found {image.dtype}{span}: levels are from 0 to 255")
    found = f"{expected}; found {image.shape}"
    if image.ndim == 3 and image.shape[0] in (3, 4) and image.shape[2] not in (3, 4):
        raise WrongImageError(
            f"{found}: its channels stand first; numpy.moveaxis(image, 0, -1) puts them last"
        )
    dimensions = 2 if channels == 1 else 3
    if image.ndim != dimensions or (channels > 1 and image.shape[2] != channels) or image.size == 0:
        raise WrongImageError(found)
    if camera is not None and image.shape[:2] != (camera.height_px, camera.width_px):
        turned = image.shape[1::-1] == (camera.height_px, camera.width_px)
        hint = ": rows and columns are exchanged" if turned else " of another size than its camera's"
        raise WrongImageError(f"{found}{hint}")
    return image

"""Images that a caller of the Python interface hands over: their type, layout, range and size are checked at the door.

The order of channels cannot be told from pixels: a caller states the `encoding`, and the image is brought to BGR. Nor
can bytes that were scaled to 1 be told from a covered lens.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.errors import SvmdistError, UsageError, did_you_mean

ORDERS: dict[str, tuple[int, ...]] = {
    "bgr8": (0, 1, 2),
    "rgb8": (2, 1, 0),
    "bgra8": (0, 1, 2),
    "rgba8": (2, 1, 0),
    "mono8": (0, 0, 0),
}
"""Encodings by the names of ROS and Foxglove: the channels that are blue, green and red."""
CHANNELS = {"mono8": 1, "bgr8": 3, "rgb8": 3, "bgra8": 4, "rgba8": 4}
COLOUR = (3, 4)


class WrongImageError(SvmdistError, ValueError):
    """An image of another type, layout, range or size than expected; says what was found."""


def bgr_image(image: object, encoding: str, camera: Camera | None = None) -> NDArray[np.uint8]:
    """An image as svmdist's methods take it: BGR, uint8, shape (height, width, 3), in an array of its own.

    `encoding` says what `image` holds: `bgr8`, as OpenCV reads files; `rgb8`, as Pillow, imageio and matplotlib do;
    `bgra8`, `rgba8` or `mono8`. It must fit the shape, (height, width, channels), or (height, width) of `mono8`; that
    its colours are in that order is the caller's word. With a camera, the image must have its size. Raises UsageError
    for an unknown encoding, WrongImageError for an array of another kind.
    """
    if encoding not in ORDERS:
        raise UsageError(f"no encoding {encoding}: {did_you_mean(encoding, ORDERS)}")
    channels = CHANNELS[encoding]
    size = "height, width" if camera is None else f"{camera.height_px}, {camera.width_px}"
    expected = (
        f"expected an image of uint8 in {encoding}, shape ({size}{f', {channels}' if channels > 1 else ''})"
    )
    pixels = _require_levels(image, expected)
    if channels == 1 and pixels.ndim == 3 and pixels.shape[2] == 1:
        pixels = pixels[..., 0]
    _require_shape(pixels, channels, camera, expected)
    planes = pixels[..., None] if channels == 1 else pixels
    return np.ascontiguousarray(planes[..., list(ORDERS[encoding])])


def require_bgr(image: object, camera: Camera | None = None, name: str = "image") -> None:
    """Check that an image is what `bgr_image` gives; raises WrongImageError."""
    size = "height, width" if camera is None else f"{camera.height_px}, {camera.width_px}"
    expected = f"{name}: expected a BGR image of uint8, shape ({size}, 3)"
    _require_shape(_require_levels(image, expected), 3, camera, expected)


def _require_levels(image: object, expected: str) -> NDArray[np.uint8]:
    """Type and range: an array of bytes that are levels from 0 to 255."""
    if not isinstance(image, np.ndarray):
        kind = type(image)
        hint = "" if kind.__module__ == "builtins" else ": numpy.asarray makes an array of it"
        raise WrongImageError(f"{expected}; found {kind.__name__}{hint}")
    if image.dtype != np.uint8:
        raise WrongImageError(f"{expected}; found {image.dtype}{_span(image)}: levels are from 0 to 255")
    return cast("NDArray[np.uint8]", image)


def _span(image: NDArray[Any]) -> str:
    if image.size == 0 or image.dtype.kind not in "fiu":
        return ""
    return f", from {np.nanmin(image):g} to {np.nanmax(image):g}"


def _require_shape(image: NDArray[np.uint8], channels: int, camera: Camera | None, expected: str) -> None:
    """Layout and size: rows, columns, channels."""
    wanted_dimensions = 2 if channels == 1 else 3
    found = f"{expected}; found {image.shape}"
    if image.ndim == 3 and image.shape[0] in COLOUR and image.shape[2] not in COLOUR:
        raise WrongImageError(
            f"{found}: its channels stand first; numpy.moveaxis(image, 0, -1) puts them last"
        )
    if image.ndim != wanted_dimensions or (channels > 1 and image.shape[2] != channels) or image.size == 0:
        raise WrongImageError(found)
    if camera is not None and image.shape[:2] != (camera.height_px, camera.width_px):
        turned = image.shape[1::-1] == (camera.height_px, camera.width_px)
        hint = ": rows and columns are exchanged" if turned else " of another size than its camera's"
        raise WrongImageError(f"{found}{hint}")

"""What is between lens and recorder: a round field stop, darker corners, two fields, colour at half size."""

from __future__ import annotations

import cv2
import numpy as np

from svmdist.samples import Image
from svmdist.simulation.room.settings import Room
from svmdist.transforms import Array

FIELD_NS = 1e9 / 60.0
"""Between both fields of an interlaced frame (59.94 fields a second, ITU-R BT.601)."""
EDGE_PX = 1.5
"""Half of the width in which the round border goes from light to black."""


def border_radius_px(width_px: int, height_px: int, border: float) -> float:
    """Radius of the round border: at 0 it touches the corners, at 1 the left and the right side."""
    corner_px, side_px = 0.5 * np.hypot(width_px, height_px), 0.5 * width_px
    return float(corner_px + border * (side_px - corner_px))


def light_left(room: Room, width_px: int, height_px: int) -> Array | None:
    """The share of the light that vignetting and the round border leave at each pixel, (h, w, 1); None for all."""
    if not (room.vignette or room.border):
        return None
    column, row = np.arange(width_px) - 0.5 * (width_px - 1), np.arange(height_px) - 0.5 * (height_px - 1)
    radius_px = np.hypot(column[None], row[:, None])
    # Fourth power of the cosine, to first order: the loss grows with the square of the radius.
    left = 1.0 - room.vignette * (radius_px / radius_px.max()) ** 2
    if room.border:
        inside_px = border_radius_px(width_px, height_px, room.border) - radius_px
        left *= np.clip(0.5 + 0.5 * inside_px / EDGE_PX, 0.0, 1.0)
    return np.asarray(left[..., None])


def dimmed(image_bgr: Image, left: Array) -> Image:
    """An image with a share of the light, shape (h, w, 1)."""
    return np.clip(np.rint(image_bgr * left), 0, 255).astype(np.uint8)


def interlaced(first_bgr: Image, *later_bgr: Image) -> Image:
    """A frame of its fields: even rows of the first image, odd rows of the second where there is one."""
    if not later_bgr:
        return first_bgr
    frame = first_bgr.copy()
    frame[1::2] = later_bgr[0][1::2]
    return frame


def subsampled(image_bgr: Image, share: float) -> Image:
    """An image whose colour was kept for every 2 x 2 pixels (4:2:0), or that share of the way to it."""
    height, width = image_bgr.shape[:2]
    y_cr_cb = cv2.cvtColor(image_bgr, cv2.COLOR_BGR2YCrCb)
    colour = y_cr_cb[..., 1:]
    half = cv2.resize(colour, ((width + 1) // 2, (height + 1) // 2), interpolation=cv2.INTER_AREA)
    whole = cv2.resize(half, (width, height), interpolation=cv2.INTER_LINEAR)
    y_cr_cb[..., 1:] = cv2.addWeighted(whole, share, colour, 1.0 - share, 0.0)
    return np.asarray(cv2.cvtColor(y_cr_cb, cv2.COLOR_YCrCb2BGR), np.uint8)

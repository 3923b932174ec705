"""What is between lens and recorder: a round field stop, darker corners, and colour at half the resolution."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from svmdist.samples import Image
from svmdist.transforms import Array

EDGE_PX = 1.5
"""Half of the width in which the round border goes from light to black."""


def border_radius_px(width_px: int, height_px: int, border: float) -> float:
    """Radius of the round border: at 0 it touches the corners, at 1 the left and the right side."""
    corner_px, side_px = 0.5 * np.hypot(width_px, height_px), 0.5 * width_px
    return float(corner_px + border * (side_px - corner_px))


def dimmed(image_bgr: Image, border: float, vignette: float) -> Image:
    """An image, shape (h, w, 3), with what vignetting and the round border leave of it."""
    if not (border or vignette):
        return image_bgr
    left = light_left(border, vignette, image_bgr.shape[1], image_bgr.shape[0])
    return np.clip(np.rint(image_bgr * left), 0, 255).astype(np.uint8)


@lru_cache(maxsize=4)
def light_left(border: float, vignette: float, width_px: int, height_px: int) -> Array:
    """The share of the light that is left at each pixel, shape (h, w, 1)."""
    column, row = np.arange(width_px) - 0.5 * (width_px - 1), np.arange(height_px) - 0.5 * (height_px - 1)
    radius_px = np.hypot(column[None], row[:, None])
    # Fourth power of the cosine, to first order: the loss grows with the square of the radius.
    left = 1.0 - vignette * (radius_px / radius_px.max()) ** 2
    if border:
        inside_px = border_radius_px(width_px, height_px, border) - radius_px
        left *= np.clip(0.5 + 0.5 * inside_px / EDGE_PX, 0.0, 1.0)
    return np.asarray(left[..., None])


def subsampled(image_bgr: Image, share: float) -> Image:
    """An image whose colour was kept for every 2 x 2 pixels (4:2:0), or that share of the way to it."""
    height, width = image_bgr.shape[:2]
    y_cr_cb = cv2.cvtColor(image_bgr, cv2.COLOR_BGR2YCrCb)
    colour = y_cr_cb[..., 1:]
    half = cv2.resize(colour, ((width + 1) // 2, (height + 1) // 2), interpolation=cv2.INTER_AREA)
    whole = cv2.resize(half, (width, height), interpolation=cv2.INTER_LINEAR)
    y_cr_cb[..., 1:] = cv2.addWeighted(whole, share, colour, 1.0 - share, 0.0)
    return np.asarray(cv2.cvtColor(y_cr_cb, cv2.COLOR_YCrCb2BGR), np.uint8)

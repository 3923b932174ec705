"""The static virtual marker (SVM): its pattern, and pasting it on an image.

The pattern follows AprilTag's layout (Olson 2011): a white margin, a black frame and a grid of black and
white cells. It carries no identity, so the bits are chosen for another purpose: many FAST corners whose
surroundings differ from one another and under quarter turns, which is what ORB needs. The marker does
not scale with the instrument: it is pasted at one size, in pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from svmdist.samples import Image
from svmdist.transforms import Array

CELL_COUNT = 12
"""Cells along a side: margin, frame, eight of data, frame, margin."""

DATA_ROWS = (0b00100011, 0b11010100, 0b10110111, 0b00111001, 0b11100100, 0b00011011, 0b01011000, 0b11100100)
"""Eight rows of eight cells, 1 is white. Found by random search: half the cells are white, no run along a
row or column is longer than three cells, each quarter turn changes 32 cells, and windows of 4 x 4 cells,
about an ORB patch, differ from one another under every quarter turn."""


EDGE_SOFTNESS_PX = 1.0
"""Standard deviation of the blur that softens the cells' edges. Perfectly sharp corners give neighbouring
pixels the same FAST score, and its non-maximum suppression then drops them all at full resolution."""


@dataclass(frozen=True, slots=True)
class MarkedWindow:
    """The part of an image about the marker, with the marker pasted in its middle.

    The window is wider than the marker by the same margin on every side, so that a marker at the image's border is
    neither cut nor too close to the edge for ORB. `origin_px` is the window's top left pixel (x, y) in the image, and
    may lie outside of it.
    """

    window_bgr: Image
    origin_px: tuple[int, int]


@lru_cache(maxsize=8)
def marker_pattern(size_px: int) -> Image:
    """The marker as a grey image, shape (size_px, size_px), read-only."""
    cells = np.full((CELL_COUNT, CELL_COUNT), 255, np.uint8)
    cells[1:-1, 1:-1] = 0
    for row, bits in enumerate(DATA_ROWS):
        for column in range(8):
            cells[row + 2, column + 2] = 255 if bits >> (7 - column) & 1 else 0
    index = np.arange(size_px) * CELL_COUNT // size_px
    pattern = np.asarray(cv2.GaussianBlur(cells[np.ix_(index, index)], (0, 0), EDGE_SOFTNESS_PX), np.uint8)
    pattern.setflags(write=False)
    return pattern


@lru_cache(maxsize=8)
def _marker_bgr(size_px: int) -> Image:
    """The marker with three channels alike: pasting it is a plain copy."""
    return np.asarray(cv2.cvtColor(marker_pattern(size_px), cv2.COLOR_GRAY2BGR), np.uint8)


def paste_marker(image_bgr: Image, centre_px: Array, size_px: int, margin_px: int) -> MarkedWindow:
    """Paste the marker with its middle at `centre_px` (x, y in px of the image, rounded to whole pixels).

    The window, shape (size_px + 2 margin_px,) squared, repeats the image's edge where it reaches over it, which
    adds no corners. The image itself is left alone.
    """
    height, width = image_bgr.shape[:2]
    x0 = _first_px(float(centre_px[0]), size_px, width) - margin_px
    y0 = _first_px(float(centre_px[1]), size_px, height) - margin_px
    x1, y1 = x0 + size_px + 2 * margin_px, y0 + size_px + 2 * margin_px
    window = image_bgr[max(y0, 0) : y1, max(x0, 0) : x1]
    top, bottom, left, right = max(-y0, 0), max(y1 - height, 0), max(-x0, 0), max(x1 - width, 0)
    window = np.asarray(cv2.copyMakeBorder(window, top, bottom, left, right, cv2.BORDER_REPLICATE), np.uint8)
    window[margin_px:-margin_px, margin_px:-margin_px] = _marker_bgr(size_px)
    return MarkedWindow(window, (x0, y0))


def _first_px(centre_px: float, size_px: int, length_px: int) -> int:
    """The marker's first pixel along an axis of the image; its middle is brought back to the image."""
    first = round(centre_px - (size_px - 1) / 2.0)
    return min(max(first, -(size_px // 2)), length_px - size_px // 2)


def padded_template(size_px: int, margin_px: int) -> Image:
    """The marker on a grey ground, shape (size_px + 2 margin_px,) squared: ORB skips corners near borders."""
    return np.pad(marker_pattern(size_px), margin_px, constant_values=127)

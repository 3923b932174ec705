"""Instruments come in from the border of the picture: parts that do not reach it are none."""

from __future__ import annotations

import cv2
import numpy as np

from svmdist.samples import Image
from svmdist.vision.field_of_view import field_of_view

MARGIN = 0.02
"""How far from the border a part may end, over the image's width: optics fade there, and networks are coarse."""
LEAST_AREA = 0.003
"""An instrument's least part of the picture, as of `auto`."""


def parts_from_border(mask: Image, black: Image) -> Image:
    """Those connected parts of `mask` that reach the border of the picture; shape (h, w), 0 or 255.

    `black` is what may be black border around the picture, of the same shape.
    """
    picture = field_of_view(black)
    height, width = mask.shape
    reach = max(2, round(MARGIN * width))
    # A frame of nothing around the image, so that the image's own edge is border too.
    framed = cv2.copyMakeBorder(picture, reach, reach, reach, reach, cv2.BORDER_CONSTANT, value=0)
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    inner = cv2.erode(framed, kernel, borderValue=0)[reach : reach + height, reach : reach + width]
    count, parts, statistics, _ = cv2.connectedComponentsWithStats(mask & picture)
    least = LEAST_AREA * cv2.countNonZero(picture)
    kept = np.zeros(count, np.uint8)
    kept[np.unique(parts[inner == 0])] = 255
    kept[statistics[:, cv2.CC_STAT_AREA] < least] = 0
    kept[0] = 0
    return np.asarray(kept[parts], np.uint8)

"""What the endoscope shows of an image, whose frame is black: the convex hull of all that is bright.

Endoscopes show a black border around the view, as dark as a shaft. Rectangles and discs are convex, whatever a shaft
cuts out of them.
"""

from __future__ import annotations

import cv2
import numpy as np

from svmdist.samples import Image

BRIGHT_PART_FRACTION = 0.005
"""Bright parts below this fraction of the image are letters on a black border, not scene."""


def field_of_view(dark: Image) -> Image:
    """Mask, shape (h, w), of what the endoscope shows: the convex hull of the larger parts that are not dark."""
    height, width = dark.shape
    bright = cv2.erode(cv2.bitwise_not(dark), np.ones((3, 3), np.uint8), borderValue=255)
    contours, _ = cv2.findContours(bright, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    large = [part for part in contours if cv2.contourArea(part) > BRIGHT_PART_FRACTION * height * width]
    view = np.zeros_like(dark)
    if large:
        cv2.fillConvexPoly(view, cv2.convexHull(np.concatenate(large)), 255)
    return view

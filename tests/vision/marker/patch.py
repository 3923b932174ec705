"""ORB's patch geometry, eqs. (9)–(12), written out: intensity centroid, orientation and binary test.

OpenCV computes these inside `detectAndCompute`; here they stand as the paper's formulas, so that a test
can hold the two against each other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from svmdist.samples import Image
from svmdist.transforms import Array

HALF_PATCH_PX = 15
"""Radius of the circular patch: ORB's patch size of 31 px."""


def patch_moments(image_grey: Image, x_px: int, y_px: int) -> Array:
    """m00, m10, m01 of eq. (9), shape (3,), over the circular patch centred on the keypoint.

    The paper leaves out the patch's origin; centring it on the keypoint is what makes eq. (11) an angle
    about the keypoint (Rublee 2011, sec. 3.2).
    """
    radius = HALF_PATCH_PX
    window = image_grey[y_px - radius : y_px + radius + 1, x_px - radius : x_px + radius + 1]
    if window.shape != (2 * radius + 1, 2 * radius + 1):
        raise ValueError(f"the patch at ({x_px}, {y_px}) reaches over the border of the image")
    offset = np.arange(-radius, radius + 1)
    reach = _row_reach()
    inside = np.abs(offset)[None, :] <= reach[np.abs(offset)][:, None]
    weights = np.where(inside, window.astype(np.float64), 0.0)
    return np.array([weights.sum(), (weights * offset[None, :]).sum(), (weights * offset[:, None]).sum()])


def intensity_centroid(moments: Array) -> Array:
    """C of eq. (10), shape (2,): offset of the centre of brightness from the keypoint in px."""
    return np.asarray(moments[1:] / moments[0])


def orientation(moments: Array) -> float:
    """θ of eq. (11) in rad, in [0, 2π): atan2 of both moments, since one quotient loses the quadrant."""
    return float(np.arctan2(moments[2], moments[1]) % (2 * np.pi))


def binary_test(p_x: int, p_y: int) -> int:
    """τ of eq. (12): 1 if the first point is darker. The prose says brighter; Hamming distances are equal."""
    return int(p_x < p_y)


def _row_reach() -> NDArray[np.int64]:
    """Half width of each row of the disc, shape (16,), symmetric about the diagonal as in OpenCV's ORB."""
    radius = HALF_PATCH_PX
    reach = np.zeros(radius + 2, np.int64)
    limit = int(np.floor(radius * np.sqrt(2.0) / 2 + 1))
    for row in range(limit + 1):
        reach[row] = round(np.sqrt(radius * radius - row * row))
    lowest = int(np.ceil(radius * np.sqrt(2.0) / 2))
    start = 0
    for row in range(radius, lowest - 1, -1):
        while reach[start] == reach[start + 1]:
            start += 1
        reach[row] = start
        start += 1
    return reach[: radius + 1]

"""Polygons in the plane, whatever their unit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from svmdist.transforms import Array

MIN_RELATIVE_AREA = 1e-12
"""Below this fraction of its coordinates' squares a polygon's area is rounding."""


def polygon_centroid(polygon: NDArray[np.generic]) -> Array:
    """Centroid of the area inside a simple polygon, by the shoelace formula: shape (2,), in the polygon's unit.

    `polygon` has shape (n, 2), or (n, 1, 2) as OpenCV's contours; either sense of rotation will do. Without area the
    centroid is the mean of the corners.
    """
    corners = np.asarray(polygon, np.float64).reshape(-1, 2)
    closed = np.concatenate([corners, corners[:1]])
    x, y = closed[:-1].T
    next_x, next_y = closed[1:].T
    cross = x * next_y - next_x * y
    twice_area = cross.sum()
    if abs(twice_area) <= MIN_RELATIVE_AREA * np.square(corners).max():
        return np.asarray(corners.mean(0))
    moments = np.array([((x + next_x) * cross).sum(), ((y + next_y) * cross).sum()])
    return np.asarray(moments / (3.0 * twice_area))

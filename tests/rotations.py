"""Rotations that only tests need."""

from __future__ import annotations

import numpy as np

from svmdist.transforms import Array


def rotation_y(angle_rad: float) -> Array:
    """Rotation about y by an angle in rad, shape (3, 3)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])

"""The paper's kinematic equations (33) to (35), as published and corrected, one named function each."""

from __future__ import annotations

import numpy as np

from svmdist.transforms import Array

PUBLISHED_TISSUE_X_M = 0.099
PUBLISHED_TISSUE_Y_M = 0.043
"""0.099 and 0.043 of eqs. (33) and (34): they can only be the tissue's x and y in m."""


def displacement_cm_as_published(p_m: Array) -> Array:
    """eqs. (33), (34) as published, shape (..., 2): metres divided by 100, called cm, 10^4 too small."""
    return (np.array([PUBLISHED_TISSUE_X_M, PUBLISHED_TISSUE_Y_M]) - p_m[..., :2]) / 100.0


def displacement_cm_corrected(p_m: Array, tissue_m: Array) -> Array:
    """eqs. (33), (34) corrected, shape (..., 2) in cm: tissue from the recording, metres times 100."""
    return np.asarray((tissue_m[..., :2] - p_m[..., :2]) * 100.0)


def planar_distance_cm(displacement_cm: Array) -> Array:
    """eq. (35), shape (...), in cm: distance in the camera's xy plane; z is not in it."""
    return np.hypot(displacement_cm[..., 0], displacement_cm[..., 1])

"""The paper's kinematic equations (28)–(35), as printed and corrected, one named function each."""

from __future__ import annotations

import numpy as np

from svmdist.transforms import Array

PRINTED_TISSUE_X_M = 0.099
PRINTED_TISSUE_Y_M = 0.043
"""0.099 and 0.043 of eqs. (33) and (34): they can only be the tissue's x and y in m."""


def camera_base_printed() -> Array:
    """T from base to camera of eq. (28) as printed: the zero matrix, which makes (31) zero everywhere."""
    return np.zeros((4, 4))


def first_link(l1_m: float, d1_m: float) -> Array:
    """eq. (29), shape (4, 4): standard DH with α = 0, θ = 0, a = l1 and d = d1."""
    T = np.eye(4)
    T[0, 3], T[2, 3] = l1_m, d1_m
    return T


def last_link_printed(theta_rad: float) -> Array:
    """eq. (30) as printed, shape (4, 4): its rotation part has determinant -1, a reflection."""
    c, s = np.cos(theta_rad), np.sin(theta_rad)
    return np.array([[c, 0.0, -s, 0.0], [s, 0.0, c, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def last_link_corrected(theta_rad: float) -> Array:
    """eq. (30) corrected, shape (4, 4): standard DH with α = +π/2, a = d = 0."""
    c, s = np.cos(theta_rad), np.sin(theta_rad)
    return np.array([[c, 0.0, s, 0.0], [s, 0.0, -c, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def displacement_cm_printed(p_m: Array) -> Array:
    """eqs. (33), (34) as printed, shape (..., 2): metres divided by 100, called cm, 10^4 too small."""
    return (np.array([PRINTED_TISSUE_X_M, PRINTED_TISSUE_Y_M]) - p_m[..., :2]) / 100.0


def displacement_cm_corrected(p_m: Array, tissue_m: Array) -> Array:
    """eqs. (33), (34) corrected, shape (..., 2) in cm: tissue from the recording, metres times 100."""
    return np.asarray((tissue_m[..., :2] - p_m[..., :2]) * 100.0)


def planar_distance_cm(displacement_cm: Array) -> Array:
    """eq. (35), shape (...), in cm: distance in the camera's xy plane; z is not in it."""
    return np.hypot(displacement_cm[..., 0], displacement_cm[..., 1])

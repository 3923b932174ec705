"""From pixels back into space: the rays that an image's points come from, and where they meet a plane."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike

from svmdist.camera import Camera, fisheye_coefficients
from svmdist.geometry.surfaces import Plane
from svmdist.transforms import Array


def pixel_rays(camera: Camera, points_px: ArrayLike) -> Array:
    """Directions in the camera frame, shape (n, 3) with z = 1, of pixels, shape (n, 2); undistorted."""
    points = np.atleast_2d(np.asarray(points_px, np.float64))
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-12)
    if camera.distortion_model == "fisheye":
        straight = cv2.fisheye.undistortPoints(points[:, None], camera.K, fisheye_coefficients(camera.D))
    else:
        straight = cv2.undistortPoints(
            points[:, None], camera.K, camera.D if len(camera.D) else None, None, None, None, criteria
        )
    return np.column_stack([np.asarray(straight).reshape(-1, 2), np.ones(len(points))])


def meet_plane(rays: Array, plane: Plane) -> Array:
    """Points, shape (n, 3), where rays from the origin, shape (n, 3), meet a plane; NaN where they do not."""
    slope = rays @ plane.normal
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(np.abs(slope) > 1e-9, plane.offset_m / slope, np.nan)
    return np.where(depth > 0.0, depth, np.nan)[:, None] * rays

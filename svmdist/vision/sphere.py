"""The image of a sphere: how large it looks, and where its centre is within its outline."""

from __future__ import annotations

import numpy as np

from svmdist.camera import Camera
from svmdist.transforms import Array


def apparent_radius_px(centre_m: Array, radius_m: float, camera: Camera) -> Array:
    """Radius, shape (...), of the disc as large as the image of a small sphere about a centre, shape (..., 3).

    f r / z, and 1 / cos θ longer away from the axis.
    """
    z_m = centre_m[..., 2]
    stretch = np.sqrt(np.linalg.norm(centre_m, axis=-1) / np.abs(z_m))
    return np.asarray(camera.K[0, 0] * radius_m / z_m * stretch)


def without_perspective(middle_px: Array, camera: Camera, depth_m: float, radius_m: float) -> Array:
    """The pixel (2,) of a sphere's centre from the middle of its outline.

    The tangents to a sphere at (X, 0, Z) meet z = 1 about X Z / (Z² - r²), not about X / Z.
    """
    if depth_m <= radius_m:
        return middle_px
    aside = (radius_m / depth_m) ** 2
    return middle_px - aside * (middle_px - camera.K[:2, 2])

"""A lens that bends straight lines: pinhole images that are wide enough, seen through Brown–Conrady distortion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.samples import Image
from svmdist.transforms import Array

K1, K2 = -0.2, 0.05
"""Of strength 1: the corner of a 60° image moves by 11 % of its radius towards the middle, as in an endoscope with a
wide field. With both times 2.8 or more, r (1 + k1 r² + k2 r⁴) would no longer grow with r everywhere."""
MARGIN_PX = 2
_ITERATIONS = 12


def coefficients(strength: float) -> Array:
    """OpenCV's k1, k2, p1, p2, k3 of a strength, shape (5,)."""
    return np.array([K1 * strength, K2 * strength, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Lens:
    """From pinhole images of the camera `wide`, without distortion, to what the lens shows of them.

    `column_px` and `row_px`, float32 (h, w), are where in the pinhole image each pixel is seen.
    """

    wide: Camera
    column_px: NDArray[np.float32]
    row_px: NDArray[np.float32]

    @staticmethod
    def of(camera: Camera, distortion: Array) -> Lens:
        """The lens of a camera's size and K, with OpenCV's coefficients, shape (5,)."""
        width, height, K = camera.width_px, camera.height_px, camera.K
        column, row = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        seen = np.stack([(column - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1]], -1)
        pixels = _undistorted(seen, distortion) * np.diag(K)[:2] + K[:2, 2]
        low = np.floor(pixels.min(axis=(0, 1))).astype(int) - MARGIN_PX
        high = np.ceil(pixels.max(axis=(0, 1))).astype(int) + MARGIN_PX
        low, high = np.minimum(low, 0), np.maximum(high, [width - 1, height - 1])
        wide_K = K.copy()
        wide_K[:2, 2] -= low
        size = high - low + 1
        wide = replace(camera, width_px=int(size[0]), height_px=int(size[1]), K=wide_K, D=np.zeros(5), P=None)
        column_px, row_px = np.moveaxis((pixels - low).astype(np.float32), -1, 0)
        return Lens(wide, np.ascontiguousarray(column_px), np.ascontiguousarray(row_px))

    def image(self, pinhole_bgr: Image) -> Image:
        """What the lens shows of a pinhole image of the wide camera."""
        return np.asarray(cv2.remap(pinhole_bgr, self.column_px, self.row_px, cv2.INTER_LINEAR), np.uint8)


def _undistorted(seen: Array, distortion: Array) -> Array:
    """Points of the plane z = 1, shape (..., 2), that a lens with radial distortion shows at others."""
    k1, k2 = float(distortion[0]), float(distortion[1])
    r_seen = np.linalg.norm(seen, axis=-1)
    r = r_seen.copy()
    for _ in range(_ITERATIONS):  # Newton's steps; the function grows everywhere
        r2 = r * r
        r = r - (r * (1.0 + r2 * (k1 + r2 * k2)) - r_seen) / (1.0 + r2 * (3.0 * k1 + r2 * 5.0 * k2))
    scale = np.where(r_seen > 0.0, r / np.where(r_seen > 0.0, r_seen, 1.0), 1.0)
    return np.asarray(seen * scale[..., None])

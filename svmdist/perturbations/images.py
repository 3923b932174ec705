"""Perturbations of images: enlarged, rotated, dimmed towards the border, and with colour at half the resolution."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np

from svmdist.perturbations import Perturbations
from svmdist.perturbations.calibration import right_turn
from svmdist.samples import Image, RightView
from svmdist.transforms import Array

EDGE_PX = 1.5  # half of the width in which the round border goes from light to black


def dimmed(image_bgr: Image, border: float, vignette: float) -> Image:
    """Darken an image, shape (h, w, 3), by vignetting and a round border: 0 at the corners, 1 at the sides."""
    if not (border or vignette):
        return image_bgr
    left = light_left(border, vignette, image_bgr.shape[1], image_bgr.shape[0])
    return np.clip(np.rint(image_bgr * left), 0, 255).astype(np.uint8)


@lru_cache(maxsize=4)
def light_left(border: float, vignette: float, width_px: int, height_px: int) -> Array:
    """The share of the light that is left at each pixel, shape (h, w, 1)."""
    column, row = np.arange(width_px) - 0.5 * (width_px - 1), np.arange(height_px) - 0.5 * (height_px - 1)
    radius_px = np.hypot(column[None], row[:, None])
    # Fourth power of the cosine, to first order: the loss grows with the square of the radius.
    left = 1.0 - vignette * (radius_px / radius_px.max()) ** 2
    if border:
        corner_px, side_px = 0.5 * np.hypot(width_px, height_px), 0.5 * width_px
        inside_px = float(corner_px + border * (side_px - corner_px)) - radius_px
        left *= np.clip(0.5 + 0.5 * inside_px / EDGE_PX, 0.0, 1.0)
    return np.asarray(left[..., None])


def subsampled(image_bgr: Image, share: float) -> Image:
    """Keep colour for every 2 x 2 pixels only (4:2:0), or go that share of the way to it."""
    height, width = image_bgr.shape[:2]
    y_cr_cb = cv2.cvtColor(image_bgr, cv2.COLOR_BGR2YCrCb)
    colour = y_cr_cb[..., 1:]
    half = cv2.resize(colour, ((width + 1) // 2, (height + 1) // 2), interpolation=cv2.INTER_AREA)
    whole = cv2.resize(half, (width, height), interpolation=cv2.INTER_LINEAR)
    y_cr_cb[..., 1:] = cv2.addWeighted(whole, share, colour, 1.0 - share, 0.0)
    return np.asarray(cv2.cvtColor(y_cr_cb, cv2.COLOR_YCrCb2BGR), np.uint8)


def perturbed_image(image_bgr: Image, perturbations: Perturbations) -> Image:
    """Apply to an image of either camera, shape (height, width, 3), what can be applied at replay."""
    zoom, chroma = perturbations["zoom"], perturbations["chroma"]
    if zoom != 1.0:
        image_bgr = zoomed_image(image_bgr, zoom)
    image_bgr = dimmed(image_bgr, perturbations["border"], perturbations["vignette"])
    return subsampled(image_bgr, chroma) if chroma else image_bgr


def perturbed_right_view(right: RightView, perturbations: Perturbations) -> RightView:
    """Apply the same to the right view, and what concerns the right camera alone; what comes into view is black.

    Pixels of a camera that is turned about its centre move by a homography, K Rᵀ K⁻¹ (Hartley & Zisserman, Multiple
    View Geometry, sec. 8.4). The lens' distortion is taken to turn along.
    """
    image_bgr, camera = right.image_bgr, right.camera
    if perturbations.has("right_yaw", "right_pitch", "right_roll"):
        H = camera.K @ right_turn(perturbations).T @ np.linalg.inv(camera.K)
        size = (camera.width_px, camera.height_px)
        image_bgr = np.asarray(cv2.warpPerspective(image_bgr, H, size, flags=cv2.INTER_CUBIC), np.uint8)
    return replace(right, image_bgr=perturbed_image(image_bgr, perturbations))


def zoomed_image(image_bgr: Image, zoom: float) -> Image:
    """Enlarge an image about its middle; of a smaller one the border is black."""
    height, width = image_bgr.shape[:2]
    T = np.column_stack([zoom * np.eye(2), (1.0 - zoom) * 0.5 * np.array([width - 1, height - 1])])
    return np.asarray(cv2.warpAffine(image_bgr, T, (width, height), flags=cv2.INTER_CUBIC), np.uint8)

"""Images as the cameras of a perturbed world give them, made from those of a log."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.perturbations.calibration import right_turn
from svmdist.perturbations.chosen import Perturbations
from svmdist.perturbations.video import dimmed, subsampled
from svmdist.samples import Image, RightView
from svmdist.transforms import Array


def perturbed_image(image_bgr: Image, perturbations: Perturbations) -> Image:
    """Do to an image of either camera, shape (height, width, 3), what can be done at replay."""
    zoom, chroma = perturbations["zoom"], perturbations["chroma"]
    if zoom != 1.0:
        image_bgr = zoomed_image(image_bgr, zoom)
    image_bgr = dimmed(image_bgr, perturbations["border"], perturbations["vignette"])
    return subsampled(image_bgr, chroma) if chroma else image_bgr


def perturbed_right_view(right: RightView, perturbations: Perturbations) -> RightView:
    """Do the same to the right view, and what concerns the right camera alone."""
    image_bgr = right.image_bgr
    if perturbations.has("right_yaw", "right_pitch", "right_roll"):
        image_bgr = turned_image(image_bgr, right.camera, right_turn(perturbations))
    return replace(right, image_bgr=perturbed_image(image_bgr, perturbations))


def turned_image(image_bgr: Image, camera: Camera, R_camera_turned: Array) -> Image:
    """The image of a camera that is turned about its centre, by what it showed before; the border is black.

    Pixels move by a homography, K Rᵀ K⁻¹ (Hartley & Zisserman, Multiple View Geometry, sec. 8.4). The lens' distortion
    is taken to turn along.
    """
    H = camera.K @ R_camera_turned.T @ np.linalg.inv(camera.K)
    size = (camera.width_px, camera.height_px)
    return np.asarray(cv2.warpPerspective(image_bgr, H, size, flags=cv2.INTER_CUBIC), np.uint8)


def zoomed_image(image_bgr: Image, zoom: float) -> Image:
    """Enlarge an image about its middle; of a smaller one the border is black."""
    height, width = image_bgr.shape[:2]
    middle = np.array([(width - 1) / 2.0, (height - 1) / 2.0])
    T = np.column_stack([zoom * np.eye(2), (1.0 - zoom) * middle])
    return np.asarray(cv2.warpAffine(image_bgr, T, (width, height), flags=cv2.INTER_CUBIC), np.uint8)

"""Images as the cameras of a perturbed world give them, made from those of a log."""

from __future__ import annotations

import cv2
import numpy as np

from svmdist.perturbations.chosen import Perturbations
from svmdist.samples import Image


def perturbed_image(image_bgr: Image, perturbations: Perturbations) -> Image:
    """Do to an image of either camera, shape (height, width, 3), what can be done at replay."""
    zoom = perturbations["zoom"]
    return image_bgr if zoom == 1.0 else zoomed_image(image_bgr, zoom)


def zoomed_image(image_bgr: Image, zoom: float) -> Image:
    """Enlarge an image about its middle; of a smaller one the border is black."""
    height, width = image_bgr.shape[:2]
    middle = np.array([(width - 1) / 2.0, (height - 1) / 2.0])
    T = np.column_stack([zoom * np.eye(2), (1.0 - zoom) * middle])
    return np.asarray(cv2.warpAffine(image_bgr, T, (width, height), flags=cv2.INTER_CUBIC), np.uint8)

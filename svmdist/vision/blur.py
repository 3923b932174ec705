"""The image degradations of the paper's Table I, with stated kernels."""

from __future__ import annotations

from enum import StrEnum

import cv2
import numpy as np

from svmdist.samples import Image


class Blur(StrEnum):
    """The rows of Table I, and a clean row to compare with. The paper counts the morphological two as blurs."""

    NONE = "none"
    EROSION = "erosion"
    DILATION = "dilation"
    GAUSSIAN = "gaussian"
    MEDIAN = "median"
    BILATERAL = "bilateral"


def apply_blur(image_bgr: Image, blur: Blur, kernel_px: int) -> Image:
    """Degrade an image, shape (h, w, 3), with a kernel of `kernel_px` (odd) pixels.

    Erosion and dilation use a square kernel; Gaussian has OpenCV's sigma for the kernel,
    0.3 ((k - 1) / 2 - 1) + 0.8 px; bilateral has sigma 75 in colour and k in space.
    """
    if kernel_px < 1 or kernel_px % 2 == 0:
        raise ValueError(f"a kernel has an odd size of at least 1 px, found {kernel_px}")
    square = np.ones((kernel_px, kernel_px), np.uint8)
    match blur:
        case Blur.NONE:
            return image_bgr
        case Blur.EROSION:
            return np.asarray(cv2.erode(image_bgr, square), np.uint8)
        case Blur.DILATION:
            return np.asarray(cv2.dilate(image_bgr, square), np.uint8)
        case Blur.GAUSSIAN:
            # Stated, not left to OpenCV: it takes narrower binomial kernels up to 7 px.
            sigma_px = 0.3 * ((kernel_px - 1) / 2 - 1) + 0.8
            return np.asarray(cv2.GaussianBlur(image_bgr, (kernel_px, kernel_px), sigma_px), np.uint8)
        case Blur.MEDIAN:
            return np.asarray(cv2.medianBlur(image_bgr, kernel_px), np.uint8)
        case Blur.BILATERAL:
            return np.asarray(cv2.bilateralFilter(image_bgr, kernel_px, 75.0, float(kernel_px)), np.uint8)

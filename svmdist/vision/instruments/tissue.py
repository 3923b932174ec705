"""Tissue without a colour: the picture, or the redder part of it where that is distinct from the rest."""

from __future__ import annotations

import cv2
import numpy as np

from svmdist.samples import Image
from svmdist.vision.instruments.working import WorkingImage

DISTINCT_SHARE = 0.7
"""Of the variance of warmth that is between the redder part and the rest, not within: less is one kind of tissue."""
DISTINCT_WARMTH = 0.4
"""How much redder the one must be than the other, as a logarithm: organ on a drape, not fat beside muscle."""


def tissue_of(image: WorkingImage) -> Image:
    """Mask, shape (h, w), of what may be tissue; instruments are not yet taken out of it."""
    warmth = image.warmth
    values = warmth[image.core > 0]
    if not len(values):
        return image.picture
    low, high = np.percentile(values, (1, 99))
    if high - low < DISTINCT_WARMTH:
        return image.picture
    levels = np.clip((warmth - low) * (255.0 / (high - low)), 0, 255).astype(np.uint8)
    inside = levels[image.core > 0].reshape(-1, 1)
    threshold, _ = cv2.threshold(inside, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    red = inside > threshold
    share = float(np.mean(red))
    if not 0.0 < share < 1.0:
        return image.picture
    shown = inside.astype(np.float64)
    apart = float(shown[red].mean() - shown[~red].mean())
    between = share * (1.0 - share) * apart**2 / max(float(shown.var()), 1e-9)
    if between < DISTINCT_SHARE or apart * (high - low) / 255.0 < DISTINCT_WARMTH:
        return image.picture
    return np.asarray(np.where(levels > threshold, image.picture, 0), np.uint8)

"""Interlaced images: where two fields of different instants stand in one image, the first one alone.

A frame grabber weaves two fields together; what moved between them is combed. Of combed places the odd rows are put
anew from the even ones around them (bob where there is motion: de Haan and Bellers 1998, "Deinterlacing – an
overview"), so that the image shows the instant of its first field.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from svmdist.profile.settings import InterlaceSettings
from svmdist.samples import Image, Observation

DEFAULT = InterlaceSettings()
COLUMNS = 640
"""Sizes in px are for images of so many columns."""
REACH = 3
"""Blocks about a combed one that are mended with it: of one moving body some parts have too little contrast to tell."""


def with_first_fields(observation: Observation, settings: InterlaceSettings = DEFAULT) -> Observation:
    """The observation with both views at the instant of their first field; the same object where nothing is combed."""
    left, right = first_field(observation.image_bgr, settings), observation.right
    if left is not observation.image_bgr:
        observation = replace(observation, image_bgr=left)
    if right is not None:
        other = first_field(right.image_bgr, settings)
        if other is not right.image_bgr:
            observation = replace(observation, right=replace(right, image_bgr=other))
    return observation


def first_field(bgr: Image, settings: InterlaceSettings = DEFAULT) -> Image:
    """The image, shape (h, w, 3), with the odd rows of combed places made of the even ones; the same array without."""
    scale = bgr.shape[1] / COLUMNS
    green = np.asarray(cv2.extractChannel(bgr, 1), np.uint8)
    combed = _stands_out(green, 1, settings.comb_levels)
    if cv2.countNonZero(combed) < settings.min_pixels * scale**2:
        return bgr
    textured = _stands_out(green, 2, settings.comb_levels)
    side = 2 * round(0.5 * settings.block_px * scale) + 1
    of_block = [cv2.boxFilter(mask, cv2.CV_32F, (side, side)) for mask in (combed, textured)]
    is_combed = (of_block[0] > settings.min_fraction) & (of_block[0] > settings.comb_ratio * of_block[1])
    if np.count_nonzero(is_combed) < settings.min_pixels * scale**2:
        return bgr
    places = cv2.dilate(is_combed.astype(np.uint8), np.ones((REACH * side, REACH * side), np.uint8))
    mended = bgr.copy()
    above = bgr[0:-2:2]
    below = bgr[2::2]
    odd = mended[1:-1:2]
    between = cv2.addWeighted(above, 0.5, below, 0.5, 0.0)
    np.copyto(odd, between, where=places[1:-1:2, :, None] > 0)
    return mended


def _stands_out(green: Image, away: int, levels: float) -> Image:
    """Mask of ones, shape (h, w): pixels brighter, or darker, than both those so many rows above and below."""
    mask = np.zeros(green.shape, np.uint8)
    middle, above, below = green[away:-away], green[: -2 * away], green[2 * away :]
    brighter = cv2.subtract(middle, cv2.max(above, below))
    darker = cv2.subtract(cv2.min(above, below), middle)
    _, mask[away:-away] = cv2.threshold(cv2.max(brighter, darker), levels, 1.0, cv2.THRESH_BINARY)
    return mask

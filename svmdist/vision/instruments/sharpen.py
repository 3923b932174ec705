"""Sides of a bar moved to where colours change most: a mask's outline may be a pixel or two off."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from svmdist.transforms import Array
from svmdist.vision.instruments.bars import Bar
from svmdist.vision.instruments.working import WorkingImage

PLACES = 32
"""Places along a side at which its edge is sought."""
STEP_PX = 0.5
"""Distance of the samples across a side."""
HALF_STEP_PX = 1.5
"""Colours this far to either side of an edge are compared: the working image's blur."""
LEAST_AGREEING = 0.5
"""Part of the places whose edges must lie on one line; else the side stays where it was."""


def sharpened(bar: Bar, image: WorkingImage) -> Bar:
    """The bar with each side on the line of the steepest change of colour near it."""
    reach_px = min(2.0 + 0.1 * bar.width_px, 0.3 * bar.width_px)
    sides = np.stack([_sharpened_side(bar, side, reach_px, image) for side in (0, 1)])
    return replace(bar, sides=sides)


def _sharpened_side(bar: Bar, side: int, reach_px: float, image: WorkingImage) -> Array:
    settings = image.settings
    start, end = bar.sides[side]
    normal = bar.inward(side)
    offsets = np.arange(-reach_px, reach_px + 0.5 * STEP_PX, STEP_PX)
    along = np.linspace(0.04, 0.96, PLACES)[:, None] * (end - start) + start
    wide = np.concatenate([offsets - HALF_STEP_PX, offsets + HALF_STEP_PX])
    places = along[:, None] + wide[None, :, None] * normal
    x, y = np.ascontiguousarray(places[..., 0], np.float32), np.ascontiguousarray(places[..., 1], np.float32)
    colours = np.asarray(cv2.remap(image.colours, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
    scale = np.array([settings.colour_step, settings.colour_step, settings.brightness_step])
    change = np.linalg.norm((colours[:, len(offsets) :] - colours[:, : len(offsets)]) / scale, axis=2)
    # Of edges alike in height the one nearer to the outline is meant.
    best = np.argmax(change * (1.0 - 0.4 * np.abs(offsets) / max(reach_px, 1e-9)), axis=1)
    height = change[np.arange(PLACES), best]
    points = along + offsets[best, None] * normal
    seen = height > 1.0
    if np.count_nonzero(seen) < LEAST_AGREEING * PLACES:
        return np.asarray(bar.sides[side])
    vx, vy, x0, y0 = (
        float(v)
        for v in np.ravel(cv2.fitLine(points[seen].astype(np.float32), cv2.DIST_WELSCH, 0, 0.01, 0.01))
    )
    direction, at = np.array([vx, vy]), np.array([x0, y0])
    off = np.abs((points[seen] - at) @ np.array([-vy, vx]))
    if np.mean(off < settings.line_within_px) < LEAST_AGREEING:
        return np.asarray(bar.sides[side])
    return np.stack([at + direction * float((end_px - at) @ direction) for end_px in (start, end)])

"""A tag's pose refined on every pixel of the tag.

Four corners give a first pose; on a tag of 40 pixels they leave half a degree of tilt and a third of a
millimetre of depth. The printed cells have twenty times as much edge: the known pattern, blurred as the image
is, is laid over the pixels by least squares over pose, brightness, contrast and blur (Baker and Matthews 2004).

The loss is robust, as an MM-estimator's (Yohai 1987): Huber's leads coarsely from a first pose to the minimum and gives
the standard deviation there, Tukey's biweight at that deviation leaves glare, blood and what hides the tag out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np

from svmdist.least_squares import Steps, minimise
from svmdist.profile.settings import TagSettings
from svmdist.transforms import Array, make_transform
from svmdist.vision.tag.overlay import GREY, LaidPattern, Loss, Overlay, TagPixels, lay_pattern, start_overlay
from svmdist.vision.tag.pattern import TagPattern

STEP_LIMIT = np.array([0.2] * 6 + [0.5] + [2.0] * 2)
"""In tag sides, rad, px of blur and GREY: beyond it the linearisation says nothing."""
DAMPING = 1e-3
DEFAULT = TagSettings()


@dataclass(frozen=True, slots=True)
class TagPose:
    """A tag's pose `T_camera_tag`, shape (4, 4), and the covariance of (δp, δθ), shape (6, 6).

    The error is as in `ToolPose`: p_true = p + δp in m, R_true = exp([δθ]) R, both in the camera frame.
    `residual` is the root mean square of image less pattern, outliers left out, over the contrast; `blur_px` the
    image's blur.
    """

    T_camera_tag: Array
    covariance: Array
    residual: float
    blur_px: float


def lay_coarsely(
    pixels: TagPixels, T_camera_tag: Array, pattern: TagPattern, settings: TagSettings = DEFAULT
) -> LaidPattern | None:
    """From a first pose to near the minimum, on some of the pixels; None where the pattern does not hold."""
    some = pixels.thinned(settings.coarse_pixels)
    start = start_overlay(some, T_camera_tag, pattern, settings)
    if start is None:
        return None
    overlay, std = start
    loss = Loss(settings.coarse_bound * std, is_biweight=False)
    return _minimise(some, overlay, pattern, loss, settings, settings.coarse_steps, settings.coarsely_settled)


def refine_fit(
    pixels: TagPixels, coarse: LaidPattern, pattern: TagPattern, settings: TagSettings = DEFAULT
) -> TagPose | None:
    """From near the minimum to it, on all pixels but the outliers; None where the pattern does not hold."""
    loss = Loss(settings.outlier_bound * coarse.std, is_biweight=True)
    fit = _minimise(pixels, coarse.overlay, pattern, loss, settings, settings.fine_steps, settings.settled)
    if fit is None:
        return None
    T = fit.overlay.T_camera_tag
    to_camera = np.zeros((6, 6))
    to_camera[:3, :3] = pattern.size_m * T[:3, :3]
    to_camera[3:, 3:] = T[:3, :3]
    covariance = to_camera @ fit.covariance(settings.cluster_inflation)[:6, :6] @ to_camera.T
    return TagPose(T, covariance, fit.misfit, fit.overlay.blur_px)


def _minimise(
    pixels: TagPixels,
    start: Overlay,
    pattern: TagPattern,
    loss: Loss,
    settings: TagSettings,
    max_steps: int,
    settled: float,
) -> LaidPattern | None:
    def linearise(overlay: Overlay) -> LaidPattern | None:
        return lay_pattern(pixels, overlay, pattern, loss, settings)

    def retract(overlay: Overlay, step: Array) -> Overlay:
        # Shortened as a whole: blur and contrast, depth and tilt go together.
        step = step / max(1.0, float(np.max(np.abs(step) / STEP_LIMIT)))
        T, R = overlay.T_camera_tag, overlay.T_camera_tag[:3, :3]
        moved = make_transform(R @ cv2.Rodrigues(step[3:6])[0], T[:3, 3] + pattern.size_m * (R @ step[:3]))
        blur_px = min(max(overlay.blur_px + float(step[6]), settings.blur_min_px), settings.blur_max_px)
        return Overlay(
            moved, blur_px, overlay.offset + GREY * float(step[7]), overlay.contrast + GREY * float(step[8])
        )

    steps = Steps(max_steps, settled=settled, damping=DAMPING)
    minimum = minimise(start, linearise, retract, steps)
    return None if minimum is None else cast(LaidPattern, minimum.equations)


def on_tag(rays: Array, T_camera_tag: Array) -> Array:
    """Where rays, shape (n, 3), meet the tag's plane, in its frame, shape (n, 2)."""
    R, t = T_camera_tag[:3, :3], T_camera_tag[:3, 3]
    depth = (R[:, 2] @ t) / (rays @ R[:, 2])
    return np.asarray((depth[:, None] * rays - t) @ R[:, :2])


def nudged(T: Array, error: Array) -> Array:
    """A pose moved by (δp, δθ), shape (6,), both in the camera frame."""
    return make_transform(cv2.Rodrigues(error[3:])[0] @ T[:3, :3], T[:3, 3] + error[:3])

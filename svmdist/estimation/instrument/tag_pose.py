"""The pose of the tag on the instrument: of the poses that its corners allow the true one, refined on every pixel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.least_squares import minimise
from svmdist.samples import Image
from svmdist.transforms import Array, make_transform, rotation_angle
from svmdist.vision.tags import (
    GREY,
    LaidPattern,
    Loss,
    Overlay,
    TagPattern,
    TagPixels,
    lay_pattern,
    pose_candidates,
    start_overlay,
)

WINDOW_MARGIN = 0.2  # around the corners, over the tag's size: 0.075 is needed, more allows for wrong corners
BLUR_MIN_PX = 0.3  # the sharpest image that is considered: a pixel's own area blurs by 0.29 px
BLUR_MAX_PX = 6.0  # the most blurred one: of a tag 40 px wide no cell would be seen any more
COARSE_PIXELS = 1500  # that the search from a first pose looks at; a tag 40 px wide has twice as many
COARSE_STEPS = 16  # steps of the search from each first pose, at most. It takes 4 on a clear image
COARSE_TOLERANCE = 3e-3  # largest part of a last step, in tag sides, rad and px of blur
COARSE_BOUND = 3.0  # pixels that differ by more standard deviations count singly (Huber)
FINE_STEPS = 16  # steps of the refinement, at most. It takes 4 on a clear image
TOLERANCE = 1e-4  # a last step: what is left is 0.3 µm of a tag of 7 mm, a hundredth of its deviation
OUTLIER_BOUND = 6.0  # tukey's biweight, 95 % efficient on normal errors: glare and blood are outliers
CLUSTER_INFLATION = 2.2
"""Over deviations by cells that err independently: measured on 450 rendered tags of 40 px, whose pixels sample a point,
which shifts edges along rows. A camera's pixels integrate over their area and shift them less: it is safe there."""
DECIDED_RATIO = 1.15  # of residuals of both poses: above 1.3 in nine of ten of 347 simulated frames
NEAR_RAD = 0.05  # poses closer than this are one: a tag seen head-on has one minimum, with a wide covariance
SURE_RAD = 0.03  # a predicted rotation so certain separates poses even at 10° of tilt
PREDICTED_WITHIN_RAD = 0.35  # twice 2° about each axis and 1° in each of seven joints

STEP_LIMIT = np.array([0.2] * 6 + [0.5] + [2.0] * 2)
"""In tag sides, rad, px of blur and GREY: beyond it the linearisation says nothing."""
DAMPING = 1e-3


@dataclass(frozen=True, slots=True)
class TagPose:
    """A tag's pose `T_camera_tag`, shape (4, 4), and the covariance of its error, shape (6, 6), as in `ToolPose`."""

    T_camera_tag: Array
    covariance: Array


def find_tag_pose(
    image_grey: Image,
    corners_px: Array,
    camera: Camera,
    pattern: TagPattern,
    R_camera_tag_predicted: Array | None = None,
    predicted_std_rad: float = np.inf,
) -> TagPose | None:
    """The pose of a tag with these corners, shape (4, 2), refined on all its pixels.

    None where nothing decides between the two poses that four corners allow. The residual decides where it can; else
    the one nearest to the predicted rotation, shape (3, 3), is taken. A prediction of which `predicted_std_rad` is
    small leaves one of them, a third of the work.
    """
    starts = pose_candidates(corners_px, pattern.size_m, camera.K, camera.D)
    if R_camera_tag_predicted is not None and predicted_std_rad < SURE_RAD and starts:
        off_rad = [float(rotation_angle(T[:3, :3], R_camera_tag_predicted)) for T in starts]
        if min(off_rad) < PREDICTED_WITHIN_RAD:
            starts = [make_transform(R_camera_tag_predicted, starts[int(np.argmin(off_rad))][:3, 3])]

    # From each first pose to near the minimum, on some of the pixels.
    pixels = _pixels_around(image_grey, corners_px, camera)
    some, fits = pixels.thinned(COARSE_PIXELS), list[LaidPattern]()
    for T in starts:
        if (start := start_overlay(some, T, pattern)) is not None:
            loss = Loss(COARSE_BOUND * start[1], is_biweight=False)
            fit = _minimise(some, start[0], pattern, loss, COARSE_STEPS, COARSE_TOLERANCE)
            if fit is not None:
                fits.append(fit)

    # From there to it, on all pixels but the outliers.
    if (coarse := _choose(fits, R_camera_tag_predicted)) is None:
        return None
    loss = Loss(OUTLIER_BOUND * coarse.std, is_biweight=True)
    fit = _minimise(pixels, coarse.overlay, pattern, loss, FINE_STEPS, TOLERANCE)
    if fit is None:
        return None
    T, to_camera = fit.overlay.T_camera_tag, np.zeros((6, 6))
    to_camera[:3, :3], to_camera[3:, 3:] = pattern.size_m * T[:3, :3], T[:3, :3]
    return TagPose(T, to_camera @ fit.covariance(CLUSTER_INFLATION)[:6, :6] @ to_camera.T)


def _minimise(
    pixels: TagPixels, start: Overlay, pattern: TagPattern, loss: Loss, max_steps: int, tolerance: float
) -> LaidPattern | None:
    """The pattern laid where it fits best, from an overlay; None where it does not hold."""

    def retract(overlay: Overlay, step: Array) -> Overlay:
        # Shortened as a whole: blur and contrast, depth and tilt go together.
        step = step / max(1.0, float(np.max(np.abs(step) / STEP_LIMIT)))
        T, R = overlay.T_camera_tag, overlay.T_camera_tag[:3, :3]
        moved = make_transform(R @ cv2.Rodrigues(step[3:6])[0], T[:3, 3] + pattern.size_m * (R @ step[:3]))
        blur_px = min(max(overlay.blur_px + float(step[6]), BLUR_MIN_PX), BLUR_MAX_PX)
        offset, contrast = overlay.offset + GREY * float(step[7]), overlay.contrast + GREY * float(step[8])
        return Overlay(moved, blur_px, offset, contrast)

    lay = partial(lay_pattern, pixels, pattern=pattern, loss=loss)
    found = minimise(start, lay, retract, max_steps, tolerance, DAMPING)
    return None if found is None else found[1]


def _choose(fits: list[LaidPattern], R_predicted: Array | None) -> LaidPattern | None:
    """The fit whose residual is clearly smaller, or which the prediction is near to; None if ambiguous."""
    fits = sorted(fits, key=lambda fit: fit.misfit)
    if len(fits) < 2 or fits[1].misfit > DECIDED_RATIO * fits[0].misfit:
        return fits[0] if fits else None
    rotations = [fit.overlay.T_camera_tag[:3, :3] for fit in fits]
    if float(rotation_angle(rotations[0], rotations[1])) < NEAR_RAD:
        return fits[0]
    if R_predicted is None:
        return None
    off_rad = [float(rotation_angle(R, R_predicted)) for R in rotations]
    nearest = int(np.argmin(off_rad))
    return fits[nearest] if off_rad[nearest] < PREDICTED_WITHIN_RAD else None


def _pixels_around(image_grey: Image, corners_px: Array, camera: Camera) -> TagPixels:
    """The pixels inside a tag's corners and a margin around them."""
    height, width = image_grey.shape
    margin_px = WINDOW_MARGIN * float(np.ptp(corners_px, axis=0).max())
    x0, y0 = np.clip(np.floor(corners_px.min(0) - margin_px), 0, [width - 1, height - 1]).astype(int)
    x1, y1 = np.clip(np.ceil(corners_px.max(0) + margin_px) + 1, 1, [width, height]).astype(int)
    # Only what is inside the quadrilateral and its margin can lie on the tag.
    mask, middle_px = np.zeros((y1 - y0, x1 - x0), np.uint8), corners_px.mean(0)
    grown_px = middle_px + (1.0 + 2.0 * WINDOW_MARGIN) * (corners_px - middle_px) - [x0, y0]
    cv2.fillConvexPoly(mask, np.round(grown_px).astype(np.int32), 255)
    y, x = np.nonzero(mask)
    rays = camera.rays(np.column_stack([x + x0, y + y0]).astype(np.float64))
    brightness = image_grey[y + y0, x + x0].astype(np.float64)
    return TagPixels(brightness, np.ascontiguousarray(rays.T), float(camera.K[0, 0]))

"""The homography from template to frame: estimation, transfer (eq. 17) and inliers (eq. 18)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.transforms import Array
from svmdist.vision.marker.features import Matches

SEED = 20
"""Fixed seed of the sampler: with it, and without threads, USAC gives the same bits everywhere."""


REFIT_THRESHOLDS_PX = (1.5, 1.0, 0.7, 0.5, 0.3)
REFIT_MIN_COUNT = 20


@dataclass(frozen=True, slots=True)
class Homography:
    """`H`, shape (3, 3) with H[2, 2] = 1, and which matches agree with it, shape (n,) of bool."""

    H: Array
    inliers: NDArray[np.bool_]


def fit_homography(matches: Matches, reprojection_px: float) -> Homography | None:
    """Fit a homography robustly (MAGSAC, Barath 2019); None where the points allow none.

    Inliers are counted here by eq. (18), not taken from OpenCV, so that the number means what the paper
    says. Fewer than four inliers cannot carry a homography.
    """
    if len(matches) < 4:
        return None
    parameters = cv2.UsacParams()
    parameters.threshold = reprojection_px
    parameters.confidence = 0.999
    parameters.maxIterations = 2000
    parameters.score = cv2.SCORE_METHOD_MAGSAC
    parameters.loMethod = cv2.LOCAL_OPTIM_SIGMA
    parameters.loIterations = 10
    parameters.loSampleSize = 50
    parameters.isParallel = False
    parameters.randomGeneratorState = SEED
    try:
        fitted, _ = cv2.findHomography(matches.template_px, matches.frame_px, parameters)
    except cv2.error:  # degenerate points: all alike, or on one line
        return None
    if fitted is None or not np.all(np.isfinite(fitted)) or abs(fitted[2, 2]) < 1e-12:
        return None
    H = _refit(np.asarray(fitted / fitted[2, 2], np.float64), matches)
    inliers = transfer_error(H, matches.template_px, matches.frame_px) <= reprojection_px
    return Homography(H, inliers) if np.count_nonzero(inliers) >= 4 else None


def _refit(H: Array, matches: Matches) -> Array:
    """Refit by least squares on the matches within shrinking thresholds, while they are many and agree.

    A keypoint of ORB's coarse pyramid levels is off by up to a pixel and more, and is an inlier all the
    same; the fine ones, which agree to a fraction of a pixel, shall decide.
    """
    for threshold_px in REFIT_THRESHOLDS_PX:
        close = transfer_error(H, matches.template_px, matches.frame_px) <= threshold_px
        if np.count_nonzero(close) < REFIT_MIN_COUNT:
            break
        fitted, _ = cv2.findHomography(matches.template_px[close], matches.frame_px[close], 0)
        if fitted is None or not np.all(np.isfinite(fitted)) or abs(fitted[2, 2]) < 1e-12:
            break
        H = np.asarray(fitted / fitted[2, 2], np.float64)
    return H


def transfer(H: Array, points_px: Array) -> Array:
    """Map points, shape (n, 2) in px, by eq. (17) with its missing scale: λ [u' v' 1] = H [u v 1]."""
    mapped = _homogeneous(points_px) @ H.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(mapped[:, :2] / mapped[:, 2:])


def transfer_printed(H: Array, points_px: Array) -> Array:
    """Map points by eq. (17) as printed: no division by the scale, right only while the third row is 0 0 1."""
    return np.asarray((_homogeneous(points_px) @ H.T)[:, :2])


def transfer_error(H: Array, template_px: Array, frame_px: Array) -> Array:
    """Δd of eq. (18), shape (n,) in px: distance of each match from where the homography puts it."""
    error = np.linalg.norm(frame_px - transfer(H, template_px), axis=-1)
    return np.where(np.isfinite(error), error, np.inf)


def inliers_printed(error_px: Array, threshold_px: float) -> NDArray[np.bool_]:
    """eq. (18) as printed: a match is an inlier if Δd > threshold. It keeps the outliers."""
    return np.asarray(error_px > threshold_px)


def is_plausible(H: Array, size_px: int) -> bool:
    """Tell whether a homography maps the template's square to a convex shape of similar size.

    The marker is pasted without scaling, so that a shape turned over, folded or more than twice as large
    or small comes from wrong matches.
    """
    corners = transfer(H, square_corners(size_px))
    if not np.all(np.isfinite(corners)):
        return False
    edges = np.roll(corners, -1, axis=0) - corners
    following = np.roll(edges, -1, axis=0)
    cross = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    area = cv2.contourArea(corners.astype(np.float32))
    return bool(np.all(cross > 0)) and 0.25 < area / (size_px - 1) ** 2 < 4.0


def square_corners(size_px: int, offset_px: float = 0.0) -> Array:
    """Corners of a square of pixels, clockwise from the top left, shape (4, 2) in px."""
    last = size_px - 1.0
    return np.array([[0.0, 0.0], [last, 0.0], [last, last], [0.0, last]]) + offset_px


def _homogeneous(points_px: Array) -> Array:
    return np.column_stack([points_px, np.ones(len(points_px))])

"""Rectified stereo of smooth tissue: semi-global matching, then one smooth disparity surface aligned to sub-pixels.

Wet tissue has little texture. Semi-global matching (Hirschmüller 2008) finds the right disparity there within
a pixel or so, which at a baseline of 5 mm is several millimetres. The organ is smooth, though: a low-order
polynomial d(u, v) is fitted robustly to the matches, and then refined by aligning the images themselves
(Lucas & Kanade 1981, with the disparity surface as the warp), which every pixel of the organ supports.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from svmdist.samples import Image
from svmdist.settings.stereo import StereoSettings
from svmdist.transforms import Array

DEFAULT = StereoSettings()
DEGREE = 3
SCALE_PX = 100.0
MAX_SAMPLES = 15_000
"""Pixels used in a fit: beyond some ten thousand, noise is no longer what limits it."""
MAX_START_SAMPLES = 3000
"""Matches that the alignment starts from: it must begin within a pixel, no better."""
ALIGN_STEPS = 12
RIDGE = 1e-3


@dataclass(frozen=True, slots=True)
class DisparitySurface:
    """Disparity in px as a polynomial of the left image's pixels about `centre_px`, and how well it aligns.

    `mismatch_px` is the robust spread of the images' difference along it over the slope of the image (rms, along x): by
    how much a pixel seems shifted. `matched_fraction` is the share of the region's pixels that semi-global matching
    found a disparity for.
    """

    coefficients: Array
    centre_px: Array
    mismatch_px: float
    matched_fraction: float

    def at(self, points_px: Array) -> Array:
        """Disparity in px, shape (n,), at pixels of the left image, shape (n, 2)."""
        return np.asarray(_basis(points_px, self.centre_px) @ self.coefficients)


def match_semi_global(
    left_grey: Image, right_grey: Image, min_px: int, max_px: int, block_px: int = DEFAULT.block_px
) -> Array:
    """Disparity of every left pixel, shape (h, w) in px; NaN where there is none.

    `min_px` and `max_px` bound the search; OpenCV searches a multiple of 16.
    """
    if left_grey.shape[1] < _least_width_px(min_px, max_px, block_px):
        return np.full(left_grey.shape, np.nan)
    count = 16 * int(np.ceil((max_px - min_px) / 16))
    matcher = cv2.StereoSGBM.create(
        minDisparity=min_px,
        numDisparities=count,
        blockSize=block_px,
        P1=8 * block_px**2,
        P2=64 * block_px**2,
        disp12MaxDiff=2,
        uniquenessRatio=3,
        speckleWindowSize=100,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    fixed_point = np.asarray(matcher.compute(left_grey, right_grey), np.float64)
    return np.where(fixed_point >= 16 * min_px, fixed_point / 16.0, np.nan)


def _least_width_px(min_px: int, max_px: int, block_px: int) -> int:
    """Width below which OpenCV's matcher has no column with all disparities in it, and fails."""
    return max(abs(min_px), abs(max_px)) + (max_px - min_px) + 16 + 2 * block_px


def fit_surface(
    left_grey: Image,
    right_grey: Image,
    region: Image,
    right_region: Image,
    min_px: int,
    max_px: int,
    settings: StereoSettings = DEFAULT,
) -> DisparitySurface | None:
    """Fit the disparity surface of a region, a mask of shape (h, w); None with too few matches in it.

    `right_region` is the same region's mask in the right image: what leaves it there is hidden.
    """
    side_px = 2 * settings.margin_px + 1
    core = cv2.erode(region, np.ones((side_px, side_px), np.uint8))
    # Matching costs most of all; only the region's rows, and the columns that its matches can lie in, are needed.
    x, y, width, height = cv2.boundingRect(core)
    least_px = _least_width_px(min_px, max_px, settings.block_px)
    left_px = max(0, min(x - max(max_px, 0), core.shape[1] - least_px))
    right_px = max(x + width - min(min_px, 0), left_px + least_px)
    window = np.s_[y : y + height, left_px:right_px]
    disparity_px = np.full(core.shape, np.nan)
    if width > 0 and height > 0:
        disparity_px[window] = match_semi_global(
            left_grey[window], right_grey[window], min_px, max_px, settings.block_px
        )
    rows, columns = np.nonzero((core > 0) & np.isfinite(disparity_px))
    if len(rows) < settings.min_matches:
        return None
    matched_fraction = len(rows) / max(int(np.count_nonzero(core)), 1)
    step = max(1, len(rows) // MAX_SAMPLES)
    rows, columns = rows[::step], columns[::step]
    points_px = np.stack([columns, rows], -1).astype(np.float64)
    centre_px = points_px.mean(0)
    few = slice(None, None, max(1, len(rows) // MAX_START_SAMPLES))
    coefficients = _fit_robustly(_basis(points_px[few], centre_px), disparity_px[rows[few], columns[few]])
    coefficients, mismatch_px = _align(
        left_grey, right_grey, right_region, points_px, centre_px, coefficients, settings
    )
    return DisparitySurface(coefficients, centre_px, mismatch_px, matched_fraction)


def _basis(points_px: Array, centre_px: Array) -> Array:
    u, v = ((points_px - centre_px) / SCALE_PX).T
    return np.stack([u**i * v**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)], -1)


def _fit_robustly(B: Array, disparity_px: Array) -> Array:
    """Iteratively reweighted least squares with Cauchy's weights."""
    weight: Array = np.ones(len(disparity_px))
    coefficients: Array = np.zeros(B.shape[1])
    for _ in range(6):
        weighted = B * weight[:, None]
        normal = weighted.T @ B + RIDGE * np.eye(B.shape[1])
        coefficients = np.asarray(np.linalg.solve(normal, weighted.T @ disparity_px), np.float64)
        error = disparity_px - B @ coefficients
        weight = np.asarray(1.0 / (1.0 + (error / (2.0 * _spread(error) + 1e-3)) ** 2), np.float64)
    return coefficients


def _align(
    left_grey: Image,
    right_grey: Image,
    right_region: Image,
    points_px: Array,
    centre_px: Array,
    coefficients: Array,
    settings: StereoSettings,
) -> tuple[Array, float]:
    """Gauss–Newton on right(u - d(u, v), v) - left(u, v), with a free offset of brightness between the images.

    Gives the coefficients and the mismatch that they leave, in px.
    """
    left = cv2.GaussianBlur(left_grey, (0, 0), settings.smoothing_px).astype(np.float32)
    right = cv2.GaussianBlur(right_grey, (0, 0), settings.smoothing_px).astype(np.float32)
    slope = (cv2.Sobel(right, cv2.CV_32F, 1, 0, ksize=3) / 8.0).astype(np.float32)
    inside = cv2.erode(right_region, np.ones((settings.margin_px, settings.margin_px), np.uint8)).astype(
        np.float32
    )
    B = _basis(points_px, centre_px)
    columns, rows = points_px.T
    seen = left[rows.astype(int), columns.astype(int)].astype(np.float64)
    residual, slope_rms = np.inf, 1.0
    for _ in range(ALIGN_STEPS):
        where = ((columns - B @ coefficients).astype(np.float32)[None], rows.astype(np.float32)[None])
        value, gradient, visible = (
            np.asarray(cv2.remap(image, *where, cv2.INTER_LINEAR)[0], np.float64)
            for image in (right, slope, inside)
        )
        usable = visible > 250.0
        if np.count_nonzero(usable) < 10 * B.shape[1]:
            break
        error = value - seen
        error -= np.median(error[usable])
        residual = _spread(error[usable])
        slope_rms = float(np.sqrt(np.mean(gradient[usable] ** 2)))
        weight = usable / (1.0 + (error / (2.0 * residual + 0.5)) ** 2)
        J = gradient[:, None] * B
        weighted = J * weight[:, None]
        damping = 1e-5 * len(B) * np.eye(B.shape[1])
        step = np.linalg.solve(weighted.T @ J + damping, weighted.T @ error)
        coefficients = coefficients + step
        if np.abs(B @ step).max() < 0.005:
            break
    return coefficients, float(residual) / max(slope_rms, 1e-6)


def _spread(values: Array) -> float:
    """Median absolute deviation, scaled to a normal's standard deviation."""
    return float(1.4826 * np.median(np.abs(values)))

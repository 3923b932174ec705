"""Rectified stereo of smooth tissue: semi-global matching, then one smooth disparity surface aligned to sub-pixels.

Wet tissue has little texture. Semi-global matching (Hirschmüller 2008) finds the right disparity there within
a pixel or so, which at a baseline of 5 mm is several millimetres. The organ is smooth, though: a low-order
polynomial d(u, v) is fitted robustly to the matches, and then refined by aligning the images themselves
(Lucas & Kanade 1981, with the disparity surface as the warp), which every pixel of the organ supports.

The slopes that drive the alignment are those of the left image, which does not move (Baker & Matthews 2004), so that
a step costs one interpolation; on a regular grid the sums over a polynomial's terms are products with two small
matrices.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.samples import Image
from svmdist.settings.stereo import StereoSettings
from svmdist.transforms import Array

DEFAULT = StereoSettings()
DEGREE = 3
SCALE_PX = 100.0
TERMS = tuple((i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i))
"""The powers of u and v in each term."""
MAX_SAMPLES = 15_000
"""Pixels used in the alignment: beyond some ten thousand, noise is no longer what limits it."""
MAX_START_SAMPLES = 1000
"""Matches that the alignment starts from: it must begin within a pixel, no better."""
START_STEPS, ALIGN_STEPS = 6, 12
SETTLED_PX = 0.005
"""A step that moves no pixel by more ends the alignment."""
SCALE_STRIDE = 4
"""The offset and the spread of the images' difference are medians over every fourth pixel: right within a percent."""
RIDGE = 1e-3
SPECKLE_PX2 = 100
"""Patches of matches up to this area, in pixels of the original image, that stand alone are mistakes."""


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


@dataclass(frozen=True, slots=True)
class _Matches:
    """Disparities on a grid of pixels of the left image: columns (w,), rows (h,), both in px, values (h, w) in px.

    A value stands for a cell of `step_px` squared about its pixel; `is_core`, shape (h, w), says which cells lie in
    the region. Values are NaN outside it and where nothing matched.
    """

    columns_px: Array
    rows_px: Array
    disparity_px: Array
    is_core: NDArray[np.bool_]
    step_px: int


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

    `right_region` is the same region's mask in the right image: what leaves it there is hidden. `min_px` and `max_px`
    bound the search.
    """
    side_px = 2 * settings.margin_px + 1
    core = np.asarray(cv2.erode(region, np.ones((side_px, side_px), np.uint8)), np.uint8)
    matches = _matched(left_grey, right_grey, core, min_px, max_px, settings)
    if matches is None:
        return None
    is_matched = np.isfinite(matches.disparity_px)
    count = int(np.count_nonzero(is_matched))
    if count * matches.step_px**2 < settings.min_matches:
        return None
    rows, columns = np.nonzero(is_matched)
    points_px = np.stack([matches.columns_px[columns], matches.rows_px[rows]], -1)
    centre_px = points_px.mean(0)
    few = slice(None, None, max(1, count // MAX_START_SAMPLES))
    start = _fit_robustly(_basis(points_px[few], centre_px), matches.disparity_px[is_matched][few])
    thinned = slice(None, None, max(1, int(np.ceil(np.sqrt(count / MAX_SAMPLES)))))
    coefficients, mismatch_px = _align(
        left_grey,
        right_grey,
        right_region,
        np.floor(matches.columns_px[thinned]).astype(np.intp),
        np.floor(matches.rows_px[thinned]).astype(np.intp),
        is_matched[thinned, thinned],
        centre_px,
        start,
        settings,
    )
    matched_fraction = count / max(int(np.count_nonzero(matches.is_core)), 1)
    return DisparitySurface(coefficients, centre_px, mismatch_px, matched_fraction)


def match_semi_global(
    left_grey: Image,
    right_grey: Image,
    min_px: int,
    max_px: int,
    block_px: int = DEFAULT.block_px,
    speckle_px2: int = SPECKLE_PX2,
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
        speckleWindowSize=speckle_px2,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    fixed_point = np.asarray(matcher.compute(left_grey, right_grey), np.float64)
    return np.where(fixed_point >= 16 * min_px, fixed_point / 16.0, np.nan)


def _least_width_px(min_px: int, max_px: int, block_px: int) -> int:
    """Width below which OpenCV's matcher has no column with all disparities in it, and fails."""
    return max(abs(min_px), abs(max_px)) + (max_px - min_px) + 16 + 2 * block_px


def _matched(
    left_grey: Image, right_grey: Image, core: Image, min_px: int, max_px: int, settings: StereoSettings
) -> _Matches | None:
    """Matches in the region's core, on images reduced until the search spans the settings' number of disparities."""
    # Matching costs most of all; only the region's rows, and the columns that its matches can lie in, are needed.
    x, y, width, height = cv2.boundingRect(core)
    step = max(1, round((max_px - min_px) / settings.matched_disparities))
    low, high = int(np.floor(min_px / step)), int(np.ceil(max_px / step))
    least_px = step * _least_width_px(low, high, settings.block_px)
    left_px = max(0, min(x - max(max_px, 0), core.shape[1] - least_px))
    right_px = min(max(x + width - min(min_px, 0), left_px + least_px), core.shape[1])
    shape = (height // step, (right_px - left_px) // step)
    if min(shape) == 0:
        return None
    window = np.s_[y : y + step * shape[0], left_px : left_px + step * shape[1]]
    left, right = (_reduced(image[window], step) for image in (left_grey, right_grey))
    disparity_px = step * match_semi_global(
        left, right, low, high, settings.block_px, max(1, SPECKLE_PX2 // step**2)
    )
    middle = (step - 1) // 2
    is_core = core[window][middle::step, middle::step] > 0
    columns_px, rows_px = (
        first + step * np.arange(count, dtype=np.float64) + 0.5 * (step - 1)
        for first, count in ((left_px, shape[1]), (y, shape[0]))
    )
    return _Matches(columns_px, rows_px, np.where(is_core, disparity_px, np.nan), is_core, step)


def _reduced(image: Image, step: int) -> Image:
    """An image of which each pixel is the mean of `step` squared ones; its sides are multiples of that."""
    size = (image.shape[1] // step, image.shape[0] // step)
    return image if step == 1 else np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _basis(points_px: Array, centre_px: Array) -> Array:
    u, v = ((points_px - centre_px) / SCALE_PX).T
    return np.stack([u**i * v**j for i, j in TERMS], -1)


def _fit_robustly(B: Array, disparity_px: Array) -> Array:
    """Iteratively reweighted least squares with Cauchy's weights."""
    weight: Array = np.ones(len(disparity_px))
    coefficients: Array = np.zeros(B.shape[1])
    for _ in range(START_STEPS):
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
    columns: NDArray[np.intp],
    rows: NDArray[np.intp],
    is_used: NDArray[np.bool_],
    centre_px: Array,
    coefficients: Array,
    settings: StereoSettings,
) -> tuple[Array, float]:
    """Gauss–Newton on right(u - d(u, v), v) - left(u, v), with a free offset of brightness between the images.

    `columns`, `rows` and `is_used`, shape (h, w), make the grid of the left image's pixels that are aligned. Gives the
    coefficients and the mismatch that they leave, in px.
    """
    left, slope = _smoothed_with_slope(left_grey, columns, rows, settings.smoothing_px)
    right, first_row = _smoothed_where_seen(right_grey, right_region, rows, settings)
    u, v = (
        np.vander((px - middle) / SCALE_PX, 2 * DEGREE + 1, increasing=True)
        for px, middle in ((columns, centre_px[0]), (rows, centre_px[1]))
    )
    # left(u) = right(u - d), so that the right image's slope there is the left one's over 1 - d'.
    slope = slope / np.maximum(1.0 - _slope_along_u(coefficients, u, v), 0.5)
    at_columns, at_rows = np.meshgrid(columns.astype(np.float32), (rows - first_row).astype(np.float32))
    residual, slope_rms = np.inf, 1.0
    for _ in range(ALIGN_STEPS):
        at = (at_columns - _values(coefficients, u, v)).astype(np.float32)
        value = cv2.remap(right, at, at_rows, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, np.nan)
        error: Array = np.asarray(value, np.float64) - left
        usable = is_used & np.isfinite(error)
        count = int(np.count_nonzero(usable))
        if count < 10 * len(TERMS):
            break
        seen = error[usable][::SCALE_STRIDE]
        middle = float(np.median(seen))
        residual = _spread(seen - middle)
        error = np.asarray(np.where(usable, error - middle, 0.0), np.float64)
        slope_rms = float(np.sqrt(np.mean(slope[usable] ** 2)))
        weight = np.asarray(usable * slope / (1.0 + (error / (2.0 * residual + 0.5)) ** 2), np.float64)
        step = _step(weight * slope, weight * error, u, v, 1e-5 * int(np.count_nonzero(is_used)))
        coefficients = coefficients + step
        if np.abs(_values(step, u, v))[is_used].max() < SETTLED_PX:
            break
    return coefficients, float(residual) / max(slope_rms, 1e-6)


def _smoothed_with_slope(
    grey: Image, columns: NDArray[np.intp], rows: NDArray[np.intp], smoothing_px: float
) -> tuple[Array, Array]:
    """The smoothed image and its slope along x in levels per px on a grid, shape (h, w) each."""
    margin = int(4 * smoothing_px) + 2
    top, left = max(int(rows[0]) - margin, 0), max(int(columns[0]) - margin, 0)
    window = grey[top : int(rows[-1]) + margin + 1, left : int(columns[-1]) + margin + 1]
    smooth = np.asarray(cv2.GaussianBlur(window, (0, 0), smoothing_px), np.uint8)
    slope = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=3)
    grid = np.ix_(rows - top, columns - left)
    return smooth[grid].astype(np.float64), slope[grid].astype(np.float64) / 8.0


def _smoothed_where_seen(
    grey: Image, region: Image, rows: NDArray[np.intp], settings: StereoSettings
) -> tuple[NDArray[np.float32], int]:
    """Rows of the smoothed image, NaN where the region's edge is near or passed, and which row is the first."""
    margin = max(int(4 * settings.smoothing_px) + 2, settings.margin_px)
    top, bottom = max(int(rows[0]) - margin, 0), int(rows[-1]) + margin + 1
    smooth = cv2.GaussianBlur(grey[top:bottom], (0, 0), settings.smoothing_px).astype(np.float32)
    side_px = max(settings.margin_px, 1)
    inside = cv2.erode(region[top:bottom], np.ones((side_px, side_px), np.uint8))
    smooth[inside == 0] = np.nan
    return np.asarray(smooth, np.float32), top


def _values(coefficients: Array, u: Array, v: Array) -> Array:
    """The polynomial on a grid, shape (h, w); `u` and `v` hold powers of its coordinates, shape (w, k) and (h, k)."""
    C = np.zeros((DEGREE + 1, DEGREE + 1))
    C[tuple(np.transpose(TERMS))] = coefficients
    return np.asarray(v[:, : DEGREE + 1] @ C.T @ u[:, : DEGREE + 1].T)


def _slope_along_u(coefficients: Array, u: Array, v: Array) -> Array:
    """The polynomial's derivative along x on a grid, shape (h, w), in px per px."""
    C = np.zeros((DEGREE + 1, DEGREE + 1))
    C[tuple(np.transpose(TERMS))] = coefficients
    by_u = C[1:] * np.arange(1, DEGREE + 1)[:, None] / SCALE_PX
    return np.asarray(v[:, : DEGREE + 1] @ by_u.T @ u[:, :DEGREE].T)


def _step(weight: Array, pull: Array, u: Array, v: Array, damping: float) -> Array:
    """The step of least squares, shape (n,), from weights and weighted errors on a grid, shape (h, w) each.

    The products of two terms are terms again: their sums are moments of the weights.
    """
    moments = u.T @ weight.T @ v
    i, j = np.transpose(TERMS)
    normal = moments[i[:, None] + i, j[:, None] + j]
    gradient = (u[:, : DEGREE + 1].T @ pull.T @ v[:, : DEGREE + 1])[i, j]
    return np.asarray(np.linalg.solve(normal + damping * np.eye(len(TERMS)), gradient), np.float64)


def _spread(values: Array) -> float:
    """Median absolute deviation, scaled to a normal's standard deviation."""
    return float(1.4826 * np.median(np.abs(values)))
